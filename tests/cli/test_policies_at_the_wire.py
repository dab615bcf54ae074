"""Policies end to end: a network that queues, and a disk that fills; what is said, recorded and told to the robot."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from fault_bench import FaultBench

from bench.model import CycleEventKind
from bench.recording import Run, open_run

MB = 1_000_000


def cycles(run: Run, kind: CycleEventKind) -> list[int]:
    events = run["/cycle/event"]
    return [int(index) for index in events.cycle_index[events.kind == kind]]


def grants_between(run: Run, state: str, following: str) -> int:
    """Return how many cycles were granted from the first entry of a state to the next of another."""
    states = run["/run/state"]
    entered = [(str(name), int(ns)) for name, ns in zip(states.state, states.log_time_ns, strict=True)]
    first = next(i for i, (name, _) in enumerate(entered) if name == state)
    end_ns = next(ns for name, ns in entered[first:] if name == following)
    events = run["/cycle/event"]
    during = (events.log_time_ns > entered[first][1]) & (events.log_time_ns < end_ns)
    return int((during & (events.kind == CycleEventKind.GRANTED)).sum())


def test_packages_that_queue_hold_the_run_until_they_come_in_time(tmp_path: Path) -> None:
    # at real time: at a --speed it would be this machine that is late
    bench = FaultBench(tmp_path, "127.0.65.31", 5, ("cycle_s = 2.0", "cycle_s = 0.6"), speed=1.0, policy="")
    try:
        bench.hold_and_go_on("delay 0.4", lambda: bench.admin("delay 0"))
        code, out, err = bench.finish()
    finally:
        bench.close()
    assert code == 0, out + err
    assert "ms late, more than 250 ms. Look at the network and at what else this machine does" in out
    assert "The robot's stream arrived up to" in out
    run = open_run(bench.run_file)
    states = run["/run/state"]
    reasons = [str(reason) for state, reason in zip(states.state, states.reason, strict=True) if state == "HOLDING"]
    assert any("The robot's packages come" in reason for reason in reasons)
    assert "Over: clock residual." in [str(text) for text in run["/log"].text]
    assert cycles(run, CycleEventKind.COMPLETED) == cycles(run, CycleEventKind.GRANTED) == list(range(5))
    assert cycles(run, CycleEventKind.INTERRUPTED) == []
    assert grants_between(run, "HOLDING", "RUNNING") == 0
    assert run.totals["/robot/state"].missed == 0


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 48 MB."""
    if shutil.which("mount") is None:
        pytest.skip("there is no command 'mount' here to make a small disk with")
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=48m", "tmpfs", folder], capture_output=True, text=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"a small disk cannot be mounted here: {mounted.stderr.strip()}")
    yield folder
    subprocess.run(["umount", folder], check=True)


def fill(folder: Path, leave: int) -> None:
    """Write a file until only `leave` bytes of the disk are free."""
    status = os.statvfs(folder)
    with (folder / "filler").open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, status.f_bavail * status.f_frsize - leave)


def test_a_disk_that_fills_ends_the_run_after_the_cycle_and_the_file_is_whole(small_disk: Path) -> None:
    bench = FaultBench(small_disk, "127.0.65.33", 60, speed=8.0, policy="free_space_mb = 8")
    try:
        bench.wait_for_cycle()
        fill(small_disk, 6 * MB)
        code, out, err = bench.finish()
    finally:
        bench.close()
    assert code == 4, out + err
    assert "The disk has 6 MB free; 8 MB are needed" in out
    assert "Stopped by the policy for this: The disk has" in out
    assert "To go on: bench run --cycles 60" in out
    run = open_run(bench.run_file)
    assert (run.status.complete, run.exit_status) == (True, "abort")
    done = cycles(run, CycleEventKind.COMPLETED)
    assert done == cycles(run, CycleEventKind.GRANTED) == list(range(len(done)))
    assert 0 < len(done) < 60
    assert cycles(run, CycleEventKind.INTERRUPTED) == []
    assert "STOPPING" in run["/run/state"].state
    assert f"{len(done)} of 60 cycles" in run.exit_reason


def test_a_disk_that_is_full_aborts_the_run_and_what_was_written_can_be_read(small_disk: Path) -> None:
    bench = FaultBench(small_disk, "127.0.65.35", 60, speed=8.0, policy="free_space_mb = 0")
    try:
        bench.wait("what two flushes wrote", lambda: bench.n_completed() >= 10)
        fill(small_disk, 0)
        code, out, err = bench.finish()
    finally:
        bench.close()
    assert code == 5, out + err
    assert f"The disk cannot take more of {bench.run_file}.active" in err
    assert "Traceback" not in err
    assert f"--resume {bench.run_file}.active" in out
    done = cycles(open_run(bench.run_file.with_name("a.mcap.active")), CycleEventKind.COMPLETED)
    assert done == list(range(len(done)))
    assert done


def test_a_folder_that_is_moved_away_aborts_the_run_and_the_file_in_it_can_be_read(tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    folder.mkdir()
    bench = FaultBench(folder, "127.0.65.37", 60, speed=8.0, policy="")
    try:
        bench.wait("what two flushes wrote", lambda: bench.n_completed() >= 10)
        folder.rename(tmp_path / "moved")
        code, out, err = bench.finish()
    finally:
        bench.close()
    assert code == 5, out + err
    assert f"{bench.run_file}.active cannot be written: No such file or directory" in err
    assert "Traceback" not in err
    assert "was not stopped" not in out + err
    journal = (tmp_path / "moved" / "a.mcap.journal").read_text()
    assert [state for state in ("RUNNING", "ABORTING", "CLOSING") if f'"state": "{state}"' not in journal] == []
    done = cycles(open_run(tmp_path / "moved" / "a.mcap.active"), CycleEventKind.COMPLETED)
    assert done == list(range(len(done)))
    assert done
