"""Known shapes: place, direction and curvature belong together, and the catenary's radius is eq. (5), put right."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.analysis import Catenary, Circle, SampledShape, Straight

SHAPES = [Circle(0.4), Catenary(0.5, 1.0), Catenary(0.12), Straight()]
STEP_M = 1e-4


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.name)
@given(at_m=st.floats(-1.5, 1.5))
def test_direction_and_curvature_are_the_derivatives_of_the_place(shape, at_m):
    before, here, after = shape.place(at_m + np.array([-STEP_M, 0.0, STEP_M]))
    np.testing.assert_allclose((after - before) / (2 * STEP_M), shape.tangent(np.array(at_m)), atol=1e-5)
    bend = np.linalg.norm(after - 2 * here + before) / STEP_M**2
    assert bend == pytest.approx(float(shape.curvature(np.array(at_m))), rel=1e-3, abs=1e-6)


def test_the_radius_of_the_papers_catenary_goes_from_half_a_metre_to_two_and_a_half():
    radius = 1 / Catenary(0.5, bottom_m=1.0).curvature(np.array([0.0, 1.0, 2.0]))
    np.testing.assert_allclose(radius, [2.5, 0.5, 2.5])


def test_the_catenary_is_that_of_its_equation():
    x, y, _ = Catenary(0.5, 1.0).place(np.linspace(0, 2, 21)).T
    np.testing.assert_allclose(y, 0.5 * np.cosh(x / 0.5))


def test_a_sampled_circle_is_a_circle():
    at = np.linspace(0, 1, 2001)
    circle = Circle(0.3)
    angle = np.pi / 2 + at / 0.3
    sampled = SampledShape("arc", at, angle, circle.place(at), circle.curvature(at))
    between = np.linspace(0.05, 0.95, 37)
    np.testing.assert_allclose(sampled.place(between), circle.place(between), atol=1e-7)
    np.testing.assert_allclose(sampled.tangent(between), circle.tangent(between), atol=1e-7)
    np.testing.assert_allclose(sampled.curvature(between), circle.curvature(between))
    assert sampled.length_m == 1.0
