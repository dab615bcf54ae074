"""Cycles are counted by the robot: every count once, whatever was lost, reset or left over."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_examples import PERIOD_NS, T0_NS, from_lists, keep, make_robot

from bench.analysis import find_cycles, phase_from_register, phase_from_time, whole_take


@given(st.integers(1, 12), st.integers(6, 60), st.integers(0, 20), st.integers(1, 20))
@settings(max_examples=50, deadline=None)
def test_every_driven_cycle_is_found_with_its_times(n: int, on: int, wait: int, first: int) -> None:
    robot = make_robot(n, on, wait, first)
    robot = keep(robot, np.ones(len(robot.count), dtype=bool)) if wait else _finish(robot, n)
    table = find_cycles(robot)
    assert table.cycle_index.tolist() == list(range(n))
    starts = T0_NS + PERIOD_NS * (first + np.arange(n) * (on + wait))
    assert table.start_ns.tolist() == starts.tolist()
    assert table.end_ns.tolist() == (starts + PERIOD_NS * on).tolist()
    assert table.complete.all()
    assert table.unbroken.all()
    assert table.seen.all()


def _finish(robot, n):
    """Add the sample that says that the last cycle is completed."""
    last = from_lists([n], [0], [1.0])
    values = {name: np.append(getattr(robot, name), getattr(last, name)) for name in robot.__dataclass_fields__}
    values["host_ns"][-1] = robot.host_ns[-1] + PERIOD_NS
    return replace(robot, **values)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.9))
@settings(max_examples=60, deadline=None)
def test_whatever_samples_are_lost_every_count_in_between_appears_once_and_in_order(seed: int, loss: float) -> None:
    rng = np.random.default_rng(seed)
    robot = make_robot(15, on_samples=12, wait_samples=4)
    kept = rng.random(len(robot.count)) >= loss
    burst = int(rng.integers(0, len(kept)))
    kept[burst : burst + int(rng.integers(0, 100))] = False
    kept[[0, -1]] = True
    table = find_cycles(keep(robot, kept))
    assert table.cycle_index.tolist() == list(range(15))
    assert np.all(table.start_ns <= table.end_ns)
    assert np.all(table.end_ns[:-1] <= table.start_ns[1:])
    true_end = T0_NS + PERIOD_NS * (20 + 12 + np.arange(15) * 16)
    unseen = np.flatnonzero(~kept)
    longest = max((len(run) for run in np.split(unseen, np.flatnonzero(np.diff(unseen) > 1) + 1)), default=0)
    assert np.abs(table.end_ns - true_end).max() <= (longest + 1) * PERIOD_NS


def test_a_cycle_cut_short_is_there_and_not_complete() -> None:
    table = find_cycles(
        from_lists([0] * 5 + [0] * 20 + [1] * 5 + [1] * 8 + [1] * 5, [0] * 5 + [1] * 20 + [0] * 5 + [1] * 8 + [0] * 5)
    )
    assert table.cycle_index.tolist() == [0, 1]
    assert table.complete.tolist() == [True, False]
    assert table.end_ns[1] == T0_NS + 38 * PERIOD_NS


def test_a_stopped_program_is_on_no_path_whatever_its_registers_say() -> None:
    robot = from_lists([3] * 30 + [0] * 10 + [0] * 20 + [1] * 5, [1] * 30 + [0] * 10 + [1] * 20 + [0] * 5)
    stopped = np.where(np.arange(65) < 25, 1, 2)
    table = find_cycles(replace(robot, runtime_state=stopped))
    assert table.cycle_index.tolist() == [0]
    assert table.start_ns[0] == T0_NS + 40 * PERIOD_NS


def test_a_counter_that_restarts_is_numbered_on() -> None:
    robot = from_lists(
        [0] * 5 + [0] * 20 + [1] * 20 + [2] * 3 + [0] * 5 + [0] * 20 + [1] * 5,
        [0] * 5 + [1] * 20 + [1] * 20 + [0] * 3 + [0] * 5 + [1] * 20 + [0] * 5,
    )
    assert find_cycles(robot).cycle_index.tolist() == [0, 1, 2]


def test_the_running_mark_that_outlives_the_count_starts_no_cycle() -> None:
    count = [0] * 5 + [0] * 30 + [1] * 2 + [1] * 6 + [1] * 30 + [2] * 2 + [2] * 9
    running = [0] * 5 + [1] * 30 + [1] * 2 + [0] * 6 + [1] * 30 + [1] * 2 + [0] * 9
    table = find_cycles(from_lists(count, running))
    assert table.cycle_index.tolist() == [0, 1]
    assert table.start_ns[1] == T0_NS + 43 * PERIOD_NS
    assert table.unbroken.all()


def test_a_cycle_driven_in_two_stretches_is_complete_but_broken() -> None:
    table = find_cycles(from_lists([0] * 5 + [0] * 60 + [1] * 5, [0] * 5 + [1] * 25 + [0] * 10 + [1] * 25 + [0] * 5))
    assert table.complete.tolist() == [True]
    assert table.unbroken.tolist() == [False]


def test_a_recording_that_begins_on_the_path_has_not_seen_the_beginning() -> None:
    table = find_cycles(from_lists([0] * 20 + [1] * 5, [1] * 20 + [0] * 5))
    assert table.seen.tolist() == [False]
    assert table.complete.tolist() == [True]


def test_without_samples_or_without_a_counter_there_are_no_cycles() -> None:
    assert len(find_cycles(from_lists([], [])).cycle_index) == 0
    assert len(find_cycles(from_lists([-1] * 9, [-1] * 9)).cycle_index) == 0
    assert len(find_cycles(from_lists([4] * 9, [0] * 9)).cycle_index) == 0
    nothing = find_cycles(from_lists([], []))
    assert nothing.locate(np.array([T0_NS])).tolist() == [-1]
    assert np.isnan(nothing.usual_duration_s)


def test_frames_are_located_from_a_cycles_start_to_before_its_end() -> None:
    table = find_cycles(make_robot(2, on_samples=10, wait_samples=5, first_wait=5))
    start, end = int(table.start_ns[0]), int(table.end_ns[0])
    assert table.locate(np.array([start - 1, start, end - 1, end, int(table.start_ns[1])])).tolist() == [
        -1,
        0,
        0,
        -1,
        1,
    ]


def test_a_take_without_cycles_is_cycle_0_to_its_last_frame() -> None:
    table = whole_take(T0_NS, T0_NS + 1_000)
    assert table.locate(np.array([T0_NS, T0_NS + 1_000, T0_NS + 1_001])).tolist() == [0, 0, -1]


def test_the_programs_phase_is_interpolated_and_reaches_1_at_the_end() -> None:
    robot = make_robot(3)
    table = find_cycles(robot)
    moments = np.concatenate(
        [np.linspace(s, e - 1_000, 400).astype(np.int64) for s, e in zip(table.start_ns, table.end_ns, strict=True)]
    )
    phase = phase_from_register(table, robot, table.locate(moments), moments)
    assert phase is not None
    expected = (moments - table.start_ns[table.locate(moments)]) / (50 * PERIOD_NS)
    assert np.abs(phase - expected).max() < 1e-6
    outside = np.array([T0_NS, int(table.end_ns[0]) + 1])
    assert np.isnan(phase_from_register(table, robot, table.locate(outside), outside)).all()


def test_a_register_that_is_never_written_is_no_phase() -> None:
    robot = make_robot(3)
    table, moments = find_cycles(robot), robot.host_ns
    row = table.locate(moments)
    assert phase_from_register(table, replace(robot, phase=0 * robot.phase), row, moments) is None
    assert phase_from_register(table, replace(robot, phase=robot.phase * np.nan), row, moments) is None


def test_without_a_register_the_phase_is_the_time_that_has_passed() -> None:
    robot = from_lists([0] * 5 + [0] * 20 + [1] * 5 + [1] * 10, [0] * 5 + [1] * 20 + [0] * 5 + [1] * 10)
    table = find_cycles(robot)
    phase = phase_from_time(table, table.locate(robot.host_ns), robot.host_ns)
    assert np.isnan(phase[:5]).all()
    assert np.allclose(phase[5:25], np.arange(20) / 20)
    assert np.allclose(phase[30:39], np.arange(9) / 20)  # cut short: measured by the usual duration
