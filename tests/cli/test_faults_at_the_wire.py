"""Faults of robot and tracker during a run, over real sockets: what is seen, recorded, and told to the robot.

The rows of `docs/reference/what-happens-when.md`, and where each is proved besides here:

| row | tests |
|---|---|
| protective and safeguard stop, pause, slider | here (`night`); `tests/run/test_holding.py`, `test_ur_faults.py` |
| emergency stop, another program, restart | here; `test_watchers.py`, `test_holding.py`, `test_ur_reconnect.py` |
| counter jumps, a cycle that does not end | `tests/run/test_engine.py` |
| local mode | here, at the end of `night`; before the start: `test_bad_input.py` |
| link lost, tracker silent | here; `test_endurance.py`, `test_ur_reconnect.py`, `test_natnet_stall.py` |
| samples skipped, half-open controller, register in use | `tests/drivers/robot/test_ur_faults.py` |
| packages queue, disk fills, disk full | `test_policies_at_the_wire.py`, `tests/run/test_guard_limits.py` |
| Modbus heartbeats, exceptions, late answers | `tests/drivers/robot/test_modbus_state_stream.py` |
| bench or controller killed, or stalled | `test_endurance.py`, `test_resume_runs.py`, `tests/run/test_own_pause.py` |
| Ctrl-C | `test_interrupts.py`, `tests/run/test_engine.py` |
| what the robot is told at the end | `tests/run/test_holding.py` |
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from bench_command import bench
from fault_bench import FaultBench

from bench.recording import Run, open_run

N_CYCLES = 24


@dataclass(frozen=True)
class Night:
    """A run that met everything it can survive."""

    code: int
    out: str
    err: str
    run: Run
    stopped_in: list[int]
    """Cycles in which the robot was stopped."""
    told: list[str]
    """Commands and grants that the robot got, up to its last cycles."""


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> Night:
    bench = FaultBench(tmp_path_factory.mktemp("night"), "127.0.64.31", N_CYCLES)
    stopped_in = []
    try:
        bench.wait("the first cycle", lambda: bench.n_completed() > 0)
        stopped_in.append(bench.hold_and_go_on("protective_stop", bench.unlock, lambda: bench.admin("resume")))
        stopped_in.append(bench.hold_and_go_on("safeguard_stop on", lambda: bench.admin("safeguard_stop off")))
        stopped_in.append(bench.hold_and_go_on("pause", lambda: bench.admin("resume")))
        bench.hold_and_go_on("slider 0.5", lambda: bench.admin("slider 1.0"))
        bench.hold_and_go_on("tracker_stall 3")
        bench.hold_and_go_on("stall 3")
        bench.hold_and_go_on("rst")
        bench.hold_and_go_on("fin")
        bench.wait_for_cycle()
        told = bench.told()
        bench.admin("local on")
        code, out, err = bench.finish()
    finally:
        bench.close()
    return Night(code, out, err, open_run(bench.run_file), stopped_in, told)


def test_the_run_ends_with_every_cycle_once(night: Night) -> None:
    assert night.code == 0, night.err + night.out
    events = night.run["/cycle/event"]
    assert events.cycle_index[events.kind == 2].tolist() == list(range(N_CYCLES))
    assert f"{N_CYCLES} of {N_CYCLES} cycles completed" in night.out


def test_the_screen_says_what_to_do_about_each(night: Night) -> None:
    for words in (
        "Look at robot and cable, clear the stop at the pendant",
        "Resume the program at the pendant.",
        "Close the safeguard",
        "Put the speed slider back to 100%",
        "Check the tracker's streaming",
        "Look at the robot and its network cable",
    ):
        assert words in night.out, words
    assert "Traceback" not in night.err


def test_every_hold_and_its_reason_is_in_the_file(night: Night) -> None:
    states = night.run["/run/state"]
    reasons = [str(r) for s, r in zip(states.state, states.reason, strict=True) if s == "HOLDING"]
    assert len(reasons) >= 8
    for words in ("Protective stop", "Safeguard stop", "was paused", "slider was moved", "sent no frame", "closed the"):
        assert any(words in reason for reason in reasons), words
    said = "\n".join(str(text) for text in night.run["/log"].text)
    assert said.count("Over: robot link lost.") >= 3


def test_the_robot_is_told_nothing_but_to_play_once_and_one_cycle_after_the_other(night: Night) -> None:
    commands = [line for line in night.told if not line.startswith("grant ")]
    assert [line for line in commands if line != "unlock protective stop"] == ["load bend_test.urp", "play"]
    grants = [int(line.removeprefix("grant ")) for line in night.told if line.startswith("grant ")]
    assert grants[:2] == [0, 0]  # when it was connected, and before the program played
    given = [grant for grant in grants if grant]  # 0 takes it back, once the cycle has begun
    assert given == sorted(given)
    assert set(given) == set(range(1, max(given) + 1))
    assert max(given) <= N_CYCLES


def test_the_last_packets_of_each_lost_link_are_beside_the_run_file_and_named(night: Night) -> None:
    files = sorted(night.run.path.parent.glob("a.*-packets-*.txt"))
    devices = [path.name.split("-")[0] for path in files]
    assert devices.count("a.robot") >= 3
    assert devices.count("a.tracker") >= 1
    said = "\n".join(str(text) for text in night.run["/log"].text)
    for path in files:
        assert f"packets of the link are in {path}." in said
        assert " < " in path.read_text(encoding="utf-8")
    assert f"packets of the link are in {files[0]}." in night.out


def marked_cycles(run: Run) -> list[int]:
    events = run["/cycle/event"]
    return events.cycle_index[events.kind == 3].tolist()


def test_the_cycles_in_which_the_robot_was_stopped_are_marked_and_no_others(night: Night) -> None:
    # on a busy machine a stop may fall between two cycles, where there is none to mark
    marked = marked_cycles(night.run)
    assert marked
    assert set(marked) <= set(night.stopped_in)
    assert len(set(marked)) == len(marked)


def test_the_report_judges_each_cycle_by_it(night: Night, tmp_path: Path) -> None:
    report = bench("report", night.run.path, "--output", tmp_path / "a")
    assert report.returncode == 6, report.stderr  # outcome ERROR: the bench, not the cable
    table = pq.read_table(tmp_path / "a" / "cycles.parquet").to_pydict()
    assert table["cycle_index"] == list(range(N_CYCLES))
    interrupted = [i for i, verdict in enumerate(table["verdict"]) if verdict == "interrupted"]
    assert interrupted == marked_cycles(night.run)
    assert "slow" in table["verdict"]
    assert "gap" in table["verdict"]


def end_in_order(folder: Path, fault: str, host: str, words: str) -> None:
    """Cause a fault that no run survives, in a run of 8 cycles, and check how it ends."""
    bench = FaultBench(folder, host, 8)
    try:
        bench.wait_for_cycle()
        bench.admin(fault)
        code, out, err = bench.finish()
    finally:
        bench.close()
    assert code == 3, out + err
    assert err.startswith("error: ")
    assert words in err
    assert "--resume" in err
    assert f"To go on: bench run --cycles 8 --speed 4 --resume {bench.run_file}" in out
    run = open_run(bench.run_file)
    assert (run.status.complete, run.exit_status) == (True, "fail")
    events = run["/cycle/event"]
    assert marked_cycles(run) in ([], [int(events.cycle_index[events.kind == 2][-1]) + 1])
    assert not bench.run_file.with_name("a.mcap.journal").exists()


def test_another_program_ends_the_run_in_order(tmp_path: Path) -> None:
    end_in_order(tmp_path, "foreign_program other.urp", "127.0.64.43", "The robot program stopped in cycle")


def test_a_controller_that_restarts_ends_the_run_in_order(tmp_path: Path) -> None:
    end_in_order(tmp_path, "reboot", "127.0.64.45", "The robot's controller restarted in cycle")


def test_an_emergency_stop_ends_the_run_in_order_and_it_goes_on_with_resume(tmp_path: Path) -> None:
    end_in_order(tmp_path, "emergency_stop", "127.0.64.41", "Robot emergency stop in cycle")
    resume_and_count(tmp_path, 8)


def test_a_simulated_bench_that_is_killed_ends_the_run_and_resume_adds_up(tmp_path: Path) -> None:
    fault_bench = FaultBench(tmp_path, "127.0.64.61", 8)
    try:
        fault_bench.wait_for_cycle()
        fault_bench.kill_simulator()
        code, out, err = fault_bench.finish()
    finally:
        fault_bench.close()
    assert code == 3, out + err
    assert "The simulated bench has ended" in err
    assert open_run(fault_bench.run_file).status.complete
    resume_and_count(tmp_path, 8)


def resume_and_count(folder: Path, n_cycles: int) -> None:
    """Go on with ``a.mcap`` in ``b.mcap`` and check that the cycles of both add up."""
    first, second = folder / "a.mcap", folder / "b.mcap"
    resumed = bench("run", "--cycles", str(n_cycles), "--speed", "8", "--resume", first, "--output", second)
    assert resumed.returncode == 0, resumed.stderr + resumed.stdout
    done: list[int] = []
    for path in (first, second):
        events = open_run(path)["/cycle/event"]
        done += events.cycle_index[events.kind == 2].tolist()
    assert done == list(range(n_cycles))
