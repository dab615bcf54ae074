"""The figures of a cycle and of a place on the path are those of its trusted frames."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import average_by_phase, find_largest_bend, find_tighter, summarise_cycles
from bench.analysis.curvature.local_average import average_peaks, estimate_noise_variance, find_stretches

PLACES = np.linspace(0.1, 1.0, 5)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_cycle_figures_agree_with_their_definition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    row = rng.integers(-1, 6, 60)
    curvature = rng.uniform(0, 10, (60, 5)).astype(np.float32)
    curvature[rng.random((60, 5)) < 0.2] = np.nan
    curvature[rng.random(60) < 0.2] = np.nan
    sigma = rng.uniform(0, 1, (60, 5)).astype(np.float32)
    complete, trusted = rng.random(60) < 0.5, rng.random(60) < 0.7
    found = summarise_cycles(row, 7, complete, trusted, curvature, sigma, PLACES)
    for cycle in range(7):
        mine, used = row == cycle, (row == cycle) & trusted
        assert found.n_frames[cycle] == mine.sum()
        if mine.any():
            assert found.complete_fraction[cycle] == complete[mine].mean()
        values = curvature[used]
        if not np.isfinite(values).any():
            assert np.isnan(found.max_curvature_per_m[cycle])
            assert np.isnan(found.mean_curvature_per_m[cycle])
            continue
        frame, place = np.unravel_index(np.nanargmax(values), values.shape)
        assert found.max_curvature_per_m[cycle] == values[frame, place]
        assert found.max_curvature_sigma_per_m[cycle] == sigma[used][frame, place]
        assert found.max_curvature_arc_length_m[cycle] == PLACES[place]
        assert found.mean_curvature_per_m[cycle] == pytest.approx(np.nanmean(values.astype(float)), rel=1e-6)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_the_map_holds_the_median_of_each_phase_and_place(seed: int) -> None:
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 1, 80)
    phase[:5] = [0.0, 1.0, 0.5, np.nan, 0.25]
    curvature = rng.uniform(0, 10, (80, 5)).astype(np.float32)
    curvature[rng.random((80, 5)) < 0.2] = np.nan
    trusted = rng.random(80) < 0.8
    sigma = np.ones_like(curvature)
    mean = average_by_phase(curvature, sigma, np.zeros(80, dtype=np.int64), phase, trusted, 4)
    found = mean.curvature_per_m
    for i in range(4):
        mine = trusted & (phase >= i / 4) & ((phase < (i + 1) / 4) | (i == 3))
        for place in range(5):
            values = curvature[mine, place]
            values = values[np.isfinite(values)].astype(float)
            expected = np.median(values) if len(values) else np.nan
            assert found[i, place] == pytest.approx(expected, rel=1e-6, nan_ok=True)
            assert mean.n_frames[i, place] == len(values)
    largest = find_largest_bend(mean, PLACES)
    assert largest is not None
    i, place = np.unravel_index(np.nanargmax(found), found.shape)
    assert (largest.curvature_per_m, largest.cycle_phase) == (found[i, place], (i + 0.5) / 4)
    assert (largest.sigma_per_m, largest.arc_length_m) == (mean.sigma_per_m[i, place], PLACES[place])


def test_without_frames_or_cycles_the_figures_are_empty_or_missing() -> None:
    none = np.zeros((0, 5), dtype=np.float32)
    nothing, no = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool)
    found = summarise_cycles(nothing, 2, no, no, none, none, PLACES)
    assert found.n_frames.tolist() == [0, 0]
    assert np.isnan(found.complete_fraction).all()
    assert np.isnan(found.max_curvature_per_m).all()
    assert len(summarise_cycles(nothing, 0, no, no, none, none, PLACES).n_frames) == 0
    empty = average_by_phase(none, none, nothing, np.zeros(0), no, 3)
    assert np.isnan(empty.curvature_per_m).all()
    assert find_largest_bend(empty, PLACES) is None


def test_frames_tighter_than_a_limit_are_named_and_missing_curves_are_not() -> None:
    curvature = np.array([[1, 9, 1], [1, 1, 1], [np.nan] * 3], dtype=np.float32)
    assert find_tighter(curvature, 5.0).tolist() == [True, False, False]


def swing(
    rng: np.random.Generator, n_cycles: int, n_frames: int, noise: float, bias: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return row, phase, truth, curvature and its stated sd of a bend that comes and goes once a cycle.

    The estimate has noise in each frame, and an error that is the same in all: what no average takes away.
    """
    row, phase = np.repeat(np.arange(n_cycles), n_frames), np.tile((np.arange(n_frames) + 0.5) / n_frames, n_cycles)
    truth = (4 - 3 * np.cos(2 * np.pi * phase))[:, None] * np.array([0.5, 0.8, 1.0, 0.8, 0.5])
    curvature = truth + rng.normal(0, noise, truth.shape) + rng.normal(0, bias)
    sigma = np.full(truth.shape, np.hypot(noise, bias), dtype=np.float32)
    return row, phase, truth, curvature.astype(np.float32), sigma


