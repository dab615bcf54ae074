"""Frames as the heavy rod is fitted to them: seen from the anchor, and gathered where the clamps stand alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Ints
from bench.analysis.curvature.ends import CableEnd
from bench.analysis.curvature.estimate import ClampedEnds
from bench.errors import AnalysisError

__all__ = ["RodFrames", "ShapeCells", "find_cells", "place_in_rod"]

FEWEST_MARKERS = 3
"""With fewer the residual says nothing about the model: the clamps alone have as many unknowns."""
LEAST_SIGMA_RAD = 1e-3
"""No clamp holds a cable to better than 0.06 degrees."""
TAUTEST = 0.995
"""Share of its length that a rod may span: beyond it the shape is a straight line, and stretch decides."""
CELL_SHARE = 0.01
"""Of the length: how far the clamps of frames that share a shape may be apart, along each axis."""
CELL_RAD = 0.04
"""The same for their directions: with it the linear step errs by 0.1 %, at most 0.3 %, of the peak, and with twice as
much by at most 0.5 % (measured 2026-11, rods of 81 and 27 mm smallest radius on a motion that does not repeat)."""
MOST_CELLS = 20_000
"""More, of a motion that does not repeat, are made fewer by cells of twice the size: a shape costs 0.2 ms."""
MIXER = np.int64(6_364_136_223_846_793_005)
"""Its powers make one number of nine, wrapping round (Knuth's linear congruential multiplier)."""
ALIKE_SHARE = 0.1
"""Of a cell's size: clamps no further apart than this belong to one shape; the mean of others would be no rod."""
MOST_OF_A_CELL = 64
"""Frames whose median is a cell's shape: an eighth of one frame's noise."""


@dataclass(frozen=True, eq=False)
class RodFrames:
    """F frames in which both clamps are known and enough markers seen."""

    row: Ints
    """(F,): their rows in the recording."""
    markers_m: Floats32
    """(F, k, 3): lab frame's axes, seen from the anchor."""
    clamps: Floats
    """(F, 9): place of the end (m), direction at the start, direction at the end, along the cable."""
    sigma: Floats
    """(F, 4): standard deviation of the start's and the end's place (m) and direction (rad)."""
    length_m: float
    """Of the rod."""
    up: Floats
    """(3,): against gravity, a unit vector."""


@dataclass(frozen=True, eq=False)
class ShapeCells:
    """R groups of frames whose clamps stand alike, with a shape for each: the median of its frames."""

    cell: Ints
    """(F,): the cell of each frame."""
    markers_m: Floats
    """(R, k, 3): NaN where a marker was seen in none of the cell's frames."""
    clamps: Floats
    """(R, 9)"""
    sigma: Floats
    """(R, 4)"""


def place_in_rod(position_m: Floats32, ends: ClampedEnds | None, noise_m: float) -> RodFrames:
    """Return the frames that a rod can be fitted to.

    Raises
    ------
    AnalysisError
        The place or the direction of one of the two clamps is known in no frame.
    """
    ends = ends or ClampedEnds(None, None, 0.0)
    anchor, end = _known(ends.anchor, "anchor"), _known(ends.end, "end")
    with np.errstate(invalid="ignore"):
        reach = end.position_m - anchor.position_m
        usable = np.linalg.norm(reach, axis=1) < TAUTEST * ends.length_m
    numbers = np.column_stack([reach, anchor.tangent, -end.tangent])
    sigma = np.column_stack(
        [anchor.position_sigma_m, end.position_sigma_m, anchor.tangent_sigma_rad, end.tangent_sigma_rad]
    )
    usable &= np.isfinite(numbers).all(axis=1) & np.isfinite(sigma).all(axis=1)
    usable &= (~np.isnan(position_m[:, :, 0])).sum(axis=1) >= FEWEST_MARKERS
    row = np.flatnonzero(usable)
    if not len(row):
        raise AnalysisError(
            f"The heavy rod ('elastica') fits in no frame: none has {FEWEST_MARKERS} markers and both clamps known, "
            f"less than the cable's length of {ends.length_m:g} m apart.",
            hint="Check [cable] length_m and what holds both ends, or choose another [analysis] curvature.",
        )
    markers = (position_m[row] - anchor.position_m[row, None]).astype(np.float32)
    # A clamp is known no better than a marker beside it would tell.
    least = np.array([noise_m, noise_m, LEAST_SIGMA_RAD, LEAST_SIGMA_RAD])
    up = np.array(ends.up) / np.linalg.norm(ends.up)
    return RodFrames(row, markers, np.ascontiguousarray(numbers[row]), np.maximum(sigma[row], least), ends.length_m, up)


def _known(end: CableEnd | None, name: str) -> CableEnd:
    if end is None or not np.isfinite(end.position_m).all(axis=1).any():
        raise _refusal(f"the place of the cable's {name} is not known well enough", name)
    if not np.isfinite(end.tangent).all(axis=1).any():
        raise _refusal(f"the direction of the clamp at the cable's {name} is not known", name)
    return end


def find_cells(frames: RodFrames) -> ShapeCells:
    """Gather frames whose clamps stand alike, and take the median of each cell as its shape."""
    size = np.concatenate([np.full(3, CELL_SHARE * frames.length_m), np.full(6, CELL_RAD)])
    cell = _number_cells(frames.clamps / size)
    if cell.max() >= MOST_CELLS:
        cell = _number_cells(frames.clamps / (2 * size))
    order = np.argsort(cell, kind="stable")
    members = np.split(order, np.flatnonzero(np.diff(cell[order])) + 1) if len(order) else []
    k = frames.markers_m.shape[1]
    markers, clamps, sigma = np.empty((len(members), k, 3)), np.empty((len(members), 9)), np.empty((len(members), 4))
    for i, rows in enumerate(members):
        chosen = rows[_find_alike(frames.clamps[rows] / size)]
        markers[i] = _median(frames.markers_m[chosen])
        clamps[i], sigma[i] = frames.clamps[chosen].mean(axis=0), frames.sigma[chosen].mean(axis=0)
    directions = clamps[:, 3:].reshape(-1, 2, 3)
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    return ShapeCells(cell, markers, clamps, sigma)


def _number_cells(clamps: Floats) -> Ints:
    """Return the number of each frame's cell, in order of time, so that a shape's neighbour is one to start from."""
    steps = np.floor(clamps + 0.5).astype(np.int64)
    _, first, cell = np.unique(steps @ MIXER ** np.arange(9), return_index=True, return_inverse=True)
    return np.asarray(np.argsort(np.argsort(first))[cell])


def _find_alike(clamps: Floats) -> Ints:
    """Return the frames that stand as the one in the middle of their cell does; `clamps` (n, 9) in sizes of a cell."""
    middle = np.abs(clamps - clamps.mean(axis=0)).max(axis=1).argmin()
    alike = np.flatnonzero(np.abs(clamps - clamps[middle]).max(axis=1) <= ALIKE_SHARE)
    return alike[:: -(-len(alike) // MOST_OF_A_CELL)]


def _median(markers_m: Floats32) -> Floats:
    seen: Bools = ~np.isnan(markers_m[:, :, 0])
    if seen.all():
        return np.asarray(np.median(markers_m, axis=0), dtype=np.float64)
    found = np.full(markers_m.shape[1:], np.nan)
    for marker in np.flatnonzero(seen.any(axis=0)):
        found[marker] = np.median(markers_m[seen[:, marker], marker], axis=0)
    return found


def _refusal(what: str, name: str) -> AnalysisError:
    other = ", or let 'bench calibrate' find it" if name == "end" else ""
    return AnalysisError(
        f"The heavy rod ('elastica') cannot be fitted: {what} in any frame.",
        hint=f"Give [cable.{name}] with clamp_direction, and clamp_m on a rigid body{other}; or choose another "
        "[analysis] curvature.",
    )
