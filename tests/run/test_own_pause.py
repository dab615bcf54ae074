"""A bench that stood still itself: said and recorded, and held against no device."""

from __future__ import annotations

from engine_setup import Setup
from fake_robot import FakeRobot

from bench.model import CycleEventKind, ExitStatus, LogEntry, RunState, Severity
from bench.run.own_pause import OwnPause
from bench.timing import ManualClock


def test_only_a_turn_that_took_too_long_is_a_pause() -> None:
    clock, said = ManualClock(), []
    pause = OwnPause(clock, said.append)
    answers = []
    for step_ms in (0, 250, 1000, 1001, 250, 3200):
        clock.advance_ns(step_ms * 1_000_000)
        answers.append(pause.look())
    assert answers == [False, False, False, True, False, True]
    assert [entry.severity for entry in said] == [Severity.WARN, Severity.WARN]
    assert said[1].text.startswith("bench itself stood still for 3.2 s: ")
    assert said[1].host_ns == clock.now_ns()


def sleep_without_frames(setup: Setup, until_tick: int) -> None:
    """Let 5 s pass in which nothing runs, and frames come again only at a later tick."""

    def sleep(_robot: FakeRobot) -> None:
        setup.clock.advance_ns(5_000_000_000)
        setup.has_frames = False

    setup.robot.at_tick[30] = sleep
    setup.robot.at_tick[until_tick] = lambda _robot: setattr(setup, "has_frames", True)


def test_a_bench_that_slept_does_not_call_the_tracker_silent() -> None:
    setup = Setup(6)
    sleep_without_frames(setup, until_tick=45)
    assert setup.engine.run().status is ExitStatus.SUCCESS
    assert RunState.HOLDING not in setup.entered()
    assert setup.said().count("bench itself stood still for 5.") == 1
    assert setup.kinds(CycleEventKind.COMPLETED) == list(range(6))


def test_a_tracker_that_stays_silent_after_the_sleep_holds_the_run() -> None:
    setup = Setup(20)
    sleep_without_frames(setup, until_tick=300)
    assert setup.engine.run().status is ExitStatus.SUCCESS
    assert RunState.HOLDING in setup.entered()
    said = [entry for entry in setup.records if isinstance(entry, LogEntry)]
    slept = next(entry for entry in said if "stood still" in entry.text)
    silent = next(entry for entry in said if "sent no frame" in entry.text)
    assert silent.host_ns - slept.host_ns >= 2_000_000_000
