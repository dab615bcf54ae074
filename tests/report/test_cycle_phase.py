"""Which way the phase was found is said, and each way gives the same place."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from run_examples import ROBOT_HZ, RunSpec, cycle_at, write_run

from bench.model import RobotState
from bench.recording import open_run
from bench.report.pipeline import analyse_run
from bench.report.results import Results

BY_PATH = "robot's counter, phase by the robot's path"


def without_register(far_cycle: int = -1) -> Callable[[RobotState], RobotState]:
    """Return a change of state: no phase register, joints that go along a path, and in one cycle along another."""

    def change(state: RobotState) -> RobotState:
        count, running, phase = cycle_at(state.sequence / ROBOT_HZ)
        swing = np.sin(np.pi * phase) ** 2 if running else 0.0
        joints = (swing * (1.5 if count == far_cycle else 1.0), -0.5 * swing, 0.2, 0.0, 0.0, 0.0)
        return replace(state, cycle_phase=float("nan"), q_rad=joints)

    return change


def analyse(tmp_path: Path, spec: RunSpec) -> Results:
    write_run(tmp_path / "run.mcap", spec)
    return analyse_run(open_run(tmp_path / "run.mcap"))


def test_without_a_register_the_path_tells_the_phase(tmp_path: Path) -> None:
    results = analyse(tmp_path, RunSpec(n_cycles=4, change_state=without_register()))
    assert results.methods["cycles"] == BY_PATH
    frames = results.frames
    inside = frames.cycle_index >= 0
    truth = [cycle_at(ns * 1e-9)[2] for ns in (frames.time_ns - frames.time_ns[0])[inside]]
    assert frames.cycle_phase[inside] == pytest.approx(truth, abs=0.02)


def test_a_cycle_on_another_path_is_placed_by_time_and_counted(tmp_path: Path) -> None:
    results = analyse(tmp_path, RunSpec(n_cycles=4, change_state=without_register(far_cycle=2)))
    assert results.methods["cycles"] == f"{BY_PATH} (1 of 4 cycles by time: they took another path)"
    assert np.isfinite(results.frames.cycle_phase[results.frames.cycle_index >= 0]).all()


def test_a_robot_that_says_neither_leaves_the_time(tmp_path: Path) -> None:
    results = analyse(tmp_path, RunSpec(change_state=lambda state: replace(state, cycle_phase=float("nan"))))
    assert results.methods["cycles"] == "robot's counter, phase by time"
