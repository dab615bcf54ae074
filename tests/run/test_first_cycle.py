"""The first cycle at a low speed slider, on a fake robot and a manual clock."""

from __future__ import annotations

from itertools import pairwise

import pytest
from engine_setup import Setup
from fake_robot import FakeRobot

from bench.config import PolicyConfig, parse_config, simulated_config_text
from bench.errors import ConfigError, CycleTimeoutError, DeviceStateError, DeviceTimeoutError
from bench.model import CycleEvent, CycleEventKind, ExitStatus, RunState
from bench.run.conditions import ConditionKind
from bench.run.guards import DiskGuard
from bench.run.inbox import AbortRequested, ConditionCleared, StopRequested
from bench.run.progress import RunLimits
from bench.timing import ManualClock

IN_FIRST_CYCLE = 30
"""At a fifth of the speed the first cycle takes 50 ticks."""


def durations_s(setup: Setup) -> list[float]:
    marks = [
        r.controller_time_s
        for r in setup.records
        if isinstance(r, CycleEvent) and r.kind in (CycleEventKind.STARTED, CycleEventKind.COMPLETED)
    ]
    return [end - start for start, end in list(pairwise(marks))[::2]]


def test_the_first_cycle_is_slow_and_all_others_are_as_ever() -> None:
    setup = Setup(4, first_cycle_speed=0.2)
    assert setup.engine.run().status is ExitStatus.SUCCESS
    assert durations_s(setup) == pytest.approx([2.0, 0.4, 0.4, 0.4])
    assert setup.progress.n_slowed == 1


def test_a_run_that_goes_on_with_another_has_a_slow_first_cycle_of_its_own() -> None:
    setup = Setup(8, n_before=5, first_cycle_speed=0.2)
    assert setup.engine.run().status is ExitStatus.SUCCESS
    assert durations_s(setup) == pytest.approx([2.0, 0.4, 0.4])
    slowed = [r.cycle_index for r in setup.records if isinstance(r, CycleEvent) and "20%" in r.detail]
    assert slowed == [5]


def test_the_slider_is_low_before_the_program_starts_and_back_before_the_second_grant() -> None:
    setup = Setup(3, first_cycle_speed=0.2)
    at_grant: list[tuple[int, float]] = []
    grant = setup.robot.grant_cycles
    setup.robot.grant_cycles = lambda total: (at_grant.append((total, setup.watcher.speed_fraction)), grant(total))[1]  # type: ignore[method-assign,func-returns-value]
    setup.engine.run()
    assert setup.robot.commands == ["slider 0.2", "play", "slider 1", "stop"]
    assert at_grant[1:] == [(1, 0.2), (2, 1.0), (3, 1.0)]


def test_whoever_stands_at_the_pendant_can_move_the_slider_in_between() -> None:
    setup = Setup(3, first_cycle_speed=0.2)
    setup.engine.run()
    assert setup.robot.slider_moves == [0.2, None, 1.0, None]


def test_the_policy_for_a_moved_slider_takes_no_notice_of_our_own_moves() -> None:
    setup = Setup(4, policy=PolicyConfig(slider_moved="abort"), first_cycle_speed=0.2)
    assert setup.engine.run().status is ExitStatus.SUCCESS


def test_a_slider_somebody_moves_in_the_first_cycle_is_waited_for_before_it_is_set_back() -> None:
    setup = Setup(3, first_cycle_speed=0.2)
    setup.robot.at_tick[IN_FIRST_CYCLE] = lambda robot: setattr(robot, "speed_fraction", 0.1)
    setup.robot.at_tick[400] = lambda robot: setattr(robot, "speed_fraction", 0.2)
    assert setup.engine.run().status is ExitStatus.SUCCESS
    assert RunState.HOLDING in setup.entered()
    assert any("Put the speed slider back to 20%." in note for note in setup.notes)
    assert setup.robot.speed_fraction == 1.0


def test_after_the_first_cycle_a_moved_slider_counts_again() -> None:
    setup = Setup(9, policy=PolicyConfig(slider_moved="abort"), first_cycle_speed=0.2)
    setup.robot.at_tick[90] = lambda robot: setattr(robot, "speed_fraction", 0.5)
    with pytest.raises(DeviceStateError, match="moved from 100% to 50%"):
        setup.engine.run()


def test_the_operator_and_the_record_are_told_of_the_slow_cycle() -> None:
    setup = Setup(2, first_cycle_speed=0.2)
    setup.engine.run()
    words = "driven with the speed slider at 20% ([run] first_cycle_speed)"
    assert f"The first cycle is {words}: watch it." in setup.notes
    granted = [r for r in setup.records if isinstance(r, CycleEvent) and r.kind is CycleEventKind.GRANTED]
    assert [event.detail for event in granted] == [words, ""]
    assert "the speed slider is back at 100%" in setup.said()


