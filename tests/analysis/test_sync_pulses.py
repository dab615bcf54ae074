"""One time by the pulses of a lamp, or a sentence that says why not."""

from __future__ import annotations

import numpy as np
import pytest

from bench.analysis import SwitchTimes, estimate_pulse_offset, see_lamp
from bench.errors import AnalysisError

OFFSET_S = -0.0046
"""The tracker's stamps are 4.6 ms late."""


def switch(rng: np.random.Generator, n_pulses: int, robot_hz: float = 500.0, frame_hz: float = 119.87):
    """Return what both devices see of a lamp that is on and off for a second or so each time."""
    edges_s = np.cumsum(rng.uniform(0.7, 1.3, 2 * n_pulses))
    robot_s = np.arange(0.0, edges_s[-1] + 1.0, 1 / robot_hz)
    frames_s = rng.uniform(0, 1 / frame_hz) + np.arange(0.0, edges_s[-1] + 1.0, 1 / frame_hz)
    output = np.searchsorted(edges_s, robot_s, side="right") % 2 == 1
    lit = np.searchsorted(edges_s, frames_s, side="right") % 2 == 1
    return SwitchTimes.find(robot_s, output), SwitchTimes.find(frames_s - OFFSET_S, lit)


def test_the_offset_is_known_within_its_standard_deviation_and_better_with_more_pulses():
    few = [estimate_pulse_offset(*switch(np.random.default_rng(seed), 6)) for seed in range(60)]
    many = [estimate_pulse_offset(*switch(np.random.default_rng(seed), 60)) for seed in range(60)]
    for found in (few, many):
        scores = np.array([(one.offset_s - OFFSET_S) / one.sigma_s for one in found])
        assert np.sqrt(np.mean(scores**2)) < 1.3
        assert np.abs(scores).max() < 4.0
    assert np.median([one.sigma_s for one in many]) < 0.3e-3 < np.median([one.sigma_s for one in few])


def test_a_lamp_that_is_hidden_for_a_moment_spoils_nothing():
    output, lamp = switch(np.random.default_rng(3), 30)
    hidden = SwitchTimes(
        np.sort(np.append(lamp.before_s, [lamp.before_s[20] + 0.45, lamp.before_s[20] + 0.55])),
        np.sort(np.append(lamp.after_s, [lamp.after_s[20] + 0.45, lamp.after_s[20] + 0.55])),
        np.insert(lamp.is_on, 21, [not lamp.is_on[20], lamp.is_on[20]]),
    )
    found = estimate_pulse_offset(output, hidden)
    assert abs(found.offset_s - OFFSET_S) < 4 * found.sigma_s


def test_too_few_pulses_and_a_lamp_that_goes_its_own_way_are_told():
    with pytest.raises(AnalysisError, match="Only 2 switchings"):
        estimate_pulse_offset(*switch(np.random.default_rng(1), 1))
    output, _ = switch(np.random.default_rng(1), 30)
    late = output.before_s + np.random.default_rng(2).uniform(-0.2, 0.2, len(output.before_s))
    with pytest.raises(AnalysisError, match="contradict each other"):
        estimate_pulse_offset(output, SwitchTimes(late, late + 0.01, output.is_on))


def test_a_lamp_is_seen_where_it_is_whatever_else_there_is():
    points = np.array([[0, 0, 1], [5, 5, 5], [0, 0.004, 1], [0, 0.02, 1]], dtype=np.float32)
    lit = see_lamp(points, np.array([0, 2, 2, 3, 4]), np.array([0.0, 0.0, 1.0]))
    assert lit.tolist() == [True, False, True, False]
