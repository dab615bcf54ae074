"""Cycles of robots that do not count: nothing lost and nothing twice, while the run watches and in the report."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import CounterColumns, CycleFollower, RobotSigns, count_cycles, find_cycles, make_cycle_source
from bench.config import CycleConfig
from bench.model import Record, RobotState
from bench.run.cycle_watcher import CycleWatcher
from bench.run.inbox import CycleCompleted, CycleStarted, Event

PERIOD_NS = 2_000_000
START_RAD = (0.3, -1.2, 1.1, -0.4, 1.5, 0.0)
LEVEL = CycleConfig(source="digital_output", digital_output=3)
PULSE = CycleConfig(source="digital_output", digital_output=3, digital_output_mode="pulse")
JOINTS = CycleConfig(source="joint_return", joint_tolerance_deg=0.5)
SOURCES = {"level": LEVEL, "pulse": PULSE, "joints": JOINTS}


@dataclass
class FreeRobot:
    """A program that repeats its path by itself: samples of its output and of its joints, other outputs noisy."""

    rng: np.random.Generator

    def __post_init__(self) -> None:
        self.states: list[RobotState] = []
        self._noise = self.rng.standard_normal((997, 12)).tolist()
        self._others = (self.rng.integers(0, 8, 997) | self.rng.integers(0, 2, 997) << 9).tolist()

    def stand(self, n: int, runtime_state: int = 2, output: bool = False) -> None:
        for _ in range(n):
            self._add(0.0, 0.0, output, runtime_state)

    def drive(self, n: int, high: int, share: float = 1.0, runtime_state: int = 2) -> None:
        """Go out and back in `n` samples with the output high in the first `high`; or only a share of that way."""
        for i in range(round(n * share)):
            phase = i / n
            way, speed = np.sin(np.pi * phase) ** 2, np.pi * np.sin(2 * np.pi * phase)
            self._add(0.6 * way, 0.6 * speed, i < high, runtime_state)

    def _add(self, way_rad: float, speed: float, output: bool, runtime_state: int) -> None:
        k = len(self.states)
        noise, bits = self._noise[k % 997], self._others[k % 997] | output << 3
        q = tuple(a + way_rad + 1e-4 * b for a, b in zip(START_RAD, noise[:6], strict=True))
        qd = tuple(speed + 1e-3 * b for b in noise[6:])
        time_ns = k * PERIOD_NS
        state = RobotState(
            time_ns, time_ns, k, 0, time_ns * 1e-9,
            runtime_state=runtime_state, safety_status=1, digital_outputs=bits, q_rad=q, qd_rad_s=qd,
        )  # fmt: skip
        self.states.append(state)


def watch(states: list[RobotState], config: CycleConfig) -> list[Event]:
    """Return what the run's watcher tells of a program from its start on."""
    source = make_cycle_source(config)
    assert source is not None
    follower, events, records = CycleFollower(source), [], list[Record]()
    watcher = CycleWatcher(events.append, records.append, ends_at_next=source.ends_at_next)
    armed = False
    for state in states:
        watcher.update(follower.complete(state))
        if not armed and state.runtime_state == 2:
            watcher.arm()
            armed = True
    return [event for event in events if isinstance(event, CycleStarted | CycleCompleted)]


def count(states: list[RobotState], config: CycleConfig) -> CounterColumns:
    """Return what the report counts."""
    source = make_cycle_source(config)
    assert source is not None
    runtime = np.array([s.runtime_state for s in states])
    signs = RobotSigns(
        np.array([s.digital_outputs for s in states]),
        np.array([s.q_rad for s in states]),
        np.array([s.qd_rad_s for s in states]),
    )
    counted, running = count_cycles(source, runtime, signs)
    host = np.array([s.capture_ns for s in states])
    return CounterColumns(host, counted, running, np.full(len(states), np.nan), runtime)


def one_after_the_other(n: int) -> list[Event]:
    return [event for i in range(n) for event in (CycleStarted(i), CycleCompleted(i))]


@cache
def ten_thousand_cycles(*, pulse: bool) -> list[RobotState]:
    rng = np.random.default_rng(3)
    robot = FreeRobot(rng)
    robot.stand(3, runtime_state=1)
    robot.stand(4)
    for _ in range(10_000):
        n = int(rng.integers(8, 13))
        robot.drive(n, high=3 if pulse else n)
        robot.stand(int(rng.integers(1, 4)))
    robot.drive(10, high=10)
    return robot.states


