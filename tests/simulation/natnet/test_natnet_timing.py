"""The figures of real recordings, found again in thousands of simulated frames."""

from __future__ import annotations

import numpy as np
import pytest

from bench.config import SimulationConfig
from bench.simulation.natnet.timing import FrameTiming, stamp_delay_s

HZ = 3_312_787.0
N = 20_000
PERIOD_TICKS = 33_128
START = 10**12


def draw(n: int = N, **settings: float) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps (n, 3) relative to the exposure, and departures (n,), all in seconds."""
    timing = FrameTiming(SimulationConfig(**settings), HZ, np.random.default_rng(3))
    drawn = [timing.draw(START + i * PERIOD_TICKS) for i in range(n)]
    ticks = np.array([stamps for stamps, _ in drawn]) - START - np.arange(n)[:, None] * PERIOD_TICKS
    return ticks / HZ, np.array([leaves_ns for _, leaves_ns in drawn]) * 1e-9


def test_the_defaults_are_what_was_measured_on_real_frames() -> None:
    (mid, received, transmit), leaves = (lambda stamps, leaves: (stamps.T, leaves))(*draw())
    assert np.std(np.diff(mid)) == pytest.approx(9e-6, rel=0.03)
    assert np.mean(mid) == pytest.approx(0.0, abs=1e-6)
    assert (np.mean(received), np.std(received)) == pytest.approx((4.60e-3, 0.09e-3), rel=0.02)
    assert (np.mean(transmit), np.std(transmit)) == pytest.approx((5.41e-3, 0.14e-3), rel=0.02)
    assert np.median(leaves) == pytest.approx(6.2e-3, abs=0.1e-3)
    assert np.quantile(leaves, 0.99) == pytest.approx(6.9e-3, abs=0.25e-3)
    assert 9e-3 < leaves.max() < 12e-3
    assert (leaves > transmit).all()
    assert (transmit > received).all()


def test_late_frames_are_as_many_and_as_late_as_configured() -> None:
    _, leaves = draw(late_share=0.1, latest_ms=13.0)
    usual = 6.2e-3
    assert np.mean(leaves > usual + 1.5e-3) == pytest.approx(0.096, abs=0.01)
    assert usual + 12e-3 < leaves.max() < usual + 14e-3


def test_without_spread_every_frame_is_the_same() -> None:
    still = {"tracker_jitter_ms": 0, "received_sd_ms": 0, "transmit_sd_ms": 0}
    stamps, _ = draw(100, **still, received_after_ms=2.0, transmit_after_ms=3.0)
    np.testing.assert_allclose(stamps, np.tile([0.0, 0.002, 0.003], (100, 1)), atol=1 / HZ)


def test_the_stamps_delay_moves_all_three_and_is_what_the_truth_says() -> None:
    plain, _ = draw(1000)
    late, _ = draw(1000, tracker_stamp_delay_ms=7.5)
    np.testing.assert_allclose(late - plain, 0.0075, atol=1 / HZ)
    assert stamp_delay_s(SimulationConfig(tracker_stamp_delay_ms=7.5)) == 0.0075


def test_usb_cameras_have_no_first_stamp_and_their_best_one_is_later() -> None:
    timing = FrameTiming(SimulationConfig(usb_cameras=True), HZ, np.random.default_rng(3))
    assert {timing.draw(START)[0][0] for _ in range(50)} == {0}
    assert stamp_delay_s(SimulationConfig(usb_cameras=True, received_after_ms=5.0)) == pytest.approx(0.005)


def test_the_same_seed_draws_the_same_times() -> None:
    (first, first_leaves), (second, second_leaves) = draw(500), draw(500)
    assert np.array_equal(first, second)
    assert np.array_equal(first_leaves, second_leaves)
