"""A first cycle to watch, on the simulated e-Series controller over real sockets."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from bench_command import bench, simulated_file, start_bench

from bench.model import CycleEventKind
from bench.recording import CYCLE, LOG, ROBOT, Run, open_run

CYCLE_S = 1.0
SLOW = 0.25
SETTINGS = (("[run]", f"[run]\nfirst_cycle_speed = {SLOW}"), ("cycle_s = 2.0", f"cycle_s = {CYCLE_S}"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return where a run of three cycles and its report are."""
    folder = tmp_path_factory.mktemp("slow")
    config = simulated_file(folder, *SETTINGS, ("[simulation]", "[policy]\nslider_moved = 'abort'\n\n[simulation]"))
    process = bench("run", config, "--cycles", "3", "--speed", "4", "--output", folder / "a.mcap")
    assert process.returncode == 0, process.stderr + process.stdout
    assert "watch it." in process.stdout
    bench("report", folder / "a.mcap", "--output", folder / "report")
    return folder


def durations_s(run: Run) -> list[float]:
    """Return how long each cycle took, by the controller's own clock."""
    events = run[CYCLE]
    started = events.controller_time_s[events.kind == CycleEventKind.STARTED]
    return list(events.controller_time_s[events.kind == CycleEventKind.COMPLETED] - started)


def test_the_first_cycle_takes_as_much_longer_as_the_slider_says_by_the_controllers_time(folder: Path) -> None:
    ratio = np.array(durations_s(open_run(folder / "a.mcap"))) / CYCLE_S
    assert ratio == pytest.approx([1 / SLOW, 1.0, 1.0], abs=0.02)


def test_the_slider_is_back_before_the_second_cycle_and_stays(folder: Path) -> None:
    robot = open_run(folder / "a.mcap")[ROBOT]
    fraction, count, running = robot.speed_fraction, robot.cycle_count, robot.cycle_running
    playing = robot.runtime_state == 2
    assert set(fraction[playing & (count == 0) & (running == 1)]) == {SLOW}
    assert set(fraction[playing & (count > 0) & (running == 1)]) == {1.0}
    assert fraction[0] == fraction[-1] == 1.0


def test_the_record_says_why_the_first_cycle_was_slow(folder: Path) -> None:
    run = open_run(folder / "a.mcap")
    events = run[CYCLE]
    details = list(events.detail[events.kind == CycleEventKind.GRANTED])
    assert details == ["driven with the speed slider at 25% ([run] first_cycle_speed)", "", ""]
    assert any("the speed slider is back at 100%" in text for text in run[LOG].text)


def test_the_report_calls_it_slow_and_says_why(folder: Path) -> None:
    verdicts = pq.read_table(folder / "report" / "cycles.parquet")["verdict"].to_pylist()
    assert verdicts == ["slow", "ok", "ok"]
    assert "driven with the speed slider at 25%" in (folder / "report" / "report.html").read_text(encoding="utf-8")


def test_a_run_that_is_aborted_in_its_first_cycle_leaves_a_robot_that_stands_with_its_slider_back(
    tmp_path: Path,
) -> None:
    process = start_bench(
        "run", simulated_file(tmp_path, *SETTINGS), "--cycles", "3", "--speed", "4", "--output", tmp_path / "a.mcap"
    )
    assert process.stdout is not None
    said = iter(process.stdout.readline, "")
    assert any("watch it." in line for line in said)
    journal = tmp_path / "a.mcap.journal"
    while "RUNNING" not in journal.read_text():
        assert process.poll() is None
        time.sleep(0.01)
    process.terminate()
    process.communicate(timeout=60)
    assert process.returncode == 4
    robot = open_run(tmp_path / "a.mcap")[ROBOT]
    assert SLOW in robot.speed_fraction
    assert robot.speed_fraction[-1] == 1.0
    assert robot.runtime_state[-1] == 1
    assert robot.speed_fraction[robot.runtime_state == 2][-1] == SLOW  # it stood before the slider went back


def test_a_dry_run_says_how_the_first_cycle_is_driven_and_counts_its_time(tmp_path: Path) -> None:
    said = bench("run", simulated_file(tmp_path, *SETTINGS), "--cycles", "3", "--dry-run").stdout
    assert "the first with the speed slider at 25%" in said
    assert "duration 6 s of simulated time" in said
