"""Maps from device time to host time recover offset and drift from late, jittering evidence."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from bench.timing import EchoFilter, MinimumDelayFilter, estimate_echo_map, estimate_hull_map

Ints = npt.NDArray[np.int64]
HOST = 1_790_000_000_000_000_000
DRIFTS = st.floats(-200.0, 200.0)
RATES = st.sampled_from([(1e9, 125.0), (1e9, 500.0), (1e7, 100.0), (3_579_545.0, 360.0)])
SEEDS = st.integers(0, 2**32 - 1)


def make_device(seconds: float, rate_hz: float, ticks_per_s: float, drift_ppm: float) -> tuple[Ints, Ints]:
    """Return the ticks and the true host times of a device's samples."""
    elapsed = np.arange(round(seconds * rate_hz)) / rate_hz
    ticks = 123_456_789_012 + np.rint(elapsed * ticks_per_s).astype(np.int64)
    host = HOST + np.rint((ticks - ticks[0]) / ticks_per_s * (1 + drift_ppm * 1e-6) * 1e9).astype(np.int64)
    return ticks, host


@given(RATES, DRIFTS, SEEDS)
@settings(max_examples=25, deadline=None)
def test_the_hull_finds_drift_and_offset_below_heavy_delays(
    rate: tuple[float, float], drift_ppm: float, seed: int
) -> None:
    ticks_per_s, rate_hz = rate
    ticks, host = make_device(120.0, rate_hz, ticks_per_s, drift_ppm)
    rng = np.random.default_rng(seed)
    delay = 150_000 + rng.exponential(50_000, len(ticks)) + (rng.random(len(ticks)) < 0.1) * rng.uniform(0, 2e7)
    found = estimate_hull_map(ticks, host + delay.astype(np.int64), 1e9 / ticks_per_s)
    error = found.to_host_ns(ticks) - host - 150_000
    assert found.drift_ppm == pytest.approx(drift_ppm, abs=0.5)
    assert np.abs(error).max() < 40_000
    assert found.residual_sd_ns < 100_000


@given(RATES, DRIFTS, SEEDS)
@settings(max_examples=25, deadline=None)
def test_no_earliest_arrival_lies_before_the_hull(rate: tuple[float, float], drift_ppm: float, seed: int) -> None:
    ticks, host = make_device(20.0, rate[1], rate[0], drift_ppm)
    arrival = host + np.random.default_rng(seed).integers(0, 5_000_000, len(ticks))
    found = estimate_hull_map(ticks, arrival, 1e9 / rate[0])
    assert (arrival - found.to_host_ns(ticks)).min() >= -2


@given(SEEDS)
@settings(max_examples=10, deadline=None)
def test_the_hull_does_not_depend_on_the_order_of_the_samples(seed: int) -> None:
    ticks, host = make_device(10.0, 125.0, 1e9, 20.0)
    rng = np.random.default_rng(seed)
    arrival = host + rng.integers(0, 1_000_000, len(ticks))
    order = rng.permutation(len(ticks))
    a = estimate_hull_map(ticks, arrival, 1.0).to_host_ns(ticks)
    b = estimate_hull_map(ticks[order], arrival[order], 1.0).to_host_ns(ticks)
    assert np.abs(a - b).max() <= 2


@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_segment_too_short_for_a_fit_keeps_the_nominal_rate(n: int) -> None:
    ticks = np.arange(n, dtype=np.int64) * 8_000_000
    arrival = HOST + ticks + np.array([300_000, 200_000, 900_000, 400_000, 500_000])[:n]
    found = estimate_hull_map(ticks, arrival, 1.0)
    assert found.drift_ppm == 0.0
    assert (arrival - found.to_host_ns(ticks)).min() == 0


def test_without_evidence_there_is_no_map() -> None:
    none = np.zeros(0, dtype=np.int64)
    with pytest.raises(ValueError, match="no samples"):
        estimate_hull_map(none, none, 1.0)
    with pytest.raises(ValueError, match="no answers"):
        estimate_echo_map(none, none, none, 1.0)


def make_echoes(
    rng: np.random.Generator, seconds: float, ticks_per_s: float, drift_ppm: float
) -> tuple[Ints, Ints, Ints]:
    ticks, host = make_device(seconds, 4.0, ticks_per_s, drift_ppm)
    there = 80_000 + rng.exponential(60_000, len(ticks)) + (rng.random(len(ticks)) < 0.2) * rng.uniform(0, 1e7)
    back = 80_000 + rng.exponential(60_000, len(ticks))
    return host - there.astype(np.int64), ticks, host + back.astype(np.int64)


@given(RATES, DRIFTS, SEEDS)
@settings(max_examples=25, deadline=None)
def test_echoes_give_drift_and_offset_within_half_a_round_trip(
    rate: tuple[float, float], drift_ppm: float, seed: int
) -> None:
    send, ticks, receive = make_echoes(np.random.default_rng(seed), 120.0, rate[0], drift_ppm)
    found = estimate_echo_map(send, ticks, receive, 1e9 / rate[0])
    _, truth = make_device(120.0, 4.0, rate[0], drift_ppm)
    assert found.drift_ppm == pytest.approx(drift_ppm, abs=2.0)
    assert np.abs(found.to_host_ns(ticks) - truth).max() < found.bias_bound_ns + 60_000


@given(st.integers(-(10**9), 10**9), st.integers(1, 10**6))
def test_one_number_and_an_array_are_mapped_alike(offset: int, n_ticks: int) -> None:
    assume(n_ticks > 0)
    ticks, host = make_device(10.0, 100.0, 1e7, 30.0)
    found = estimate_hull_map(ticks, host, 100.0)
    wanted = int(ticks[0]) + offset
    assert abs(int(found.to_host_ns(np.array([wanted]))[0]) - found.to_host_ns(wanted)) <= 256


def test_while_it_runs_the_smallest_delay_of_the_window_counts() -> None:
    online = MinimumDelayFilter(1.0, window_ns=1_000_000_000)
    assert online.update(0, HOST + 500) == HOST + 500
    assert online.update(100_000_000, HOST + 100_000_200) == HOST + 100_000_200
    assert online.update(200_000_000, HOST + 200_000_900) == HOST + 200_000_200
    assert online.update(1_500_000_000, HOST + 1_500_000_700) == HOST + 1_500_000_700
    online.reset()
    assert online.update(2_000_000_000, HOST + 2_000_900_000) == HOST + 2_000_900_000


def test_the_echo_filter_follows_the_answers_and_forgets_them_on_reset() -> None:
    online = EchoFilter(n_kept=40)
    assert online.map is None
    send, ticks, receive = make_echoes(np.random.default_rng(3), 20.0, 1e7, -42.0)
    for i in range(len(ticks)):
        online.update(int(send[i]), int(ticks[i]), int(receive[i]), 1e9 / 1e7)
    assert online.map is not None
    assert online.map.n_samples == 40
    truth = make_device(20.0, 4.0, 1e7, -42.0)[1]
    assert abs(online.map.to_host_ns(int(ticks[-1])) - int(truth[-1])) < 200_000
    online.reset()
    assert online.map is None
