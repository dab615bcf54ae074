"""Recordings that cannot calibrate anything say so in one sentence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from run_examples import ROBOT_HZ, RunSpec, write_run

from bench.errors import AnalysisError, BenchError, ConfigError
from bench.model import DeviceInfo, RigidBody
from bench.recording import open_run
from bench.report.calibration import calibrate_run

BODIES = [DeviceInfo("tracker", "natnet", "", bodies={1: "flange"})]


def fail_to_calibrate(folder: Path, spec: RunSpec, flange_body: str = "flange") -> BenchError:
    write_run(folder / "run.mcap", replace(spec, n_cycles=1, devices=BODIES))
    run = open_run(folder / "run.mcap")
    with pytest.raises(BenchError) as caught:
        calibrate_run(run, run.config, flange_body)
    return caught.value


def test_a_take_without_a_robot_has_nothing_to_calibrate_against(tmp_path: Path) -> None:
    told = fail_to_calibrate(tmp_path, RunSpec(robot=False))
    assert isinstance(told, AnalysisError)
    assert "no robot samples" in str(told)


def test_a_robot_that_tells_no_pose_is_named_as_the_reason(tmp_path: Path) -> None:
    assert "TCP pose is known in 0 samples" in str(fail_to_calibrate(tmp_path, RunSpec()))


def test_nothing_named_on_the_flange_is_a_fault_of_the_configuration(tmp_path: Path) -> None:
    told = fail_to_calibrate(tmp_path, tell_poses(RunSpec()), "")
    assert isinstance(told, ConfigError)
    assert "flange_body" in told.hint


def test_a_body_that_was_never_tracked_is_told(tmp_path: Path) -> None:
    lost = RigidBody(1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), tracking_valid=False)
    spec = tell_poses(RunSpec(change_points=lambda _, values: {**values, "bodies": (lost,)}))
    assert "tracked in 0 frames" in str(fail_to_calibrate(tmp_path, spec))


def test_a_recording_without_frames_is_told(tmp_path: Path) -> None:
    spec = tell_poses(RunSpec(change_points=lambda *_: None))
    assert "tracked in 0 frames" in str(fail_to_calibrate(tmp_path, spec))


def tell_poses(spec: RunSpec) -> RunSpec:
    return replace(
        spec, change_state=lambda state: replace(state, tcp_pose=(state.sequence / ROBOT_HZ, 0.0, 0.0, 0.0, 0.0, 0.0))
    )