def test_the_limit_of_a_cycle_is_longer_where_the_cycle_is_slower() -> None:
    setup = Setup(2, RunLimits(cycle_s=20.0), first_cycle_speed=0.1)
    setup.robot.at_tick[IN_FIRST_CYCLE] = lambda robot: setattr(robot, "_move", lambda: None)
    with pytest.raises(CycleTimeoutError, match="did not end within 200 s"):
        setup.engine.run()


@pytest.mark.parametrize("events", [(StopRequested(), AbortRequested()), (AbortRequested(),)])
def test_a_run_that_is_aborted_in_the_first_cycle_sets_the_slider_back_when_the_robot_stands(
    events: tuple[StopRequested | AbortRequested, ...],
) -> None:
    setup = Setup(3, first_cycle_speed=0.2)
    setup.robot.at_tick[IN_FIRST_CYCLE] = lambda _robot: [setup.inbox.put(event) for event in events]  # type: ignore[assignment,return-value]
    setup.engine.run()
    assert setup.robot.commands[-1] == "slider 1"
    assert "stop" in setup.robot.commands
    assert setup.robot.speed_fraction == 1.0
    assert setup.progress.warnings == []


def test_a_run_that_ends_after_the_first_cycle_sets_the_slider_back() -> None:
    setup = Setup(1, first_cycle_speed=0.2)
    setup.engine.run()
    assert setup.robot.speed_fraction == 1.0


def test_a_robot_that_could_not_be_stopped_keeps_its_low_speed_and_the_operator_is_told() -> None:
    setup = Setup(1, first_cycle_speed=0.2)

    def refuse() -> None:
        raise DeviceStateError("It will not.")

    setup.robot.stop = refuse  # type: ignore[method-assign]
    setup.engine.run()
    assert setup.robot.speed_fraction == 0.2
    assert "The speed slider was left low; before the run it stood at 100%." in setup.progress.warnings


def test_a_slider_that_does_not_go_back_ends_the_run_before_the_second_cycle() -> None:
    setup = Setup(3, first_cycle_speed=0.2)
    setup.robot.at_tick[IN_FIRST_CYCLE] = lambda robot: setattr(robot, "slider_stuck", True)
    with pytest.raises(DeviceTimeoutError, match="stands at 20% and did not go to 100% within 10 s"):
        setup.engine.run()
    assert setup.kinds(CycleEventKind.GRANTED) == [0]
    assert "was left low" in setup.said()


def test_a_slider_that_does_not_go_down_keeps_the_program_from_starting() -> None:
    setup = Setup(3, first_cycle_speed=0.2)
    setup.robot.slider_stuck = True
    with pytest.raises(DeviceTimeoutError, match="did not go to 20%"):
        setup.engine.run()
    assert "play" not in setup.robot.commands


def test_a_slider_that_stands_lower_already_is_left_alone() -> None:
    setup = Setup(3, first_cycle_speed=0.2)
    setup.robot.speed_fraction = 0.1
    setup.robot.advance()
    setup.engine.run()
    assert setup.robot.slider_moves == []


def test_a_link_that_is_lost_while_the_slider_goes_back_is_waited_for() -> None:
    setup = Setup(3, first_cycle_speed=0.2)

    def restore(robot: FakeRobot) -> None:
        robot.link_broken = False
        setup.inbox.put(ConditionCleared(ConditionKind.ROBOT_LINK_LOST))

    setup.robot.at_tick[IN_FIRST_CYCLE] = lambda robot: setattr(robot, "link_broken", True)
    setup.robot.at_tick[300] = restore
    assert setup.engine.run().status is ExitStatus.SUCCESS
    assert RunState.HOLDING in setup.entered()
    assert setup.robot.commands == ["slider 0.2", "play", "slider 1", "stop"]


def test_what_a_slow_first_cycle_took_on_the_disk_foretells_nothing_of_the_others() -> None:
    policy, clock, events = PolicyConfig(), ManualClock(), list[object]()
    reserve, written = policy.free_space_mb * 10**6, 0
    guard = DiskGuard(policy, clock, events.append, lambda: reserve + 2_000, lambda: written)
    for n_completed in range(10):
        guard.poll(n_completed, 1000)
        written += 50 if n_completed == 0 else 1
        clock.advance_ns(2 * 10**9)
    assert events == []
    written += 100
    guard.poll(10, 1000)
    assert len(events) == 1


def test_a_program_that_waits_for_no_grant_cannot_have_a_slow_first_cycle() -> None:
    text = simulated_config_text().replace("[run]", "[run]\nfirst_cycle_speed = 0.2")
    text = text.replace('source = "counter"', 'source = "joint_return"')
    with pytest.raises(ConfigError, match="first_cycle_speed needs a program that waits for a grant"):
        parse_config(text, "lab.toml")