@pytest.mark.parametrize("name", SOURCES)
def test_of_ten_thousand_cycles_none_is_lost_and_none_counted_twice(name: str) -> None:
    states, expected = ten_thousand_cycles(pulse=name == "pulse"), one_after_the_other(10_000)
    assert watch(states, SOURCES[name])[: len(expected)] == expected
    table = find_cycles(count(states, SOURCES[name]))
    assert table.cycle_index[table.complete][:10_000].tolist() == list(range(10_000))
    assert table.unbroken.all()


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(list(SOURCES)),
    st.lists(st.tuples(st.integers(1, 40), st.integers(1, 12), st.sampled_from([0, 0, 0, 1, 2, 3])), max_size=12),
    st.integers(0, 2**32 - 1),
)
def test_run_and_report_agree_on_every_sample_whatever_the_program_does(
    name: str, steps: list[tuple[int, int, int]], seed: int
) -> None:
    robot = FreeRobot(np.random.default_rng(seed))
    for n, waiting, what in steps:
        robot.drive(n, high=max(1, n // 3), share=1.0 if what != 1 else 0.5)  # 1: stopped or paused half-way
        robot.stand(waiting, runtime_state=(2, 1, 4, 0)[what], output=what == 3)
    source = make_cycle_source(SOURCES[name])
    assert source is not None
    follower = CycleFollower(source)
    online = [(s.cycle_count, s.cycle_running) for s in map(follower.complete, robot.states)]
    if robot.states:
        offline = count(robot.states, SOURCES[name])
        assert list(zip(offline.count.tolist(), offline.running.tolist(), strict=True)) == online


@pytest.mark.parametrize("name", SOURCES)
def test_each_start_of_the_program_counts_from_0_and_a_stop_half_way_counts_nothing(name: str) -> None:
    robot = FreeRobot(np.random.default_rng(1))
    robot.stand(5, runtime_state=1)
    robot.stand(5)
    robot.drive(20, high=5 if name == "pulse" else 20)
    robot.stand(5)
    robot.drive(20, high=5 if name == "pulse" else 20, share=0.5)
    robot.stand(20, runtime_state=1)
    robot.stand(5)
    robot.drive(20, high=5 if name == "pulse" else 20)
    robot.stand(5)
    robot.drive(20, high=5 if name == "pulse" else 20)
    counted = count(robot.states, SOURCES[name])
    assert counted.count[0] == -1
    assert counted.count[35:54].max() == 1
    assert counted.running[45:65].tolist() == [0] * 20
    assert counted.count[65] == 0
    assert counted.count[-1] == 1


def test_an_output_left_high_by_another_program_starts_nothing() -> None:
    robot = FreeRobot(np.random.default_rng(1))
    robot.stand(5, runtime_state=1, output=True)
    robot.stand(5, output=True)
    robot.stand(5)
    robot.drive(20, high=20)
    robot.stand(3)
    assert watch(robot.states, LEVEL) == one_after_the_other(1)


def test_a_pause_in_the_middle_of_a_cycle_is_still_the_same_cycle() -> None:
    robot = FreeRobot(np.random.default_rng(1))
    robot.stand(3, runtime_state=1)
    robot.stand(3)
    robot.drive(40, high=40, share=0.5)
    half = robot.states[-1]
    robot.states += [half] * 30
    robot.states[-30:] = [_paused(state) for state in robot.states[-30:]]
    for state in _second_half():
        robot.states.append(state)
    robot.stand(3)
    for config in (LEVEL, JOINTS):
        assert watch(robot.states, config) == one_after_the_other(1)


def test_a_given_start_pose_holds_even_if_the_program_first_drives_there() -> None:
    robot = FreeRobot(np.random.default_rng(1))
    robot.drive(20, high=0, share=0.5, runtime_state=1)
    robot.states = [_paused(state, 1) for state in robot.states[-1:]]  # stands half-way, program stopped
    robot.states += _second_half()
    robot.stand(5)
    robot.drive(20, high=0)
    robot.stand(5)
    degrees = tuple(float(a) for a in np.rad2deg(START_RAD))
    config = CycleConfig(source="joint_return", start_joints_deg=degrees)
    assert watch(robot.states, config) == one_after_the_other(1)


def _paused(state: RobotState, runtime_state: int = 4) -> RobotState:
    return replace(state, runtime_state=runtime_state, qd_rad_s=(0.0,) * 6)


def _second_half() -> list[RobotState]:
    robot = FreeRobot(np.random.default_rng(2))
    robot.drive(40, high=40)
    return robot.states[20:]


@pytest.mark.parametrize("name", SOURCES)
def test_a_program_that_never_plays_counts_nothing(name: str) -> None:
    robot = FreeRobot(np.random.default_rng(1))
    robot.stand(3, runtime_state=1)
    columns = count(robot.states, SOURCES[name])
    assert columns.count.tolist() == [-1, -1, -1]
    assert columns.running.tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        (CycleConfig(), "counter 0 and running 0"),
        (LEVEL, "digital output 3 low"),
        (JOINTS, "all joints at rest in the start pose"),
    ],
)
def test_a_program_that_does_not_wait_is_told_what_was_expected_of_its_own_kind(
    config: CycleConfig, expected: str
) -> None:
    source = make_cycle_source(config)
    watcher = CycleWatcher([].append, list[Record]().append, waiting=source.waiting if source else "")
    assert watcher.describe_rest() == (expected, "nothing")
    state = RobotState(0, 0, 0, 0, 0.0, runtime_state=1, cycle_count=1, cycle_running=1)
    watcher.update(state)
    assert watcher.describe_rest()[1] == "a program that does not play"
    watcher.update(replace(state, runtime_state=2))
    seen = watcher.describe_rest()[1]
    assert seen == ("the robot on its path, 1 cycles counted" if source else "counter 1, running 1")
