"""How fast markers go, and the frame rate that this asks for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import fastest_speed, judge_frame_rate


def circling(rate_hz: float, speed_m_s: float, seconds: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """Return times and positions of a point that circles at 0.3 m, and of one at half the way out."""
    time_s = np.arange(0, seconds, 1 / rate_hz)
    angle = time_s * speed_m_s / 0.3
    outer = 0.3 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return np.rint(time_s * 1e9).astype(np.int64), np.stack([outer, outer / 2], axis=1)


@settings(deadline=None, max_examples=30)
@given(st.floats(60, 1000), st.floats(0.05, 2.0))
def test_the_speed_is_the_outermost_points_at_any_rate_in_spite_of_noise(rate_hz: float, speed_m_s: float) -> None:
    time_ns, position = circling(rate_hz, speed_m_s)
    noise = np.random.default_rng(3).normal(0, 5e-5, position.shape)
    assert fastest_speed(time_ns, position + noise) == pytest.approx(speed_m_s, rel=0.03, abs=0.02)


def test_one_wrong_point_and_a_gap_are_no_speed() -> None:
    time_ns, position = circling(100.0, 0.5)
    position[50, 0] += 0.4
    position[80:90, 1] = np.nan
    assert fastest_speed(time_ns, position) == pytest.approx(0.5, rel=0.03)


def test_a_share_leaves_out_what_wrong_points_do() -> None:
    time_ns, position = circling(100.0, 0.5)
    position[40:48:2, 0] += 0.4
    assert fastest_speed(time_ns, position) > 1.0
    assert fastest_speed(time_ns, position, 0.9) == pytest.approx(0.5, rel=0.03)


def test_a_moment_that_is_shown_twice_is_no_speed() -> None:
    time_ns, position = circling(100.0, 0.5)
    time_ns[1::20] = time_ns[0:-1:20]
    assert fastest_speed(time_ns, position) == pytest.approx(0.5, rel=0.03)


def test_frames_that_never_came_are_time_that_passed() -> None:
    time_ns, position = circling(100.0, 0.5)
    kept = np.random.default_rng(1).random(len(time_ns)) > 0.3
    assert fastest_speed(time_ns[kept], position[kept]) == pytest.approx(0.5, rel=0.03)


@pytest.mark.parametrize("n", [0, 1, 4])
def test_too_few_samples_have_no_speed(n: int) -> None:
    time_ns, position = circling(100.0, 0.5)
    assert np.isnan(fastest_speed(time_ns[:n], position[:n]))


def test_points_that_were_never_seen_have_no_speed() -> None:
    time_ns, position = circling(100.0, 0.5)
    speed = fastest_speed(time_ns, np.full_like(position, np.nan))
    assert np.isnan(speed)
    assert judge_frame_rate(100.0, speed, 10.0, "measured").verdict == "open"


def test_a_tracker_without_frames_lets_a_marker_go_any_way() -> None:
    item = judge_frame_rate(0.0, 1.0, 10.0, "measured")
    assert item.verdict == "warn"
    assert "any way" in item.sentence