@pytest.mark.parametrize("bias", [0.0, 0.1])
def test_a_cycles_largest_curvature_is_not_the_largest_noise(bias: float) -> None:
    rng, noise, inside, single, error = np.random.default_rng(201), 0.2, [], [], []
    for _ in range(12):
        row, _, truth, curvature, sigma = swing(rng, 20, 200, noise, bias)
        every = np.ones(len(row), dtype=bool)
        found = summarise_cycles(row, 20, every, every, curvature, sigma, PLACES)
        assert found.n_averaged > 5
        error.append(found.max_curvature_per_m - truth.max())
        inside.append(np.abs(error[-1]) <= 2 * found.max_curvature_sigma_per_m)
        single.append([curvature[row == cycle].max() - truth.max() for cycle in range(20)])
    assert np.mean(single) > 1.5 * noise
    assert abs(np.mean(error)) < 0.5 * noise
    assert 0.85 <= np.mean(inside) <= 1.0
    assert found.max_curvature_sigma_per_m.mean() < (0.7 * noise if bias == 0 else sigma.mean())


@pytest.mark.parametrize("n_frames", [6, 12])
def test_sparse_frames_of_a_quick_bend_are_not_averaged(n_frames: int) -> None:
    row, _, _, curvature, sigma = swing(np.random.default_rng(202), 40, n_frames, 0.02, 0.0)
    every = np.ones(len(row), dtype=bool)
    found = summarise_cycles(row, 40, every, every, curvature, sigma, PLACES)
    assert found.n_averaged == 1
    assert np.array_equal(found.max_curvature_per_m, [curvature[row == cycle].max() for cycle in range(40)])


def test_averages_stay_inside_a_cycle_are_symmetric_and_leave_out_what_is_not_usable() -> None:
    row = np.array([0, 0, 0, 0, 0, 1, 1, 1, -1])
    usable = np.array([1, 1, 1, 1, 1, 1, 0, 1, 1], dtype=bool)
    first, last = find_stretches(row)
    assert first.tolist() == [0, 0, 0, 0, 0, 5, 5, 5, 8]
    assert last.tolist() == [4, 4, 4, 4, 4, 7, 7, 7, 8]
    value = np.array([[9, 0, 3, 0, 3, 7, 8, 1, 2], [0, 0, 0, np.nan, 0, 0, 0, 0, 0]], dtype=np.float32).T
    peak, place, count = average_peaks(value, row, usable, 2)
    assert np.array_equal(peak, [9, 4, 3, 2, 3, 7, np.nan, 1, 2], equal_nan=True)
    assert place.tolist() == [0] * 9
    assert count[usable].tolist() == [1, 3, 5, 3, 1, 1, 1, 1]
    peak, _, count = average_peaks(value, row, np.array([1, 1, 1, 1, 0, 1, 1, 1, 1], dtype=bool), 2)
    assert (peak[2], count[2]) == (3.0, 4)
    missing = np.full((2, 2), np.nan, dtype=np.float32)
    assert np.isnan(average_peaks(missing, row[:2], usable[:2], 1)[0]).all()


def test_noise_is_measured_from_frame_to_frame_whatever_the_bend_does_slowly() -> None:
    rng = np.random.default_rng(203)
    row, _, _, curvature, _ = swing(rng, 20, 200, 0.05, 0.0)
    every = np.ones(len(row), dtype=bool)
    unsure = np.full(curvature.shape, 10.0, dtype=np.float32)
    found = np.sqrt(estimate_noise_variance(curvature, unsure, row, every))
    assert np.allclose(found, 0.05, rtol=0.1)
    surer = np.full(curvature.shape, 0.01, dtype=np.float32)
    assert np.allclose(np.sqrt(estimate_noise_variance(curvature, surer, row, every)), 0.01)


def test_averaging_over_cycles_takes_the_noise_away_and_leaves_the_methods_error() -> None:
    rng, noise, bias = np.random.default_rng(204), 0.2, 0.05
    row, phase, truth, curvature, sigma = swing(rng, 100, 50, noise, 0.0)
    every = np.ones(len(row), dtype=bool)
    for extra in (0.0, bias):
        stated = np.hypot(sigma, extra).astype(np.float32)
        mean = average_by_phase(curvature, stated, row, phase, every, 50)
        assert np.all(mean.n_frames == 100)
        least = np.hypot(noise * 0.125, extra)
        assert np.all(mean.sigma_per_m > 0.8 * least)
        assert np.all(mean.sigma_per_m < np.hypot(least, 0.25 * noise))  # noise is known to some per cent
    error = mean.curvature_per_m - truth[:50]
    assert np.std(error) == pytest.approx(noise * 0.125, rel=0.15)
    largest = find_largest_bend(mean, PLACES)
    assert largest is not None
    assert abs(largest.curvature_per_m - 7.0) < 3 * noise * 0.125
    assert largest.arc_length_m == PLACES[2]
    assert abs(largest.cycle_phase - 0.5) < 0.06
