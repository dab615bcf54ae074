"""What the documentation's pages take as given."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from example_take import write_example_take
from markdown_pages import CONFIGS, ROOT, find_blocks
from workshop import FIRST_RUN


@pytest.fixture(scope="session")
def material(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make once what the pages take as given: a recording of three cycles and its report, an old take, configs."""
    folder = tmp_path_factory.mktemp("material")
    bench = [sys.executable, "-m", "bench"]
    for arguments in ([*FIRST_RUN.split()[1:], "run.mcap"], ["report", "run.mcap"]):
        made = subprocess.run(
            [*bench, *arguments], cwd=folder, capture_output=True, text=True, timeout=120, check=False
        )
        assert made.returncode == 0, made.stdout + made.stderr
    write_example_take(folder / "take.csv")
    for name in ("modbus_simulated.toml", "modbus_generic_plc.toml"):
        shutil.copy(CONFIGS / name, folder)
    readme = find_blocks(ROOT / "README.md")
    for block in readme:
        if "file" in block.notes:
            (folder / block.notes["file"]).write_text(block.text, encoding="utf-8")
    return folder
