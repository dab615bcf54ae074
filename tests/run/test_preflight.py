"""Every preflight item, passing and failing, without a device."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.config import Config, load_config, parse_config, simulated_config, simulated_config_text
from bench.drivers.base import SpeedControl
from bench.drivers.robot import make_state_stream
from bench.errors import DeviceStateError, PreflightError
from bench.model import RobotState, StampKind, TrackerFrame
from bench.run.cycle_watcher import CycleWatcher
from bench.run.preflight import check_bench, predict_bytes_per_s, verify_items
from bench.run.tally import FrameTally, RobotTally
from bench.timing import ManualClock

CONFIGS = Path(__file__).parents[2] / "bench_configs"


class FakeProgram:
    ready_when = "awake"

    def __init__(self, reasons: list[str] | None = None, missing: bool = False) -> None:
        self.reasons, self.missing = reasons or [], missing

    def open(self) -> None: ...

    def check(self, program: str) -> list[str]:
        return self.reasons

    def load(self, program: str) -> None:
        if self.missing:
            raise DeviceStateError(f"The controller has no program '{program}'.")

    def play(self) -> None: ...

    def stop(self) -> None: ...

    def close(self) -> None: ...


def make_state(i: int, rate_hz: float = 125.0, speed_fraction: float = 1.0) -> RobotState:
    time_s = 61.25 + i / rate_hz
    return RobotState(i, i, i, 0, time_s, speed_fraction=speed_fraction)


def make_frame(i: int, n_unlabeled: int = 11, rate_hz: float = 100.0) -> TrackerFrame:
    ns = round(i * 1e9 / rate_hz)
    flags = np.full(n_unlabeled, 0x12, dtype=np.uint32)
    points = np.zeros((n_unlabeled, 3), dtype=np.float32)
    return TrackerFrame(ns, ns, i, i, StampKind.MID_EXPOSURE, points, flags, flags, points[:, 0])


def check(
    tmp_path: Path,
    program: FakeProgram | None = None,
    robot_rate_hz: float = 125.0,
    tracker_rate_hz: float = 100.0,
    n_unlabeled: int = 11,
    n_frames: int = 100,
    slider: float = 1.0,
    expected_s: float | None = 40.0,
    speed: float = 1.0,
    config: Config | None = None,
    has_slider: bool = True,
) -> dict[str, tuple[str, str]]:
    robot, tracker = RobotTally(), FrameTally()
    watcher = CycleWatcher(lambda _event: None, lambda _record: None)
    tracker.nominal_rate_hz = 100.0
    for i in range(125):
        state = make_state(i, robot_rate_hz, slider)
        robot.update(state)
        watcher.update(state)
    for i in range(n_frames):
        tracker.update(make_frame(i, n_unlabeled, tracker_rate_hz))
    items = check_bench(
        config or simulated_config(),
        program or FakeProgram(),
        watcher,
        robot,
        tracker,
        tmp_path,
        expected_s,
        speed,
        has_slider=has_slider,
    )
    assert {item.limit for item in items if item.name == "robot ready"} == {"awake"}
    failed = [item for item in items if item.verdict == "fail"]
    if failed:
        with pytest.raises(PreflightError) as caught:
            verify_items(items)
        assert len(caught.value.failures) == len(failed)
        assert caught.value.exit_code == failed[0].exit_code
    else:
        verify_items(items)
    return {item.name: (item.verdict, item.sentence) for item in items}


def test_a_bench_that_is_ready_passes_every_item(tmp_path: Path) -> None:
    verdicts = {name: verdict for name, (verdict, _) in check(tmp_path).items()}
    assert verdicts.pop("frame rate") == "open"
    assert set(verdicts.values()) == {"ok"}
    assert len(verdicts) == 7


def test_the_frame_rate_must_be_the_speed_over_the_accuracy(tmp_path: Path) -> None:
    # the paper's own figures: 1000 mm/s over 10 mm ask for 100 frames/s
    def verdict_at(speed_m_s: float, accuracy_mm: float = 10.0) -> str:
        text = simulated_config_text().replace("[cable]", f"[cable]\nmax_speed_m_s = {speed_m_s}")
        text = text.replace("[tracker]", f"[tracker]\naccuracy_mm = {accuracy_mm}")
        return check(tmp_path, config=parse_config(text, "lab.toml"))["frame rate"][0]

    assert verdict_at(1.0) == "ok"
    assert verdict_at(1.1) == "warn"
    assert verdict_at(1.1, accuracy_mm=12.0) == "ok"


def test_a_frame_rate_that_is_too_low_says_what_it_does_reach(tmp_path: Path) -> None:
    text = simulated_config_text().replace("[cable]", "[cable]\nmax_speed_m_s = 2.5")
    sentence = check(tmp_path, config=parse_config(text, "lab.toml"))["frame rate"][1]
    assert "goes 25.0 mm between two frames" in sentence


def test_a_speed_nobody_knows_is_said_and_not_guessed(tmp_path: Path) -> None:
    verdict, sentence = check(tmp_path)["frame rate"]
    assert verdict == "open"
    assert "not known" in sentence
    assert "max_speed_m_s" in sentence


def test_every_failure_is_reported_at_once(tmp_path: Path) -> None:
    items = check(tmp_path, FakeProgram(["The robot is in local mode."]), robot_rate_hz=100.0, n_unlabeled=0)
    assert [name for name, (verdict, _) in items.items() if verdict == "fail"] == [
        "robot ready",
        "robot rate",
        "markers",
    ]


def test_a_program_that_the_controller_does_not_have_fails(tmp_path: Path) -> None:
    assert check(tmp_path, FakeProgram(missing=True))["program loaded"][1] == (
        "The controller has no program 'bend_test.urp'."
    )


def test_a_slider_below_full_is_a_warning(tmp_path: Path) -> None:
    verdict, sentence = check(tmp_path, slider=0.5)["speed slider"]
    assert verdict == "warn"
    assert "50%" in sentence


@pytest.mark.parametrize("case", [{"has_slider": False}, {"slider": math.nan}])
def test_a_slow_first_cycle_needs_a_slider_that_can_be_moved_and_seen(tmp_path: Path, case: dict[str, Any]) -> None:
    text = simulated_config_text().replace("[run]", "[run]\nfirst_cycle_speed = 0.2")
    verdict, sentence = check(tmp_path, config=parse_config(text, "lab.toml"), **case)["speed slider"]
    assert verdict == "fail"
    assert sentence.startswith("[run] first_cycle_speed = 0.2 needs a robot with a speed slider")
    assert check(tmp_path, **case)["speed slider"][0] == "ok"


@pytest.mark.parametrize(("name", "can_be_moved"), [("lab_example.toml", True), ("modbus_generic_plc.toml", False)])
def test_only_robots_with_a_slider_have_one_that_can_be_moved(name: str, can_be_moved: bool) -> None:
    config = load_config(CONFIGS / name)
    assert config.robot is not None
    assert isinstance(make_state_stream(config.robot, ManualClock()), SpeedControl) is can_be_moved


@pytest.mark.parametrize(
    ("name", "key"), [("lab_example.toml", "rate_hz"), ("modbus_generic_plc.toml", "poll_rate_hz")]
)
def test_a_slow_robot_stream_names_the_key_that_its_kind_has(tmp_path: Path, name: str, key: str) -> None:
    sentence = check(tmp_path, config=load_config(CONFIGS / name), robot_rate_hz=10.0)["robot rate"][1]
    assert f"set [robot] {key} to what it can give" in sentence


def test_a_hidden_marker_is_a_warning_and_no_marker_a_failure(tmp_path: Path) -> None:
    assert check(tmp_path, n_unlabeled=9)["markers"][0] == "warn"
    verdict, sentence = check(tmp_path, n_unlabeled=0)["markers"]
    assert verdict == "fail"
    assert "no markers" in sentence


def test_a_tracker_without_frames_is_told_from_a_slow_one(tmp_path: Path) -> None:
    assert "streams no frames" in check(tmp_path, n_frames=0)["tracker rate"][1]
    assert "50.0 of 100" in check(tmp_path, tracker_rate_hz=50.0)["tracker rate"][1]


def test_at_a_scaled_clock_a_slow_stream_speaks_of_the_machine(tmp_path: Path) -> None:
    assert "--speed 100" in check(tmp_path, tracker_rate_hz=50.0, speed=100.0)["tracker rate"][1]


def test_a_disk_that_cannot_hold_the_run_fails(tmp_path: Path) -> None:
    verdict, sentence = check(tmp_path, expected_s=1e12)["disk space"]
    assert verdict == "fail"
    assert re.search(r"has \d+ [MG]B free, \d+ GB are asked for \(this run", sentence)


def test_the_predicted_size_is_the_right_order_of_magnitude() -> None:
    # 1000 cycles of 2.03 s with 11 points gave 110 MB on the simulated bench: 54 kB/s of robot and tracker time
    predicted = predict_bytes_per_s(simulated_config(), 100.0, 11)
    assert 54e3 < predicted < 160e3
