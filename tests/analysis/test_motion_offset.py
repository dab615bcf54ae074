"""The clocks' offset from the flange's speed alone, or a sentence that says why it cannot be told."""

from dataclasses import replace

import numpy as np
import pytest
from flange_examples import OFFSET_S, make_flange

from bench.analysis import estimate_motion_offset
from bench.errors import AnalysisError


def spin(time_s: np.ndarray) -> np.ndarray:
    """Return a flange on a circle at constant speed."""
    place = np.stack([0.2 * np.cos(time_s), 0.2 * np.sin(time_s), 0 * time_s + 0.4], axis=1)
    return np.hstack([place, np.stack([0 * time_s, 0 * time_s, 0.5 + 0.4 * np.sin(0 * time_s)], axis=1)])


def shake(time_s: np.ndarray) -> np.ndarray:
    """Return a flange whose speed repeats itself every 0.3 s."""
    place = np.stack([0.05 * np.sin(2 * np.pi * time_s / 0.6), 0 * time_s, 0 * time_s], axis=1)
    return np.hstack([place, np.zeros((len(time_s), 3))])


def test_the_offset_is_known_within_its_standard_deviation() -> None:
    found = [
        estimate_motion_offset(s.track, s.seen) for s in (make_flange(np.random.default_rng(i)) for i in range(40))
    ]
    scores = np.array([(one.offset_s - OFFSET_S) / one.sigma_s for one in found])
    # overlapping chords err against each other, which stretches of a second see in part: the deviation is never small
    assert 0.3 < np.sqrt(np.mean(scores**2)) < 1.25
    assert np.max([one.sigma_s for one in found]) < 3e-3
    assert min(one.agreement for one in found) > 0.8


def test_positions_alone_give_the_offset_to_a_few_milliseconds() -> None:
    scene = make_flange(np.random.default_rng(1), n_frames=1000)
    found = estimate_motion_offset(scene.track, replace(scene.seen, quaternion_xyzw=None))
    assert abs(found.offset_s - OFFSET_S) < max(3 * found.sigma_s, 0.01)


def test_constant_speed_tells_no_offset() -> None:
    scene = make_flange(np.random.default_rng(2), motion=spin)
    with pytest.raises(AnalysisError, match=r"hardly changes|fit alike"):
        estimate_motion_offset(scene.track, scene.seen)


def test_a_speed_that_repeats_itself_is_said_to_be_ambiguous() -> None:
    scene = make_flange(np.random.default_rng(3), motion=shake, noise_rad=0.2)
    with pytest.raises(AnalysisError, match="repeats itself"):
        estimate_motion_offset(scene.track, scene.seen)


def test_too_few_frames_are_refused() -> None:
    scene = make_flange(np.random.default_rng(4), n_frames=30)
    with pytest.raises(AnalysisError, match="moments while the robot told its pose"):
        estimate_motion_offset(scene.track, scene.seen)
