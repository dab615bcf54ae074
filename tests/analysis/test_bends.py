"""The figures of a cycle and of a place on the path are those of its trusted frames."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import find_tighter, map_by_phase, summarise_cycles

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
    found = map_by_phase(curvature, phase, trusted, 4)
    for i in range(4):
        mine = trusted & (phase >= i / 4) & ((phase < (i + 1) / 4) | (i == 3))
        for place in range(5):
            values = curvature[mine, place]
            values = values[np.isfinite(values)].astype(float)
            expected = np.median(values) if len(values) else np.nan
            assert found[i, place] == pytest.approx(expected, rel=1e-6, nan_ok=True)


def test_without_frames_or_cycles_the_figures_are_empty_or_missing() -> None:
    none = np.zeros((0, 5), dtype=np.float32)
    nothing, no = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool)
    found = summarise_cycles(nothing, 2, no, no, none, none, PLACES)
    assert found.n_frames.tolist() == [0, 0]
    assert np.isnan(found.complete_fraction).all()
    assert np.isnan(found.max_curvature_per_m).all()
    assert len(summarise_cycles(nothing, 0, no, no, none, none, PLACES).n_frames) == 0
    assert np.isnan(map_by_phase(none, np.zeros(0), no, 3)).all()


def test_frames_tighter_than_a_limit_are_named_and_missing_curves_are_not() -> None:
    curvature = np.array([[1, 9, 1], [1, 1, 1], [np.nan] * 3], dtype=np.float32)
    assert find_tighter(curvature, 5.0).tolist() == [True, False, False]
