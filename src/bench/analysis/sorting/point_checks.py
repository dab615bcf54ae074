"""What is wrong with a tracker's points before any of them is sorted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats32, Ints, chunks, frame_of_points, pad_points
from bench.errors import AnalysisError

__all__ = ["PointChecks", "check_points"]

SCANNED_FRAMES = 60
SCALE_LIMIT = 100.0
"""Nearest points are a spacing apart, or a few times less beside ghosts: a hundred times is another unit of length."""


@dataclass(frozen=True, eq=False)
class PointChecks:
    """Which of N points are points at all, and what is to be said about the others."""

    good: Bools
    """(N,): finite, and not the same as an earlier point of its frame."""
    warnings: list[str]


def check_points(points_m: Floats32, offsets: Ints, arc_length_m: tuple[float, ...]) -> PointChecks:
    """Find points without a place, points listed twice, and lengths in another unit than metres.

    Parameters
    ----------
    points_m : (N, 3)
        All points of all frames, lab frame.
    offsets : (F + 1,)
        Where each frame's points begin.
    arc_length_m : (k,)
        Of the markers from the anchor: how far apart points are expected.

    Raises
    ------
    AnalysisError
        The points are a hundred times as far apart as the cable's markers, or a hundredth: they are not in metres.
    """
    finite = np.asarray(np.isfinite(points_m).all(axis=1), dtype=bool)
    twice = _find_doubles(points_m, offsets, finite)
    _verify_scale(points_m, offsets, finite & ~twice, arc_length_m)
    warnings = []
    for bad, what in ((~finite, "have no finite place"), (twice, "are listed twice in their frame, at one place")):
        if bad.any():
            frames = np.unique(frame_of_points(offsets)[bad])
            warnings.append(
                f"{int(bad.sum())} points in {len(frames)} frames {what}, first in frame {frames[0]} of the recording: "
                "they are left out."
            )
    return PointChecks(finite & ~twice, warnings)


def _find_doubles(points_m: Floats32, offsets: Ints, finite: Bools) -> Bools:
    """Return the points (N,) that are the same as an earlier one of their frame."""
    twice = np.zeros(len(points_m), dtype=bool)
    for frame in _frames_with_equal_sums(points_m, offsets, finite).tolist():
        part = slice(offsets[frame], offsets[frame + 1])
        _, first, which = np.unique(points_m[part], axis=0, return_index=True, return_inverse=True)
        twice[part] = finite[part] & (first[which] != np.arange(len(which)))
    return twice


def _frames_with_equal_sums(points_m: Floats32, offsets: Ints, finite: Bools) -> Ints:
    """Return the frames in which two points have the same sum of coordinates: few, and cheaply found."""
    found = []
    for start, stop in chunks(len(offsets) - 1):
        position, known = pad_points(points_m, offsets, finite, np.arange(start, stop))
        total = np.sort(np.where(known, position.sum(axis=2), np.nan), axis=1)
        found.append(start + np.flatnonzero((np.diff(total, axis=1) == 0).any(axis=1)))
    return np.concatenate(found) if found else np.zeros(0, dtype=np.int64)


def _verify_scale(points_m: Floats32, offsets: Ints, good: Bools, arc_length_m: tuple[float, ...]) -> None:
    filled = np.flatnonzero(np.diff(offsets) > 1)
    chosen = np.linspace(0, len(filled) - 1, min(SCANNED_FRAMES, len(filled))).astype(np.int64)
    position, known = pad_points(points_m, offsets, good, filled[chosen])
    apart = np.linalg.norm(position[:, :, None] - position[:, None], axis=3)
    apart[~(known[:, :, None] & known[:, None])] = np.nan
    apart[:, np.arange(apart.shape[1]), np.arange(apart.shape[1])] = np.nan
    nearest = np.fmin.reduce(apart, axis=2, initial=np.inf)
    nearest = nearest[np.isfinite(nearest)]
    spacing_m = float(np.median(np.diff(arc_length_m, prepend=0.0)))
    if not len(nearest) or spacing_m / SCALE_LIMIT < np.median(nearest) < spacing_m * SCALE_LIMIT:
        return
    usual = float(np.median(nearest))
    raise AnalysisError(
        f"The tracker's points are {usual:.3g} m from their nearest neighbours, the cable's markers {spacing_m:.3g} m: "
        f"{max(usual / spacing_m, spacing_m / usual):.0f} times apart.",
        hint="Lengths are in metres. Was the take exported in millimetres under a header that says metres?",
    )
