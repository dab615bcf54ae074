"""The signed curvature: two components in a frame that goes along the cable without twisting about it."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Floats, Floats32
from bench.analysis.curvature.estimate import ClampedEnds

__all__ = ["resolve_curvature"]


def resolve_curvature(
    vector_per_m: Floats32,
    position_m: Floats32,
    marker_arc_length_m: Floats,
    arc_length_m: Floats,
    *,
    ends: ClampedEnds | None = None,
) -> Floats32:
    """Return the two components of the curvature across the cable, in a twist-free frame.

    The magnitude of the curvature hides whether a cable is bent to and fro or only to and back: a swing from -K to +K
    strains a wire over 2 K, and counted on the magnitude over K. So damage is counted on components: a wire at the
    angle phi about the centreline, at the distance r from it, is strained by r (k1 cos phi + k2 sin phi).

    The frame is fixed to the anchor's end: there its first axis is across the cable and next to one of the lab's axes,
    the same in all frames; where the cable leaves the anchor in another direction than it does on average, the frame is
    turned by the shortest way. So it is continuous over time, and the same again when the motion is. From there it is
    carried from chord to chord of the markers by the shortest turns: as a cable moves that is not twisted. It says
    nothing of the twist that the cable has.

    Parameters
    ----------
    vector_per_m : (F, G, 3)
        Curvature times the binormal, lab frame, as an estimator gives it.
    position_m : (F, k, 3)
        Sorted markers, NaN where not found.
    marker_arc_length_m : (k,)
        Ascending.
    arc_length_m : (G,)
        Ascending.
    ends : ClampedEnds, optional
        The anchor's tangent is where the frame begins; without it, the first chord.

    Returns
    -------
    (F, G, 2) float32
        Curvature towards the frame's first and second axis; NaN where there is no vector, or no two markers.

    References
    ----------
    R. L. Bishop, There is more than one way to frame a curve, 1975.
    """
    from bench.analysis.kernels.transport import carry_frames

    n_frames, n_places = vector_per_m.shape[:2]
    tangent = np.full((n_frames, 3), np.nan)
    if ends is not None and ends.anchor is not None:
        tangent = np.ascontiguousarray(ends.anchor.tangent, dtype=np.float64)
    reference = _find_reference(tangent, position_m)
    across = np.eye(3)[np.abs(reference).argmin()]
    across = across - (across @ reference) * reference
    across /= np.linalg.norm(across)
    components = np.empty((n_frames, n_places, 2), dtype=np.float32)
    position = np.ascontiguousarray(position_m, dtype=np.float32)
    vector = np.ascontiguousarray(vector_per_m, dtype=np.float32)
    s_m, places = (np.ascontiguousarray(a, dtype=np.float64) for a in (marker_arc_length_m, arc_length_m))
    carry_frames(position, s_m, tangent, reference, across, vector, places, components)
    return components


def _find_reference(tangent: Floats, position_m: Floats32) -> Floats:
    """Return the mean direction (3,) in which the cable leaves the anchor, by its tangent or the first two markers."""
    for direction in (tangent, np.diff(position_m[:, :2].astype(np.float64), axis=1).reshape(-1, 3)):
        known = direction[np.isfinite(direction).all(axis=1)]
        length = np.linalg.norm(known.sum(axis=0))
        if length > 0.0:
            return np.asarray(known.sum(axis=0) / length)
    return np.array([1.0, 0.0, 0.0])
