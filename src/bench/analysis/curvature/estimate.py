"""What every estimator of the cable's curve is given and what it returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32
from bench.analysis.curvature.ends import CableEnd

__all__ = ["CURVE_CHUNK", "ClampedEnds", "CurveEstimate", "CurveEstimator", "group_by_seen_markers"]

CURVE_CHUNK = 500
"""Frames at once: 500 frames of 100 samples are 0.4 MB for each of the dozen arrays of the curvature formula."""


@dataclass(frozen=True, eq=False)
class CurveEstimate:
    """Curvature of F frames at G places along the cable."""

    curvature_per_m: Floats32
    """(F, G): magnitude, NaN where no curve could be drawn."""
    sigma_per_m: Floats32
    """(F, G): standard deviation; whether the method's own error is in it, the method says."""
    vector_per_m: Floats32 | None = None
    """(F, G, 3): curvature times the binormal, lab frame, where it was asked for."""
    residual_m: Floats32 | None = None
    """(F,): root mean square distance, per coordinate, of the markers from the fitted curve; None for interpolation."""
    method: str = ""
    """Name of the method that was used."""
    notes: list[str] = field(default_factory=list)
    """Sentences on how it was done: why this method, what was fitted."""
    warnings: list[str] = field(default_factory=list)
    """Sentences on what is doubtful."""


@dataclass(frozen=True, eq=False)
class ClampedEnds:
    """What is known of the cable's two ends besides its markers."""

    anchor: CableEnd | None
    """At arc length 0; its place or its tangent may be NaN where only the other is known. None: nothing is known."""
    end: CableEnd | None
    """At `length_m`; its tangent points from the clamp into the free cable, against the arc length."""
    length_m: float
    """Arc length of the end from the anchor."""
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    """Against gravity, a unit vector in the lab frame; y is the trackers' default."""


class CurveEstimator(Protocol):
    """Gives the curvature along the cable in every frame."""

    def __call__(
        self,
        position_m: Floats32,
        marker_arc_length_m: Floats,
        arc_length_m: Floats,
        noise_m: float,
        *,
        ends: ClampedEnds | None = None,
        with_vector: bool = False,
    ) -> CurveEstimate:
        """Estimate the curvature at `arc_length_m` (G,) from markers (F, k, 3) at `marker_arc_length_m` (k,)."""
        ...


def group_by_seen_markers(seen: Bools) -> list[tuple[Bools, np.ndarray[tuple[int], np.dtype[np.intp]]]]:
    """Return each pattern of seen markers (k,) with the indices of its frames."""
    packed = np.ascontiguousarray(np.packbits(seen, axis=1))
    keys = packed.view(np.dtype((np.void, packed.shape[1]))).ravel()
    _, first, pattern = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(pattern, kind="stable")
    bounds = np.searchsorted(pattern[order], np.arange(len(first) + 1))
    return [(seen[first[i]], order[bounds[i] : bounds[i + 1]]) for i in range(len(first))]
