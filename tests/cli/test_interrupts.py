"""Ctrl-C once and twice, and a parent that is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import psutil
from bench_command import simulated_file, start_bench

from bench.recording import open_run

PATIENCE_S = 60.0


def wait_for_growth(path: Path, size: int = 20_000) -> None:
    """Wait until the run file has grown, which it does each second while the run goes on."""
    deadline = time.monotonic() + PATIENCE_S
    while not (path.exists() and path.stat().st_size > size):
        assert time.monotonic() < deadline, f"{path} did not grow"
        time.sleep(0.05)


def start_run(folder: Path) -> subprocess.Popen[str]:
    config = simulated_file(folder)
    return start_bench("run", config, "--cycles", "1000", "--speed", "2", "--output", folder / "a.mcap")


def test_ctrl_c_once_stops_after_the_cycle_and_leaves_a_finished_file(tmp_path: Path) -> None:
    process = start_run(tmp_path)
    wait_for_growth(tmp_path / "a.mcap.active", 300_000)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 4, err + out
    assert "Traceback" not in err
    assert "Stopped by the operator after" in out
    run = open_run(tmp_path / "a.mcap")
    assert run.status.complete
    kinds = run["/cycle/event"]["kind"].tolist()
    assert kinds.count(1) == kinds.count(2) > 0
    assert 3 not in kinds


def test_ctrl_c_twice_aborts_and_leaves_a_finished_file(tmp_path: Path) -> None:
    process = start_run(tmp_path)
    wait_for_growth(tmp_path / "a.mcap.active", 300_000)
    process.send_signal(signal.SIGINT)
    time.sleep(0.1)  # two presses, not one
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 4, err + out
    assert "Traceback" not in err
    assert open_run(tmp_path / "a.mcap").status.complete


def test_a_killed_run_leaves_no_orphan_and_a_file_that_can_be_read(tmp_path: Path) -> None:
    process = start_run(tmp_path)
    wait_for_growth(tmp_path / "a.mcap.active")
    children = psutil.Process(process.pid).children(recursive=True)
    assert children
    os.kill(process.pid, signal.SIGKILL)
    process.communicate(timeout=PATIENCE_S)
    _, alive = psutil.wait_procs(children, timeout=PATIENCE_S)
    assert alive == []
    run = open_run(tmp_path / "a.mcap.active")
    assert not run.status.complete
    assert len(run["/robot/state"]["controller_time_s"]) > 0
