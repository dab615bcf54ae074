"""The run engine against a fake robot and a manual clock."""

from __future__ import annotations

from collections import Counter

import pytest
from engine_setup import Setup
from fake_robot import FakeRobot

from bench.errors import CycleSequenceError, CycleTimeoutError, DeviceStateError, DeviceTimeoutError, LinkLostError
from bench.model import CycleEvent, CycleEventKind, ExitStatus, RunState, StateChange
from bench.run.inbox import AbortRequested, StopRequested
from bench.run.progress import RunLimits


def test_a_thousand_cycles_are_each_granted_started_and_completed_once() -> None:
    setup = Setup(1000)
    ending = setup.engine.run()
    assert ending.status is ExitStatus.SUCCESS
    for kind in (CycleEventKind.GRANTED, CycleEventKind.STARTED, CycleEventKind.COMPLETED):
        assert setup.kinds(kind) == list(range(1000))
    assert setup.robot.stopped_calls == 1
    assert setup.progress.n_completed == 1000


def test_a_run_that_goes_on_with_another_numbers_on_and_grants_from_one() -> None:
    setup = Setup(8, n_before=5)
    assert setup.engine.run().reason == "8 of 8 cycles completed"
    for kind in (CycleEventKind.GRANTED, CycleEventKind.STARTED, CycleEventKind.COMPLETED):
        assert setup.kinds(kind) == [5, 6, 7]
    assert setup.robot.granted == setup.robot.count == 3


def test_the_cycle_marked_in_a_run_that_goes_on_has_its_own_number() -> None:
    setup = Setup(8, n_before=5)
    setup.robot.at_tick[30] = lambda robot: robot.emergency_stop()
    with pytest.raises(DeviceStateError, match="in cycle 7"):
        setup.engine.run()
    assert setup.kinds(CycleEventKind.INTERRUPTED) == [7]


def test_grants_left_by_an_earlier_run_are_withdrawn_before_the_program_plays() -> None:
    setup = Setup(2)
    setup.robot.granted = 20
    granted_at_play = []
    play = setup.robot.play
    setup.robot.play = lambda: (granted_at_play.append(setup.robot.granted), play())[1]  # type: ignore[method-assign]
    setup.engine.run()
    assert granted_at_play == [0]
    assert setup.robot.count == 2


def test_the_first_ctrl_c_ends_the_run_after_the_current_cycle() -> None:
    setup = Setup(10)
    setup.robot.at_tick[38] = lambda _robot: setup.inbox.put(StopRequested())
    ending = setup.engine.run()
    assert ending.status is ExitStatus.ABORT
    assert 0 < setup.progress.n_completed < 10
    assert setup.kinds(CycleEventKind.INTERRUPTED) == []
    assert setup.robot.count == setup.progress.n_completed
    assert setup.states.state is RunState.STOPPING


def test_the_second_ctrl_c_ends_the_run_at_once_and_marks_the_cycle() -> None:
    setup = Setup(10)
    setup.robot.at_tick[38] = lambda _robot: (setup.inbox.put(StopRequested()), setup.inbox.put(AbortRequested()))
    ending = setup.engine.run()
    assert ending.status is ExitStatus.ABORT
    assert setup.kinds(CycleEventKind.INTERRUPTED) == [setup.progress.n_completed]
    assert setup.robot.stopped_calls == 1
    assert setup.states.state is RunState.ABORTING


def test_a_lost_link_stops_the_program_and_is_raised() -> None:
    setup = Setup(10)
    setup.robot.at_tick[30] = lambda _robot: setup.inbox.fail(LinkLostError("gone"))
    with pytest.raises(LinkLostError, match="gone"):
        setup.engine.run()
    assert setup.robot.stopped_calls == 1
    assert setup.states.state is RunState.ABORTING


def test_an_error_while_stopping_does_not_hide_the_first_one() -> None:
    setup = Setup(10)

    def break_everything(robot: FakeRobot) -> None:
        robot.link_broken = True
        setup.inbox.fail(DeviceStateError("first"))

    setup.robot.at_tick[30] = break_everything
    with pytest.raises(DeviceStateError, match="first"):
        setup.engine.run()


def test_a_counter_that_jumps_is_an_error_and_never_a_count() -> None:
    setup = Setup(10)
    setup.robot.at_tick[30] = lambda robot: setattr(robot, "count", robot.count + 2)
    with pytest.raises(CycleSequenceError, match="counter went from"):
        setup.engine.run()


def test_a_program_that_stops_by_itself_is_an_error() -> None:
    setup = Setup(10)
    setup.robot.at_tick[30] = lambda robot: setattr(robot, "playing", False)
    with pytest.raises(DeviceStateError, match="program stopped in cycle"):
        setup.engine.run()


def test_a_cycle_that_never_ends_times_out() -> None:
    setup = Setup(3, RunLimits(cycle_s=20.0))
    setup.robot.at_tick[12] = lambda robot: setattr(robot, "_move", lambda: None)
    with pytest.raises(CycleTimeoutError, match="did not end within 20 s"):
        setup.engine.run()


def test_a_program_without_the_snippet_is_told_apart_from_a_slow_one() -> None:
    setup = Setup(3)
    setup.robot.play = lambda: setattr(setup.robot, "playing", True)  # type: ignore[method-assign]  # keeps counter 7
    with pytest.raises(DeviceTimeoutError, match="counter 7"):
        setup.engine.run()


def test_the_run_states_are_recorded_in_order() -> None:
    setup = Setup(1)
    setup.engine.run()
    states = [r.state for r in setup.records if isinstance(r, StateChange)]
    assert states == [RunState.CONNECTING, RunState.CHECKING, RunState.ARMED, RunState.RUNNING, RunState.STOPPING]
    assert Counter(type(r) for r in setup.records)[CycleEvent] == 3
