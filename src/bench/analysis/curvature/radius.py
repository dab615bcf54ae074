"""Bend radius from curvature: an interval that is not symmetric, and open where the cable may be straight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.analysis.arrays import Floats

__all__ = ["BendRadius", "bend_radius"]

BAND = 2.0
"""Standard deviations to either side, as everywhere in the report."""


@dataclass(frozen=True, eq=False)
class BendRadius:
    """Bend radii with their intervals, metres, each of the shape of the curvature."""

    radius_m: Floats
    """Infinite where straight, NaN where there is no curve."""
    low_m: Floats
    """Two standard deviations of curvature tighter; NaN where the standard deviation is unknown, as in `high_m`."""
    high_m: Floats
    """Two standard deviations gentler; infinite where these reach a straight cable."""


def bend_radius(curvature_per_m: npt.ArrayLike, sigma_per_m: npt.ArrayLike) -> BendRadius:
    """Return R = 1 / kappa and its interval R / (1 ± 2 sigma / kappa).

    Noise of the markers is symmetric in curvature, so the interval is not in radius: its gentle side is the wider one.

    Parameters
    ----------
    curvature_per_m, sigma_per_m : array of float
        Magnitude of the curvature and its standard deviation, of one shape.
    """
    curvature = np.asarray(curvature_per_m, dtype=np.float64)
    band = BAND * np.asarray(sigma_per_m, dtype=np.float64)
    return BendRadius(_invert(curvature), _invert(curvature + band), _invert(curvature - band))


def _invert(curvature_per_m: Floats) -> Floats:
    """Return the radius, infinite where the curvature is zero or would be negative."""
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.maximum(curvature_per_m, 0.0))
