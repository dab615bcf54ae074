from __future__ import annotations

import numpy as np
import pytest

from bench.analysis import find_isolated_bends

RATE_HZ = 100.0


def make_motion(n_frames: int = 400, n_samples: int = 20) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A cable that bends and unbends once a second, 2 to 7 1/m, with the noise of real markers."""
    time_s = np.arange(n_frames) / RATE_HZ
    swing = 4.5 - 2.5 * np.cos(2 * np.pi * time_s)
    shape = np.exp(-(((np.arange(n_samples) - 8) / 4.0) ** 2))
    noise = np.random.default_rng(5).normal(0.0, 0.05, (n_frames, n_samples))
    curvature = np.abs(swing[:, None] * shape + noise).astype(np.float32)
    return curvature, np.full_like(curvature, 0.05), np.rint(time_s * 1e9).astype(np.int64)


def everything(curvature: np.ndarray) -> np.ndarray:
    return np.ones(len(curvature), dtype=bool)


def test_a_motion_without_wrong_labels_has_no_isolated_bend() -> None:
    curvature, sigma, time_ns = make_motion()
    assert not find_isolated_bends(curvature, sigma, everything(curvature), time_ns).any()


@pytest.mark.parametrize("length", [1, 4])
def test_a_kink_that_lives_as_long_as_a_ghost_is_isolated_and_nothing_else_is(length: int) -> None:
    curvature, sigma, time_ns = make_motion()
    curvature[100 : 100 + length, 3] = 60.0
    found = find_isolated_bends(curvature, sigma, everything(curvature), time_ns)
    assert np.flatnonzero(found).tolist() == list(range(100, 100 + length))


def test_a_bend_that_stays_is_no_label_error() -> None:
    curvature, sigma, time_ns = make_motion()
    curvature[100:120, 3] = 60.0
    assert not find_isolated_bends(curvature, sigma, everything(curvature), time_ns).any()


def test_frames_that_are_not_usable_are_neither_judged_nor_asked() -> None:
    curvature, sigma, time_ns = make_motion()
    usable = everything(curvature)
    curvature[100:140, 3] = 60.0
    usable[100:140] = False
    curvature[120, :] = np.nan
    assert not find_isolated_bends(curvature, sigma, usable, time_ns).any()


def test_the_noise_of_a_straight_cable_is_no_bend() -> None:
    noise = np.abs(np.random.default_rng(6).normal(0.0, 0.05, (400, 20))).astype(np.float32)
    time_ns = (np.arange(400) * 1e9 / RATE_HZ).astype(np.int64)
    assert not find_isolated_bends(noise, np.full_like(noise, 0.05), everything(noise), time_ns).any()


@pytest.mark.parametrize("n_frames", [0, 1, 4])
def test_too_few_frames_tell_nothing(n_frames: int) -> None:
    curvature, sigma, time_ns = make_motion(n_frames)
    assert not find_isolated_bends(curvature, sigma, everything(curvature), time_ns).any()
