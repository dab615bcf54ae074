"""What the policies do about each condition, on a fake robot and a manual clock."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from engine_setup import Setup
from fake_robot import FakeRobot

import bench
from bench.config import PolicyConfig
from bench.errors import (
    BenchError,
    CycleTimeoutError,
    DeviceStateError,
    DeviceTimeoutError,
    DiskFullError,
    LinkLostError,
)
from bench.model import CycleEvent, CycleEventKind, ExitStatus, RunState, StateChange
from bench.run.conditions import ConditionKind, describe_lost_link
from bench.run.inbox import ConditionCleared, ConditionRaised, StopRequested
from bench.run.progress import RunLimits

HOLD = [RunState.RUNNING, RunState.HOLDING, RunState.RUNNING, RunState.STOPPING]
IN_CYCLE_2, BETWEEN_RESUMES, LATER = 30, 60, 90


def put(name: str, value: object) -> Callable[[FakeRobot], None]:
    return lambda robot: setattr(robot, name, value)


def stop_and_resume(setup: Setup, status: int = 3) -> None:
    """Stop in cycle 2, clear the stop later, and have a person resume still later."""
    robot = setup.robot
    robot.at_tick[IN_CYCLE_2] = lambda robot: (put("paused", True)(robot), put("safety_status", status)(robot))
    robot.at_tick[BETWEEN_RESUMES] = put("safety_status", 1)
    robot.at_tick[LATER] = put("paused", False)


@pytest.mark.parametrize(("status", "words"), [(3, "Protective stop"), (5, "Safeguard stop"), (1, "was paused")])
def test_a_robot_that_stops_is_waited_for_and_the_run_ends_with_every_cycle(status: int, words: str) -> None:
    setup = Setup(5)
    stop_and_resume(setup, status)
    ending = setup.engine.run()
    assert ending.status is ExitStatus.SUCCESS
    assert setup.kinds(CycleEventKind.COMPLETED) == list(range(5))
    assert setup.entered()[-4:] == HOLD
    assert f"{words} in cycle" in setup.said() or words in setup.said()


def test_the_cycle_in_which_the_robot_stood_is_marked_interrupted_once_with_the_reason() -> None:
    setup = Setup(5)
    stop_and_resume(setup)
    setup.engine.run()
    (event,) = [r for r in setup.records if isinstance(r, CycleEvent) and r.kind is CycleEventKind.INTERRUPTED]
    assert event.cycle_index == 2
    assert "Protective stop in cycle 2" in event.detail


def test_after_a_stop_is_cleared_the_run_still_waits_for_a_person_to_resume() -> None:
    setup = Setup(5)
    stop_and_resume(setup)
    setup.engine.run()
    back = next(r.host_ns for r in setup.records if isinstance(r, StateChange) and r.reason == "as before again")
    assert back >= setup.records[0].host_ns + (LATER - 1) * 40_000_000  # type: ignore[union-attr]  # a StateChange
    assert any("Resume the program at the pendant." in note for note in setup.notes)


@pytest.mark.parametrize("status", [3, 5, 1])
def test_bench_never_releases_a_stop_and_never_resumes_a_program(status: int) -> None:
    setup = Setup(5)
    stop_and_resume(setup, status)
    setup.engine.run()
    assert setup.robot.commands == ["play", "stop"]


@pytest.mark.parametrize(
    "cause",
    [
        lambda setup: setup.robot.emergency_stop(),
        lambda setup: put("playing", False)(setup.robot),
        lambda setup: put("count", 5)(setup.robot),
        lambda setup: put("_move", lambda: None)(setup.robot),
        lambda setup: setup.robot.protective_stop(),
        lambda setup: lose_link(setup),
        lambda setup: setup.inbox.fail(DiskFullError("The disk is full.")),
    ],
    ids=["emergency stop", "program ended", "counter", "cycle hangs", "hold too long", "link never back", "disk full"],
)
def test_whatever_ends_a_run_the_robot_is_told_to_stop_and_nothing_else(cause: Callable[[Setup], object]) -> None:
    setup = Setup(4, RunLimits(cycle_s=20.0, hold_s=60.0))
    setup.robot.at_tick[IN_CYCLE_2] = lambda _robot: cause(setup)
    with pytest.raises(BenchError):
        setup.engine.run()
    assert [command for command in setup.robot.commands if command != "check"] == ["play", "stop"]
    assert setup.robot.granted == (3 if setup.robot.link_broken else 0)  # a link that is gone takes nothing back
    assert setup.kinds(CycleEventKind.GRANTED) == [0, 1, 2]
    assert setup.kinds(CycleEventKind.INTERRUPTED) == [2]


def test_no_command_that_would_make_a_stopped_robot_go_on_is_in_the_product() -> None:
    product = Path(bench.__file__).parent
    robots = [path for path in product.rglob("*.py") if "simulation" not in path.parts]
    text = "\n".join(path.read_text(encoding="utf-8") for path in robots)
    for command in (
        r"unlock.?protective.?stop",
        r"close.?safety.?popup",
        r"restart.?safety",
        r"brake.?release",
        r"['\"]power on['\"]|powerOn|POWER_ON",
    ):
        assert not re.search(command, text, re.IGNORECASE), command


def test_the_screen_says_what_to_do_and_no_more_once_it_is_done() -> None:
    setup = Setup(5)
    stop_and_resume(setup)
    setup.engine.run()
    assert any("clear the stop at the pendant" in note for note in setup.notes)
    assert setup.notes[-1] == ""


def test_a_stopped_robot_may_stand_longer_than_a_cycle_may_take() -> None:
    setup = Setup(4, RunLimits(cycle_s=1.0))
    setup.robot.at_tick[IN_CYCLE_2] = lambda robot: robot.protective_stop()
    setup.robot.at_tick[500] = lambda robot: (put("paused", False)(robot), put("safety_status", 1)(robot))
    assert setup.engine.run().status is ExitStatus.SUCCESS


def test_time_before_the_stop_still_counts_towards_the_cycle() -> None:
    setup = Setup(4, RunLimits(cycle_s=3.0))
    stop_and_resume(setup)
    setup.robot.at_tick[LATER + 1] = put("_move", lambda: None)
    with pytest.raises(CycleTimeoutError):
        setup.engine.run()


def test_a_hold_that_lasts_too_long_ends_the_run() -> None:
    setup = Setup(4, policy=PolicyConfig(hold_timeout_s=60.0))
    setup.robot.at_tick[IN_CYCLE_2] = lambda robot: robot.protective_stop()
    with pytest.raises(DeviceTimeoutError, match=r"held for 60 s.*Protective stop"):
        setup.engine.run()
    assert setup.states.state is RunState.ABORTING
    assert setup.kinds(CycleEventKind.INTERRUPTED) == [2]


def test_an_emergency_stop_aborts_and_says_so() -> None:
    setup = Setup(4)
    setup.robot.at_tick[IN_CYCLE_2] = lambda robot: robot.emergency_stop()
    with pytest.raises(DeviceStateError, match="Robot emergency stop in cycle 2"):
        setup.engine.run()
    assert setup.kinds(CycleEventKind.INTERRUPTED) == [2]


def test_a_program_that_was_replaced_is_named_by_what_the_robot_says() -> None:
    setup = Setup(4)
    setup.robot.reasons = ["On the controller 'other.urp', another program, is playing already."]
    setup.robot.at_tick[IN_CYCLE_2] = put("playing", False)
    with pytest.raises(DeviceStateError, match=r"program stopped in cycle 2. On the controller 'other.urp'"):
        setup.engine.run()


def lose_link(setup: Setup) -> None:
    """Do what the state stream does: the samples stop, and it says so."""
    setup.robot.is_heard = False
    setup.robot.link_broken = True
    setup.inbox.put(ConditionRaised(describe_lost_link(LinkLostError("The controller is gone."), setup.clock.now_ns())))


def restore_link(setup: Setup) -> None:
    setup.robot.is_heard = True
    setup.robot.link_broken = False
    setup.inbox.put(ConditionCleared(ConditionKind.ROBOT_LINK_LOST))


@pytest.mark.parametrize("lost_at", range(25, 40))
@pytest.mark.parametrize("away", [1, 5, 12, 100])
def test_a_link_that_comes_back_costs_no_cycle_and_counts_none_twice(lost_at: int, away: int) -> None:
    setup = Setup(8)
    setup.robot.at_tick[lost_at] = lambda _robot: lose_link(setup)
    setup.robot.at_tick[lost_at + away] = lambda _robot: restore_link(setup)
    assert setup.engine.run().status is ExitStatus.SUCCESS
    assert setup.kinds(CycleEventKind.COMPLETED) == list(range(8))
    assert setup.kinds(CycleEventKind.GRANTED) == list(range(8))
    assert setup.robot.count == 8


def test_a_lost_link_aborts_where_that_is_the_policy() -> None:
    setup = Setup(8, policy=PolicyConfig(robot_link_lost="abort"))
    setup.robot.at_tick[IN_CYCLE_2] = lambda _robot: lose_link(setup)
    with pytest.raises(LinkLostError, match="controller is gone"):
        setup.engine.run()


def test_a_silent_tracker_holds_between_cycles_until_frames_come_again() -> None:
    setup = Setup(20)
    setup.robot.at_tick[IN_CYCLE_2] = lambda _robot: setattr(setup, "has_frames", False)
    setup.robot.at_tick[300] = lambda _robot: setattr(setup, "has_frames", True)
    assert setup.engine.run().status is ExitStatus.SUCCESS
    assert setup.entered()[-4:] == HOLD
    assert setup.kinds(CycleEventKind.INTERRUPTED) == []
    held = next(i for i, r in enumerate(setup.records) if isinstance(r, StateChange) and r.state is RunState.HOLDING)
    before = [r.kind for r in setup.records[:held] if isinstance(r, CycleEvent)]
    assert before[-1] is CycleEventKind.COMPLETED


def test_the_slider_holds_until_it_is_back_where_it_was() -> None:
    setup = Setup(6)
    setup.robot.at_tick[IN_CYCLE_2] = put("speed_fraction", 0.5)
    setup.robot.at_tick[200] = put("speed_fraction", 1.0)
    assert setup.engine.run().status is ExitStatus.SUCCESS
    assert any("Put the speed slider back to 100%." in note for note in setup.notes)


def test_a_run_begun_with_the_slider_at_half_goes_on_there() -> None:
    setup = Setup(3)
    setup.robot.speed_fraction = 0.5
    assert setup.engine.run().status is ExitStatus.SUCCESS
    assert RunState.HOLDING not in setup.entered()


def test_packages_that_are_all_late_hold_the_run() -> None:
    setup = Setup(12)
    setup.robot.at_tick[IN_CYCLE_2] = lambda _robot: setattr(setup, "lag_ns", 300_000_000)
    setup.robot.at_tick[150] = lambda _robot: setattr(setup, "lag_ns", 0)
    assert setup.engine.run().status is ExitStatus.SUCCESS
    assert setup.entered()[-4:] == HOLD


def test_a_disk_that_fills_ends_the_run_after_the_cycle() -> None:
    setup = Setup(50)
    setup.robot.at_tick[IN_CYCLE_2] = lambda _robot: setattr(setup, "free_bytes", 10**8)
    ending = setup.engine.run()
    assert ending.status is ExitStatus.ABORT
    assert "The disk has 100 MB free" in ending.reason
    assert setup.kinds(CycleEventKind.INTERRUPTED) == []


def test_a_run_that_will_not_fit_the_disk_is_told_by_its_first_cycles() -> None:
    setup = Setup(1000)
    setup.bytes_per_cycle, setup.free_bytes = 10**7, 10**9
    ending = setup.engine.run()
    assert ending.status is ExitStatus.ABORT
    assert setup.progress.n_completed < 20


@pytest.mark.parametrize(
    ("key", "error", "cause"),
    [
        ("tracker_silent", LinkLostError, lambda setup: setattr(setup, "has_frames", False)),
        ("protective_stop", DeviceStateError, lambda setup: setup.robot.protective_stop()),
        ("slider_moved", DeviceStateError, lambda setup: setattr(setup.robot, "speed_fraction", 0.5)),
        ("disk_low", DiskFullError, lambda setup: setattr(setup, "free_bytes", 0)),
    ],
)
def test_each_condition_can_abort(key: str, error: type[Exception], cause: Callable[[Setup], None]) -> None:
    setup = Setup(100, policy=PolicyConfig.model_validate({key: "abort"}))
    setup.robot.at_tick[IN_CYCLE_2] = lambda _robot: cause(setup)
    with pytest.raises(error):
        setup.engine.run()
    assert setup.robot.stopped_calls == 1


def test_each_condition_can_stop_the_run_after_the_cycle() -> None:
    setup = Setup(100, policy=PolicyConfig(slider_moved="stop"))
    setup.robot.at_tick[IN_CYCLE_2] = put("speed_fraction", 0.5)
    ending = setup.engine.run()
    assert "slider was moved" in ending.reason
    assert setup.progress.n_completed == setup.robot.count == 3


def test_ctrl_c_while_holding_ends_the_run_in_order() -> None:
    setup = Setup(100)
    setup.robot.at_tick[IN_CYCLE_2] = put("speed_fraction", 0.5)
    setup.robot.at_tick[100] = lambda _robot: setup.inbox.put(StopRequested())
    assert setup.engine.run().reason == "stopped by the operator after 3 of 100 cycles"
    assert setup.entered()[-2:] == [RunState.HOLDING, RunState.STOPPING]


def test_a_program_that_will_not_stop_after_its_last_cycle_is_a_warning() -> None:
    setup = Setup(2)

    def refuse() -> None:
        raise DeviceStateError("The controller is in local mode.")

    setup.robot.stop = refuse  # type: ignore[method-assign]
    assert setup.engine.run().status is ExitStatus.SUCCESS
    assert "local mode" in setup.progress.warnings[0]
