"""The watcher of cycles, the watch over pace, and the plan of a dry run."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.config import parse_config, simulated_config, simulated_config_text
from bench.errors import ConfigError, DeviceStateError
from bench.model import RobotState
from bench.run.cycle_watcher import CycleWatcher
from bench.run.inbox import CycleCompleted, CycleStarted, Event, Fault
from bench.run.options import RunOptions
from bench.run.pace import PaceWatch
from bench.run.plan import describe_plan
from bench.timing import ManualClock, RunClock

BASE = RobotState(0, 0, 0, 0, 61.25, runtime_state=2, safety_status=1, cycle_count=0, cycle_running=0)


def watch(states: list[RobotState]) -> list[Event]:
    events: list[Event] = []
    watcher = CycleWatcher(events.append, lambda _record: None)
    watcher.update(BASE)
    watcher.arm()
    for state in states:
        watcher.update(state)
    return events


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 5), st.integers(1, 5)), max_size=20))
def test_however_long_cycles_and_pauses_are_each_is_seen_once_and_in_order(lengths: list[tuple[int, int]]) -> None:
    states, expected = [], []
    for cycle_index, (moving, waiting) in enumerate(lengths):
        states += [dataclasses.replace(BASE, cycle_count=cycle_index, cycle_running=1)] * moving
        states += [dataclasses.replace(BASE, cycle_count=cycle_index + 1, cycle_running=0)] * waiting
        expected += [CycleStarted(cycle_index), CycleCompleted(cycle_index)]
    assert watch(states) == expected


def test_a_cycle_so_short_that_no_sample_shows_it_running_is_still_counted() -> None:
    assert watch([dataclasses.replace(BASE, cycle_count=1)]) == [CycleCompleted(0)]


def test_a_counter_that_falls_is_a_fault() -> None:
    events = watch([dataclasses.replace(BASE, cycle_count=1), BASE])
    assert isinstance(events[-1], Fault)


def test_a_counter_that_falls_with_the_controllers_time_is_a_restart() -> None:
    events = watch([dataclasses.replace(BASE, cycle_count=1), dataclasses.replace(BASE, controller_time_s=12.0)])
    assert isinstance(events[-1], Fault)
    assert isinstance(events[-1].error, DeviceStateError)
    assert "controller restarted in cycle 1, and its program is gone" in str(events[-1].error)


def test_a_stream_that_keeps_up_is_never_behind_whatever_its_drift() -> None:
    pace = PaceWatch(ManualClock())
    for second in range(3600):
        pace.update(second * 10**9, round(second * 1e9 * (1 + 60e-6)) + 700_000)
    assert not pace.is_behind


def test_a_stream_that_falls_behind_is_told_by_how_much() -> None:
    pace = PaceWatch(RunClock.start(speed=10.0))
    for tick in range(1000):
        pace.update(tick * 10**7, tick * 10**7 + max(0, tick - 500) * 10**7)
    assert pace.is_behind
    assert pace.largest_lag_ns == pytest.approx(5e9, rel=0.01)


def test_a_plan_tells_devices_duration_and_size() -> None:
    lines = "\n".join(describe_plan(simulated_config(), RunOptions(n_cycles=1000, speed=10.0)))
    assert "127.0.0.21" in lines
    assert "2000 s of simulated time, 200 s at --speed 10" in lines
    assert "Nothing was connected" in lines


def test_a_plan_for_a_real_bench_says_what_it_cannot_know() -> None:
    real = parse_config(simulated_config_text().split("[simulation]")[0], "lab.toml")
    lines = "\n".join(describe_plan(real, RunOptions(n_cycles=10, output=Path("a.mcap"))))
    assert "duration known after the first cycle" in lines
    assert "a.mcap" in lines


def test_a_configuration_without_devices_cannot_be_run() -> None:
    cable = parse_config("[cable]" + simulated_config_text().split("[cable]")[1].split("[simulation]")[0], "take.toml")
    with pytest.raises(ConfigError, match="no \\[robot\\] and no \\[tracker\\]"):
        describe_plan(cable, RunOptions(n_cycles=1))


def test_a_plan_says_how_many_parts_there_will_be() -> None:
    simulated = simulated_config()
    assert "parts" not in "\n".join(describe_plan(simulated, RunOptions(n_cycles=50)))
    split = simulated.model_copy(update={"run": simulated.run.model_copy(update={"split_mb": 1.0})})
    assert "parts    about 11, each of 1 MB: [run] split_mb" in describe_plan(split, RunOptions(n_cycles=50))
    real = split.model_copy(update={"simulation": None})
    assert "parts    about 432 for each hour, each of 1 MB: [run] split_mb" in describe_plan(
        real, RunOptions(n_cycles=9)
    )
