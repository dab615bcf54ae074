"""What the reader of a curvature by the heavy rod must know: what was fitted, and what is doubtful."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Floats32
from bench.analysis.curvature.rod_law import FittedLaw

__all__ = ["DOUBTFUL", "describe_fit", "warn_of_fit"]

DOUBTFUL = 2.5
"""Residual over noise above which the rod is not the cable: a correct model has 0.9."""
MOVED_M = 3e-3
"""A marker further from where it is said to sit was measured wrongly, not taped carelessly."""
FINEST_SHARE = 0.01
"""Of the length: a shorter bend beside the clamp than three of the mesh's segments there."""


def warn_of_fit(law: FittedLaw, residual_m: Floats32) -> list[str]:
    """Return the sentences on what is doubtful about a fit; `residual_m` (F,) is NaN in frames that have no curve."""
    said = [_alarm(residual_m, law.model.noise_m), _limits(law), _markers(law), _left_out(residual_m)]
    return [text for text in said if text]


def describe_fit(law: FittedLaw) -> str:
    """Return the sentence that says what was fitted."""
    stiffness, friction, knee = law.model.law
    sigma = 100 * law.relative_sigma
    if law.slips:
        return (
            "The heavy rod's bending moment over its weight per metre was fitted as "
            f"{stiffness:.3g} m³ κ + {friction:.3g} m² tanh(κ / {knee:.3g} m⁻¹), the first within {sigma:.1f} %: "
            "a stiffness that falls as the strands slip fits far better than a constant one."
        )
    return (
        f"The heavy rod's bending stiffness over its weight per metre was fitted as {stiffness:.3g} m³ ± {sigma:.1f} %;"
        f" beside a clamp its bend decays over {1e3 * law.clamp_reach_m:.0f} mm."
    )


def _alarm(residual_m: Floats32, noise_m: float) -> str:
    known = residual_m[np.isfinite(residual_m)]
    usual = float(np.median(known)) if len(known) else 0.0
    if usual <= DOUBTFUL * noise_m:
        return ""
    return (
        f"The heavy rod misses the markers by {1e3 * usual:.2g} mm where noise explains {1e3 * noise_m:.2g} mm: the "
        "cable is no such rod. A stiffness that falls with the bend reads the largest curvature 4 to 29 % too low "
        "(residuals of 1.4 to 6.4 mm), motion above 0.5 m/s its range at a clamp by up to 21 % (2 mm); or a clamp's "
        "place or direction, the cable's length or the vertical is wrong."
    )


def _limits(law: FittedLaw) -> str:
    if law.clamp_reach_m >= FINEST_SHARE * law.model.mesh.at_m[-1]:
        return ""
    return (
        f"The heavy rod is so limp that its bend beside a clamp, over {1e3 * law.clamp_reach_m:.1f} mm, is shorter "
        "than can be resolved: the cable may be bent tighter there than any figure says."
    )


def _markers(law: FittedLaw) -> str:
    shift = law.model.marker_m - law.said_m
    worst = int(np.abs(shift).argmax())
    if abs(shift[worst]) <= MOVED_M:
        return ""
    side = "beyond" if shift[worst] > 0 else "before"
    return (
        f"Marker {worst + 1} seems to sit {1e3 * abs(shift[worst]):.1f} mm {side} its arc length: check "
        "marker_arc_length_m and length_m."
    )


def _left_out(residual_m: Floats32) -> str:
    n_left = int(np.isnan(residual_m).sum())
    if not n_left:
        return ""
    return (
        f"{n_left} of {len(residual_m)} frames have no curve by the heavy rod: a clamp's pose is not known in them, "
        "fewer than three markers were found, the clamps are as far apart as the cable is long, or no rod in balance "
        "suits them."
    )
