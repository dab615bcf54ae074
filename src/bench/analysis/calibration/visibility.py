"""Where along a path which markers are not seen, and whether they are hidden there or have left the view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from bench.analysis.arrays import Bools, Floats
from bench.analysis.calibration.prediction import predict_position

__all__ = ["HiddenStretch", "find_hidden_stretches"]

MOST_HULL_POINTS = 20_000
"""Positions that the hull is made of; a cycle of 800 frames with 10 markers has 8 000."""
MOST_LOOKS = 50
"""Frames of a stretch in which the marker's place is looked at."""
NEAR_FRAMES = 10
"""A tenth of a second at 100 frames/s: a trusted frame further away tells less than a doubtful one beside."""
SUM_WEIGHT = 1e4
"""How much stronger the shares of the corners are held to a sum of 1 than the place is to the point."""


@dataclass(frozen=True, eq=False)
class HiddenStretch:
    """Consecutive frames in which one marker is not seen."""

    marker_index: int
    start: int
    """First frame without the marker."""
    stop: int
    """First frame after that; the number of frames if there is none."""
    edge_m: Floats
    """(3,): where it was last seen, or first seen again if it was not seen before; NaN if it never was."""
    outside_m: Floats
    """(3,): how far out of the space in which markers are seen it is, and in which direction, as its neighbours tell:
    of the frames the middle one, for single ones may be wrong. Zero within, NaN where it was never seen."""

    @property
    def n_frames(self) -> int:
        """Frames without the marker."""
        return self.stop - self.start


def find_hidden_stretches(
    position_m: Floats, anchor_m: Floats | None, trusted: Bools, fewest_frames: int
) -> list[HiddenStretch]:
    """Find where markers are missing for some frames in a row, and whether they left the view.

    The common view of cameras is convex, as each camera's is, so that whatever lies within the convex hull of all that
    was seen is in view: a marker missing there is hidden by something. One that goes out of it may have left the view;
    where it goes is told by where it was last and next seen, moved along with its neighbours.

    Parameters
    ----------
    position_m : (F, k, 3)
        Markers in frames of one cycle, in order of time, NaN where not found.
    anchor_m : (F, 3) or None
        Start of the cable.
    trusted : (F,)
        Frames that are sorted without doubt. Where a marker was last and next seen is taken from these where one is
        near, for a point that takes a marker's place as it goes is often another.
    fewest_frames : int
        Shorter stretches are left out.

    Returns
    -------
    list of HiddenStretch
        By marker, then by time.
    """
    nodes = position_m if anchor_m is None else np.concatenate([anchor_m[:, None], position_m], axis=1)
    first = nodes.shape[1] - position_m.shape[1]
    corners_m = _find_corners(nodes)
    return [
        _describe(nodes, marker, first, start, stop, _find_known(trusted, start, stop), corners_m)
        for marker in range(position_m.shape[1])
        for start, stop in _runs(np.isnan(position_m[:, marker, 0]))
        if stop - start >= fewest_frames
    ]


def _runs(missing: Bools) -> list[tuple[int, int]]:
    """Return (start, stop) of each stretch of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def _find_corners(nodes: Floats) -> Floats:
    """Return the corners (m, 3) of the convex hull of everything that was seen."""
    seen = nodes[np.isfinite(nodes[..., 0])]
    seen = seen[:: max(1, -(-len(seen) // MOST_HULL_POINTS))]
    try:
        # QJ: a flat cloud, as of a cable that stays in a plane, has a hull too
        return np.asarray(seen[scipy.spatial.ConvexHull(seen, qhull_options="QJ").vertices])
    except (scipy.spatial.QhullError, ValueError):  # too few points
        return np.asarray(seen)


def _way_out(point_m: Floats, corners_m: Floats) -> Floats:
    """Return the vector (3,) from the nearest place within a convex hull to a point; zero for a point inside."""
    apart = (corners_m - point_m).T
    weight = SUM_WEIGHT * max(float(np.abs(apart).max()), 1e-3)
    corners_and_sum = np.vstack([apart, np.full(len(corners_m), weight)])
    share, _ = scipy.optimize.nnls(corners_and_sum, np.array([0.0, 0.0, 0.0, weight]))
    return np.asarray(-(apart @ share) / share.sum())


def _find_known(trusted: Bools, start: int, stop: int) -> list[int]:
    """Return the frames before and after a stretch by which to tell where its marker is."""
    sides = []
    if start > 0:
        near = np.flatnonzero(trusted[max(start - NEAR_FRAMES, 0) : start][::-1])
        sides.append(start - 1 - int(near[0]) if len(near) else start - 1)
    if stop < len(trusted):
        near = np.flatnonzero(trusted[stop : stop + NEAR_FRAMES])
        sides.append(stop + int(near[0]) if len(near) else stop)
    return sides


def _describe(
    nodes: Floats, marker: int, first: int, start: int, stop: int, known: list[int], corners_m: Floats
) -> HiddenStretch:
    node = marker + first
    if not known:
        unknown = np.full(3, np.nan)
        return HiddenStretch(marker, start, stop, unknown, unknown)
    looked_at = np.unique(np.linspace(start, stop - 1, MOST_LOOKS).round().astype(np.int64))
    out_m = np.array([_way_out_at(nodes, node, int(frame), known, corners_m) for frame in looked_at])
    middle = int(np.linalg.norm(out_m, axis=1).argsort()[len(out_m) // 2])
    return HiddenStretch(marker, start, stop, nodes[known[0], node], out_m[middle])


def _way_out_at(nodes: Floats, node: int, frame: int, known: list[int], corners_m: Floats) -> Floats:
    """Return how far out (3,) a node is in a frame in which it is not seen: the least that a known frame tells."""
    told = [_way_out(predict_position(nodes[ref], nodes[frame], node), corners_m) for ref in known]
    return min(told, key=lambda out_m: float(np.linalg.norm(out_m)))
