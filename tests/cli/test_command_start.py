"""What the command line waits for before it says its first word."""

import subprocess
import sys
from pathlib import Path

import pytest

CONFIG = Path(__file__).parents[2] / "bench_configs" / "simulated.toml"
LISTED = "import sys; from bench.cli import main\ntry:\n    main()\nfinally:\n    print('loaded:', *sys.modules)"


def list_loaded(*arguments: str) -> set[str]:
    """Run a command; return the modules that it loaded."""
    ran = subprocess.run([sys.executable, "-c", LISTED, *arguments], capture_output=True, text=True, check=True)
    return set(ran.stdout.rpartition("loaded:")[2].split())


@pytest.mark.parametrize("arguments", [["--help"], ["report", "--help"]])
def test_help_loads_neither_numpy_nor_the_models_of_the_configuration(arguments: list[str]) -> None:
    loaded = list_loaded(*arguments)
    assert "bench.cli.report" in loaded
    assert loaded.isdisjoint(["numpy", "bench.config", "bench.recording", "bench.report.html"])


def test_checking_a_configuration_loads_no_numpy() -> None:
    loaded = list_loaded("config", "check", str(CONFIG))
    assert "bench.config" in loaded
    assert loaded.isdisjoint(["numpy", "pyarrow", "bench.analysis"])
