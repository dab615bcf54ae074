"""A bend radius lies in its interval, which is open where the cable may be straight."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import bend_radius


@settings(deadline=None, max_examples=60)
@given(curvature=st.floats(1e-3, 1e3), sigma=st.floats(0, 1e3))
def test_the_interval_holds_the_radius_and_is_open_where_the_cable_may_be_straight(
    curvature: float, sigma: float
) -> None:
    bend = bend_radius(curvature, sigma)
    assert bend.radius_m == 1 / curvature
    assert 0 < bend.low_m <= bend.radius_m <= bend.high_m
    assert np.isinf(bend.high_m) == (curvature <= 2 * sigma)
    if np.isfinite(bend.high_m):
        assert bend.high_m - bend.radius_m >= (bend.radius_m - bend.low_m) * (1 - 1e-9)


def test_the_interval_is_two_standard_deviations_of_curvature() -> None:
    bend = bend_radius([[4.0, 0.0]], [[1.0, 0.5]])
    assert bend.radius_m.tolist() == [[0.25, np.inf]]
    assert bend.low_m.tolist() == [[1 / 6, 1.0]]
    assert bend.high_m.tolist() == [[0.5, np.inf]]


def test_what_is_unknown_stays_unknown() -> None:
    bend = bend_radius(np.array([10.0, np.nan]), np.array([np.nan, 1.0]))
    assert bend.radius_m[0] == 0.1
    assert np.isnan([bend.low_m[0], bend.high_m[0], *(x[1] for x in (bend.radius_m, bend.low_m, bend.high_m))]).all()
