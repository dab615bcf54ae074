"""Phase by the robot's way: the same place on the path has the same phase, however fast the robot came there."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import CycleTable, measure_travel, phase_from_path

T0_NS = 1_700_000_000_000_000_000
PERIOD_S = 0.008
NO_POSE = np.full(6, np.nan)
CYCLE_S, HOME_S = 2.0, 0.4
DWELL = (0.4, 0.55)
"""The usual cycle rests in its middle from the first of these phases to the second."""


def joints_at(phase: np.ndarray) -> np.ndarray:
    """Joints (n, 6) at a phase: out, a rest, and back over the same way, at rest at both ends."""
    out = np.clip(phase / DWELL[0], 0, 1)
    back = np.clip((phase - DWELL[1]) / (1 - DWELL[1]), 0, 1)
    swing = out**2 * (3 - 2 * out) - back**2 * (3 - 2 * back)
    return swing[:, None] * np.array([1.0, -0.7, 0.5, 0.3, 0.0, 0.2]) + 0.4


def drive(cycles: list[np.ndarray], noise_rad: float = 0.0) -> tuple[CycleTable, np.ndarray, np.ndarray, np.ndarray]:
    """Drive cycles, each given as the phase of its samples; return the table, times, joints and true phases."""
    home = np.full(round(HOME_S / PERIOD_S), np.nan)
    phase = np.concatenate([part for cycle in cycles for part in (home, cycle)] + [home])
    time_ns = T0_NS + np.round(np.arange(len(phase)) * PERIOD_S * 1e9).astype(np.int64)
    lengths = np.array([len(cycle) for cycle in cycles])
    start = len(home) * (1 + np.arange(len(cycles))) + np.cumsum(lengths) - lengths
    yes = np.ones(len(cycles), dtype=bool)
    table = CycleTable(np.arange(len(cycles)), time_ns[start], time_ns[start + lengths], yes, yes, yes)
    q = joints_at(np.nan_to_num(phase)) + np.random.default_rng(3).normal(0, noise_rad, (len(phase), 6))
    return table, time_ns, q, phase


def usual(speed: float = 1.0) -> np.ndarray:
    return np.arange(0, 1, PERIOD_S / CYCLE_S * speed)


def phase_of(table: CycleTable, time_ns: np.ndarray, q: np.ndarray) -> np.ndarray:
    travel = measure_travel(time_ns, q, np.tile(NO_POSE, (len(q), 1)))
    assert travel is not None
    phase = phase_from_path(table, travel, table.locate(time_ns), time_ns)
    assert phase is not None
    return phase


def largest_step_rad(phase: np.ndarray, truth: np.ndarray) -> float:
    """How far the joints are from where the phase says that they are."""
    known = np.isfinite(truth)
    return float(np.abs(joints_at(phase[known]) - joints_at(truth[known])).max())


@given(st.lists(st.floats(0.3, 1.3), min_size=1, max_size=4), st.integers(10, 230), st.integers(0, 300))
@settings(max_examples=25, deadline=None)
def test_slow_cycles_and_pauses_anywhere_keep_the_phase_of_the_place(speeds: list[float], at: int, held: int) -> None:
    paused = np.insert(usual(), at, np.full(held, usual()[at]))
    table, time_ns, q, truth = drive([usual(0.5), *[usual(speed) for speed in speeds], paused, *[usual()] * 6])
    phase = phase_of(table, time_ns, q)
    assert largest_step_rad(phase, truth) < 0.02
    row = table.locate(time_ns)
    for cycle in range(len(table.cycle_index)):
        assert (np.diff(phase[row == cycle]) >= 0).all()
    assert np.isnan(phase[row < 0]).all()


def test_time_in_a_rest_of_the_path_goes_on_whatever_the_rest_lasts() -> None:
    longer = np.concatenate([usual()[usual() < DWELL[0]], np.linspace(*DWELL, 250), usual()[usual() > DWELL[1]]])
    table, time_ns, q, truth = drive([usual(), usual(), longer])
    phase = phase_of(table, time_ns, q)
    resting = (truth > DWELL[0] + 0.05) & (truth < DWELL[1] - 0.05)
    assert np.abs(phase - truth)[resting].max() < 0.02


def test_a_cycle_that_leaves_the_rest_of_the_others_out_jumps_over_it() -> None:
    shorter = usual()[(usual() < DWELL[0]) | (usual() > DWELL[1])]
    table, time_ns, q, truth = drive([usual(), usual(), shorter])
    assert largest_step_rad(phase_of(table, time_ns, q), truth) < 0.02


def test_noise_at_rest_is_no_way() -> None:
    table, time_ns, q, truth = drive([usual(0.4), *[usual()] * 4], noise_rad=3e-5)
    assert largest_step_rad(phase_of(table, time_ns, q), truth) < 0.02


def test_a_cycle_cut_short_has_the_phase_up_to_where_it_came() -> None:
    table, time_ns, q, truth = drive([usual(), usual(), usual()[:100]])
    table = replace(table, complete=np.array([True, True, False]))
    last = table.locate(time_ns) == 2
    assert np.abs(phase_of(table, time_ns, q) - truth)[last][10:-3].max() < 0.02  # then it is set back at once


def test_a_cycle_on_another_path_has_no_phase() -> None:
    table, time_ns, q, _ = drive([usual()] * 4)
    row = table.locate(time_ns)
    q = np.where((row == 2)[:, None], 1.2 * q, q)
    phase = phase_of(table, time_ns, q)
    assert np.isnan(phase[row == 2]).all()
    assert np.isfinite(phase[(row >= 0) & (row != 2)]).all()


def test_the_tool_tells_the_path_where_no_joints_are_known() -> None:
    table, time_ns, q, truth = drive([usual(0.5), *[usual()] * 3])
    pose = np.concatenate([q[:, :3], np.full((len(q), 3), np.nan)], axis=1)
    travel = measure_travel(time_ns, np.full_like(q, np.nan), pose)
    assert travel is not None
    phase = phase_from_path(table, travel, table.locate(time_ns), time_ns)
    assert phase is not None
    assert largest_step_rad(phase, truth) < 0.02


@pytest.mark.parametrize("change", [{"complete": np.zeros(3, dtype=bool)}, {"seen": np.zeros(3, dtype=bool)}])
def test_without_a_whole_cycle_there_is_nothing_to_learn_the_path_from(change: dict[str, np.ndarray]) -> None:
    table, time_ns, q, _ = drive([usual()] * 3)
    travel = measure_travel(time_ns, q, np.tile(NO_POSE, (len(q), 1)))
    assert travel is not None
    assert phase_from_path(replace(table, **change), travel, table.locate(time_ns), time_ns) is None


def test_a_robot_that_does_not_move_or_does_not_say_where_it_is_has_no_path() -> None:
    table, time_ns, q, _ = drive([usual()] * 3)
    no_pose = np.tile(NO_POSE, (len(q), 1))
    assert measure_travel(time_ns, np.full_like(q, np.nan), no_pose) is None
    assert measure_travel(time_ns[:1], q[:1], no_pose[:1]) is None
    still = measure_travel(time_ns, 0 * q, no_pose)
    assert still is not None
    assert phase_from_path(table, still, table.locate(time_ns), time_ns) is None
