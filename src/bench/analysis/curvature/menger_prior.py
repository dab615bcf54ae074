"""How smoothly a cable bends: a Matern process of curvature, integrated twice to where the markers are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Floats

__all__ = ["Layout", "Prior", "integrate_matern", "make_prior"]


@dataclass(frozen=True, eq=False)
class Layout:
    """What can be known of a cable, and how well: n nodes, and a tangent at each of its two clamps."""

    node_s_m: Floats
    """(n,): arc length of each node, ascending."""
    clamp_s_m: Floats
    """(2,): arc length of the clamps."""
    variance: Floats
    """(n + 2,): of a node's position across the cable, then of a tangent's angle."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Covariances of a process of curvature."""

    variance: float
    """Of each component of the curvature about its constant."""
    node_covariance: Floats
    """(n + 2, n + 2): of the nodes' offsets and the tangents' slopes; right only for double differences of them."""
    place_covariance: Floats
    """(G, n + 2): of the curvature at G places with the same."""


def make_prior(layout: Layout, places: Floats, amplitude_per_m: float, length_m: float) -> Prior:
    """Return the Matern-5/2 process of that standard deviation and length."""
    variance, s, clamps = amplitude_per_m**2, layout.node_s_m, layout.clamp_s_m
    value, slope = integrate_matern(s[:, None] - s, length_m, 4), integrate_matern(s[:, None] - clamps, length_m, 3)
    turn = integrate_matern(clamps[:, None] - clamps, length_m, 2)
    of_places = (
        integrate_matern(places[:, None] - s, length_m, 2),
        integrate_matern(places[:, None] - clamps, length_m, 1),
    )
    return Prior(
        variance,
        variance * np.block([[value, -slope], [-slope.T, -turn]]),
        variance * np.hstack([of_places[0], -of_places[1]]),
    )


def integrate_matern(distance_m: Floats, length_m: float, times: int) -> Floats:
    """Return the Matern-5/2 correlation integrated up to four times over the signed distance.

    Of each even integral only the part that no double difference takes away is right; odd ones are odd functions.
    """
    unit = np.sqrt(5.0) / length_m
    r = unit * np.abs(distance_m)
    fading = np.exp(-r)
    if times == 1:
        value = 8 / 3 - (8 / 3 + 5 * r / 3 + r**2 / 3) * fading
    elif times == 2:
        value = 8 * r / 3 + (5 + 7 * r / 3 + r**2 / 3) * fading
    elif times == 3:
        value = 8 + 4 * r**2 / 3 - (8 + 3 * r + r**2 / 3) * fading
    else:
        value = 8 * r + 4 * r**3 / 9 + (35 / 3 + 11 * r / 3 + r**2 / 3) * fading
    odd = np.sign(distance_m) if times % 2 else 1.0
    return np.asarray(odd * value / unit**times)
