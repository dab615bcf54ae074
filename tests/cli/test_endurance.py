"""One test, ended and stalled in each way: `scripts/endurance` with one fault of each kind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "endurance.py"
LIMITS = ["--cycles", "14", "--faults", "4", "--cycle-s", "0.4", "--stall-s", "1.6", "--seed", "3"]


@pytest.fixture(scope="module")
def endurance(tmp_path_factory: pytest.TempPathFactory) -> subprocess.CompletedProcess[str]:
    folder = tmp_path_factory.mktemp("endurance")
    command = [sys.executable, str(SCRIPT), *LIMITS, "--host", "127.0.66.41", "--folder", str(folder)]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)


def test_kills_and_stalls_leave_every_cycle_once_and_are_named_in_the_reports(
    endurance: subprocess.CompletedProcess[str],
) -> None:
    assert endurance.returncode == 0, endurance.stdout + endurance.stderr
    assert endurance.stdout.endswith(": 14 cycles, each once, and every fault is named\n")
    for kind in ("kill bench", "kill controller", "stall controller", "stall bench"):
        assert endurance.stdout.count(f"{kind} after ") == 1


def test_the_operator_is_told_what_to_do_and_how_to_go_on(endurance: subprocess.CompletedProcess[str]) -> None:
    for words in (
        "It goes on when it is heard again",
        "make the robot ready again (its power, its brakes)",
        "To go on: bench run --cycles 14 --resume ",
    ):
        assert words in endurance.stdout, words
