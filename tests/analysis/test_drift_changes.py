"""Changes are found where they are, and hardly ever where there are none."""

import numpy as np
import pytest
from drifting_cables import make_cable
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import describe_drift, gather_shapes, measure_distances


def autoregressive(rng: np.random.Generator, shape: tuple[int, int], correlation: float) -> np.ndarray:
    """Series (b, n) of unit variance whose neighbours are correlated."""
    fresh = rng.standard_normal((shape[0], shape[1] + 100)) * np.sqrt(1 - correlation**2)
    series = np.empty_like(fresh)
    series[:, 0] = fresh[:, 0]
    for i in range(1, fresh.shape[1]):
        series[:, i] = correlation * series[:, i - 1] + fresh[:, i]
    return series[:, 100:]


def alarms(series: np.ndarray) -> int:
    found = [describe_drift(one) for one in series]
    return sum(bool(one.changes) or one.is_trend for one in found)


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("n", [20, 27, 60, 150, 700])
def test_at_most_one_of_100_series_without_a_change_has_an_alarm(n: int, correlation: float) -> None:
    """Seeds other than those of the simulations that the limits come from; 300 series: 1 % is 3, and 8 is three sd."""
    rng = np.random.default_rng([4711, n, round(10 * correlation)])
    assert alarms(autoregressive(rng, (300, n), correlation)) <= 8


def test_whole_runs_without_a_change_have_no_alarm() -> None:
    """From markers to distances to the search: 40 runs, in which 1 % would be 0.4."""
    found = 0
    for seed in range(40):
        rng = np.random.default_rng([99, seed])
        n = int(rng.integers(20, 80))
        jitter_m = rng.choice([0.0, 5e-5, 3e-4])
        cable = make_cable(rng.normal(0, jitter_m, n), per_cycle=30, hidden=rng.choice([0.0, 0.1]), seed=seed)
        trusted, reference = np.ones(len(cable.row), dtype=bool), np.arange(n) < 10
        shapes = gather_shapes(cable.row, n, cable.phase, cable.position_m, trusted, reference)
        found += alarms(measure_distances(shapes, reference).watched_m[None])
    assert found <= 2


@given(
    st.integers(60, 300), st.floats(0.2, 0.8), st.sampled_from([-1.0, 1.0]), st.floats(6.0, 40.0), st.integers(0, 999)
)
@settings(max_examples=40, deadline=None)
def test_a_step_is_found_where_it_is_with_its_size(n: int, where: float, sign: float, size: float, seed: int) -> None:
    at = round(where * n)
    series = np.random.default_rng(seed).standard_normal(n) + sign * size * (np.arange(n) >= at)
    found = describe_drift(series)
    nearest = min(found.changes, key=lambda change: abs(change.at - at))
    assert abs(nearest.at - at) <= 2
    assert nearest.size == pytest.approx(sign * size, abs=max(5 * nearest.sigma, 0.3 * size))


def test_steps_there_and_back_and_a_staircase_are_found() -> None:
    noise = np.random.default_rng(5).standard_normal(400)
    index = np.arange(400)
    there_and_back = describe_drift(noise + 5 * ((index >= 160) & (index < 230)))
    assert [change.at for change in there_and_back.changes] == pytest.approx([160, 230], abs=2)
    stairs = describe_drift(noise + 4.0 * (index >= 100) + 4.0 * (index >= 300))
    assert [change.at for change in stairs.changes] == pytest.approx([100, 300], abs=2)
    assert not stairs.is_trend


def test_a_slow_drift_is_a_trend_and_no_staircase() -> None:
    series = np.random.default_rng(6).standard_normal(500) + 0.01 * np.arange(500)
    found = describe_drift(series)
    assert found.changes == []
    assert found.is_trend
    assert found.slope == pytest.approx(0.01, abs=4 * found.slope_sigma)
    assert found.slope_sigma < 0.001


def test_wear_that_speeds_up_is_a_bent_trend_and_no_staircase() -> None:
    index = np.arange(300)
    truth = 0.02 * index + 0.0002 * index**2
    found = describe_drift(np.random.default_rng(12).normal(0, 0.3, 300) + truth)
    assert found.changes == []
    assert found.is_trend
    assert found.slope == pytest.approx(np.polyfit(index, truth, 1)[0], abs=3 * found.slope_sigma)
    assert found.slope_sigma < 0.001
    assert np.abs(found.fitted - truth).max() < 0.2


def test_a_step_on_a_trend_is_told_apart() -> None:
    index = np.arange(1000)
    series = np.random.default_rng(7).standard_normal(1000) + 0.01 * index + 6.0 * (index >= 700)
    found = describe_drift(series)
    assert [change.at for change in found.changes] == pytest.approx([700], abs=2)
    assert found.is_trend
    assert found.slope == pytest.approx(0.01, abs=0.002)


def test_bad_cycles_and_missing_ones_hide_no_change_and_make_none() -> None:
    rng = np.random.default_rng(8)
    series = rng.standard_normal(300)
    series[rng.choice(300, 12, replace=False)] = 50.0
    series[40:60] = np.nan
    assert describe_drift(series).changes == []
    found = describe_drift(series + 5.0 * (np.arange(300) >= 150))
    assert [change.at for change in found.changes] == pytest.approx([150], abs=2)
    assert np.isnan(found.fitted[40:60]).all()
    assert np.isfinite(found.fitted[60:]).all()


def test_a_cable_that_scatters_more_after_a_change_has_one_change() -> None:
    rng = np.random.default_rng(9)
    late = np.arange(600) >= 300
    found = describe_drift(np.where(late, 3.0 + rng.normal(0, 0.5, 600), rng.normal(0, 0.02, 600)))
    assert [change.at for change in found.changes] == [300]


def test_values_without_any_noise_have_exactly_their_steps() -> None:
    assert describe_drift(np.ones(30)).changes == []
    found = describe_drift(np.concatenate([np.ones(30), np.zeros(30)]))
    assert [(change.at, round(change.size, 9)) for change in found.changes] == [(30, -1.0)]


def test_a_curve_is_at_most_ten_steps() -> None:
    series = np.cumsum(np.random.default_rng(10).choice([-9.0, 9.0], 400).repeat(25))
    assert len(describe_drift(series).changes) == 10


def test_one_or_two_odd_cycles_at_an_end_are_no_lasting_change() -> None:
    for odd in ([0], [-1], [0, 1], [-2, -1]):
        series = np.random.default_rng(11).standard_normal(60)
        series[odd] += 30.0
        found = describe_drift(series)
        assert not found.is_trend
        assert all(3 <= change.at <= 57 for change in found.changes)
