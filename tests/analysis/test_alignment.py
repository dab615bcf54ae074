"""Offline clock maps: by segment, in stretches that meet, and as recorded where nothing is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import align_by_arrival, align_by_echo

HOST = 1_790_000_000_000_000_000
NS = 1_000_000_000


@given(st.integers(0, 2**32 - 1), st.floats(-150, 150))
@settings(max_examples=10, deadline=None)
def test_each_segment_of_a_robots_clock_has_its_own_line(seed: int, drift_ppm: float) -> None:
    rng = np.random.default_rng(seed)
    elapsed = np.arange(0, 30 * NS, 8_000_000)
    ticks = np.concatenate([5 * NS + elapsed, 77 * NS + elapsed])
    true = (
        HOST
        + np.concatenate([elapsed, 40 * NS + elapsed])
        + np.rint(np.tile(elapsed, 2) * drift_ppm * 1e-6).astype(np.int64)
    )
    segment = np.repeat([0, 1], len(elapsed))
    arrival = true + 200_000 + rng.exponential(100_000, len(true)).astype(np.int64)
    found = align_by_arrival(ticks, arrival, arrival, segment, 1.0)
    assert np.abs(found.host_ns - true - 200_000).max() < 60_000
    assert [one.segment for one in found.segments] == [0, 1]
    assert found.segments[1].offset_s == pytest.approx((HOST + 40 * NS) * 1e-9 - 77, abs=1e-3)
    assert found.segments[0].drift_ppm == pytest.approx(drift_ppm, abs=5)
    assert found.segments[0].residual_p50_us == pytest.approx(69, abs=25)  # of an exponential of mean 100
    assert found.segments[0].residual_p99_us == pytest.approx(460, abs=120)


def test_a_clock_that_changes_its_rate_is_followed_in_stretches_that_meet() -> None:
    ticks = np.arange(0, 3_600 * NS, 100_000_000)
    seconds = ticks * 1e-9
    true = HOST + ticks + np.rint(2_000 * seconds**2 / 2_000).astype(np.int64)  # the rate rises by 3.6 ppm in an hour
    arrival = true + np.random.default_rng(1).exponential(100_000, len(ticks)).astype(np.int64)
    found = align_by_arrival(ticks, arrival, arrival, np.zeros(len(ticks), dtype=np.int64), 1.0)
    step = np.diff(found.host_ns - ticks)
    assert np.abs(step).max() < 2_000  # no jump where stretches meet
    assert np.abs(found.host_ns - true).max() < 600_000
    assert found.segments[0].drift_ppm == pytest.approx(3.6, abs=0.5)
    assert found.segments[0].n_samples == len(ticks)


def test_a_trackers_clock_is_mapped_by_its_own_segments_answers() -> None:
    frames = np.arange(0, 60 * NS, 10_000_000)
    asked = np.arange(0, 60 * NS, 250_000_000)
    capture = HOST + 123 + frames
    segment = (frames >= 30 * NS).astype(np.int64)
    true = HOST + 3 * NS + asked + np.rint(asked * 40e-6).astype(np.int64)
    answered = asked < 30 * NS
    found = align_by_echo(
        frames,
        capture,
        segment,
        np.zeros(answered.sum(), dtype=np.int64),
        true[answered] - 100_000,
        asked[answered],
        true[answered] + 100_000,
        1.0,
    )
    expected = HOST + 3 * NS + frames + np.rint(frames * 40e-6).astype(np.int64)
    assert np.abs(found.host_ns - expected)[segment == 0].max() < 100
    assert np.array_equal(found.host_ns[segment == 1], capture[segment == 1])
    assert [one.method for one in found.segments] == ["echo", "as recorded"]
    assert found.segments[0].drift_ppm == pytest.approx(40, abs=0.01)
    assert np.isnan(found.segments[1].drift_ppm)


def test_a_take_without_clock_samples_keeps_its_times() -> None:
    none = np.zeros(0, dtype=np.int64)
    capture = np.arange(10) * 10_000_000
    found = align_by_echo(capture, capture, np.zeros(10, dtype=np.int64), none, none, none, none, 1.0)
    assert np.array_equal(found.host_ns, capture)
    assert align_by_echo(none, none, none, none, none, none, none, 1.0).segments == []
