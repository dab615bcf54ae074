"""Shapes that frames come in: a flat point list with offsets, and rows of equal length for vector arithmetic."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

__all__ = [
    "Bools",
    "Floats",
    "Floats32",
    "Indices",
    "Ints",
    "chunks",
    "frame_of_points",
    "median_of_rows",
    "pad_points",
]

Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]
Floats32 = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int16]
Ints = npt.NDArray[np.int64]

CHUNK = 2_000
"""Frames worked on at once: 2 000 frames of 13 points are 0.6 MB, which fits a core's cache."""


def chunks(n_frames: int, size: int = CHUNK) -> Iterator[tuple[int, int]]:
    """Yield (start, stop) of consecutive stretches of at most `size` frames."""
    for start in range(0, n_frames, size):
        yield start, min(start + size, n_frames)


def frame_of_points(offsets: Ints) -> Ints:
    """Return for each point the index of its frame, shape (N,)."""
    return np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))


def pad_points(points_m: Floats32, offsets: Ints, usable: Bools, frames: Ints) -> tuple[Floats, Bools]:
    """Lay the points of some frames out as rows of equal length.

    Parameters
    ----------
    points_m : (N, 3)
        All points of all frames, lab frame, metres.
    offsets : (F + 1,)
        Points of frame f are ``points_m[offsets[f]:offsets[f + 1]]``.
    usable : (N,)
        Which points may be the cable's.
    frames : (C,)
        Indices of the wanted frames.

    Returns
    -------
    position_m : (C, n, 3)
        NaN beyond a frame's last point, and where a point has no finite place; n is the longest frame's number of
        points, at least 1.
    open_points : (C, n)
        True for usable points.
    """
    first, count = offsets[frames], offsets[frames + 1] - offsets[frames]
    slot = np.arange(max(1, int(count.max(initial=0))))
    filled = slot < count[:, None]
    position = np.full((*filled.shape, 3), np.nan)
    open_points = np.zeros(filled.shape, dtype=bool)
    index = (first[:, None] + slot)[filled]
    points = points_m[index]
    position[filled] = np.where(np.isfinite(points), points, np.nan)
    open_points[filled] = usable[index]
    return position, open_points


def median_of_rows(values: Floats | Floats32) -> Floats:
    """Return the median (G,) over the rows (R, G), R >= 1, without their NaNs; NaN where nothing else is."""
    ascending = np.sort(values, axis=0)  # NaNs go last
    count = np.isfinite(ascending).sum(axis=0)
    column = np.arange(values.shape[1])
    low, high = np.maximum((count - 1) // 2, 0), np.minimum(count // 2, len(values) - 1)
    middle = (ascending[low, column].astype(np.float64) + ascending[high, column]) / 2
    return np.where(count > 0, middle, np.nan)
