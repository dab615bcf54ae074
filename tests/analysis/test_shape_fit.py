"""A known shape laid into markers: pose, placement errors and noise come back; what does not fit is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bench.analysis import (
    Catenary,
    Circle,
    RigidTransform,
    Straight,
    average_frames,
    fit_shape,
    fit_size,
    verify_on_shape,
)
from bench.errors import AnalysisError, TooFewMarkersError

CASES = [
    (Circle(0.4), np.arange(8) * 0.3, 0.0),
    (Circle(0.15), np.array([0.06, 0.18, 0.3, 0.42]), 0.0),
    (Catenary(0.5), np.linspace(0.1, 1.9, 12), -0.93),
    (Straight(), np.linspace(0.05, 1.0, 6), 0.0),
]


def some_pose(seed):
    return RigidTransform(Rotation.random(random_state=seed).as_matrix(), np.array([1.0, -2.0, 0.5]))


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 1000))
@pytest.mark.parametrize(("shape", "arc", "offset"), CASES, ids=lambda one: getattr(one, "name", None))
def test_markers_on_a_shape_lie_on_it_wherever_it_is_and_placement_errors_are_found(shape, arc, offset, seed):
    placed = np.random.default_rng(seed).normal(0, 0.005, len(arc))
    position = some_pose(seed).apply(shape.place(arc + offset + placed))
    fit = fit_shape(position, arc, shape)
    assert fit.rms_m < 2e-6
    np.testing.assert_allclose(fit.at_m - arc - fit.offset_m, placed - placed.mean(), atol=1e-4)
    np.testing.assert_allclose(fit.lab_from_shape.apply(shape.place(fit.at_m)), position, atol=1e-5)
    if not shape.is_uniform:
        assert fit.offset_m == pytest.approx(offset + placed.mean(), abs=1e-4)


def test_a_marker_off_the_axis_is_off_the_shape_and_not_beside_its_place():
    circle, arc = Circle(0.4), np.arange(8) * 0.3
    position = circle.place(arc)
    position[3, 2] += 0.004
    fit = fit_shape(position, arc, circle)
    assert fit.distance_m.argmax() == 3
    assert 0.0025 < fit.distance_m[3] < 0.004
    assert np.abs(fit.at_m - arc - fit.offset_m).max() < 1e-4


@pytest.mark.parametrize(("make", "size", "arc"), [(Circle, 0.4, np.arange(8) * 0.3), (Catenary, 0.5, CASES[2][1])])
def test_the_markers_own_size_is_found_from_a_wrong_one(make, size, arc):
    position = some_pose(3).apply(make(size).place(arc - 0.9))
    wrong = fit_shape(position, arc, make(size * 1.05))
    assert fit_size(position, arc, make, size * 1.05, wrong) == pytest.approx(size, rel=1e-3)


def test_frames_of_a_solid_that_moves_are_laid_onto_each_other():
    rng = np.random.default_rng(8)
    template = Circle(0.4).place(np.arange(8) * 0.3)
    frames = np.array([some_pose(seed).apply(template) for seed in range(200)])
    mean, laid = average_frames(frames + rng.normal(0, 2e-4, frames.shape))
    scatter = np.sqrt(np.square(laid - mean).sum() / (199 * (3 * 8 - 6)))
    assert scatter == pytest.approx(2e-4, rel=0.05)
    assert fit_shape(mean, np.arange(8) * 0.3, Circle(0.4)).rms_m < 5e-5


def test_the_roll_of_a_straight_rod_is_not_made_up_from_its_noise():
    template = Straight().place(np.linspace(0, 1, 6))
    frames = template + np.random.default_rng(9).normal(0, 2e-4, (200, 6, 3))
    mean, _ = average_frames(frames)
    assert fit_shape(mean, np.linspace(0, 1, 6), Straight()).rms_m < 4e-5


def test_three_markers_tell_no_shape():
    with pytest.raises(TooFewMarkersError, match="3 markers tell no shape"):
        fit_shape(Circle(0.4).place(np.arange(3) * 0.3), np.arange(3) * 0.3, Circle(0.4))


def test_more_cable_than_the_circle_has_is_refused_with_both_lengths():
    arc = np.arange(8) * 0.3
    with pytest.raises(AnalysisError, match=r"cover 2100 mm of cable, but the shape .* has only 1885 mm"):
        fit_shape(Circle(0.4).place(arc), arc, Circle(0.3))


def test_markers_of_another_shape_are_refused_with_their_distance():
    arc = np.linspace(0, 1.2, 8)
    fit = fit_shape(Straight().place(arc), arc, Circle(0.3))
    with pytest.raises(AnalysisError, match="do not lie on the shape"):
        verify_on_shape(fit, arc, Circle(0.3))
    verify_on_shape(fit_shape(Straight().place(arc), arc, Straight()), arc, Straight())
