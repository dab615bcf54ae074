"""How far each cycle's shape has gone along the line on which the cable changes, to either side of the first cycles."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, median_of_rows
from bench.analysis.cycles.drift_shape import CycleShapes, ShapeDistances

__all__ = ["measure_along_change"]

LEAST_ALONG = 0.8
"""Of the mean square distance, each cycle's in what is expected of it, that must lie along one line: of a change in
another direction after the first one, a position on the first one's line would not tell."""
LEAST_ALIKE = 0.5
"""Cosine of the angle between the directions of both halves: of cycles that go 18 ways at random, one run in 60 has."""
LEAST_SEEN = 0.5
"""Of the squared change, that must have been seen of a cycle: where the cable hardly changes nothing is to be read."""
FEWEST_BESIDE = 5
"""Reference cycles, to know what cycles differ by beside the line."""
DOUBT_SIGMAS = 3.0
"""Of that: so much more may be no part of the change."""
OUTLIER_RATIO = 2.0
"""A cycle farther from the reference than so many times what is usual then pulls the direction no more than that."""


def measure_along_change(
    shapes: CycleShapes, reference: Bools, distances: ShapeDistances, expected_m: Floats
) -> Floats | None:
    """Measure where each cycle lies on the line along which the cable changes.

    A distance has no sign: of a cable that wears evenly, those of the first reference cycles fall towards the middle of
    the reference and rise after it, and a line through all of them is too flat. A position on a line has no such fold.

    The line's direction comes from the cycles themselves, and would follow their noise. So that of every second cycle
    is what the others are held against, and the other way round; noise is no part of what both directions share.

    Parameters
    ----------
    shapes : CycleShapes
    reference : (C,)
        The cycles whose median is zero on the line.
    distances : ShapeDistances
        Of the same cycles.
    expected_m : (C,)
        What was found in `distances.watched_m`: level, steps and trend, NaN where unknown.

    Returns
    -------
    (C,) or None
        Root mean square over bins and markers, as the distances; most of it positive; NaN where too little was seen.
        None where both halves of the cycles share no direction, or much of the change is not along it.
    """
    rows = np.flatnonzero(np.isfinite(distances.watched_m) & np.isfinite(expected_m))
    away = shapes.offset_m[rows] - _median(shapes.offset_m[reference])
    seen = np.asarray(np.isfinite(away).all(axis=3))
    away[~seen] = 0.0
    watched = distances.watched_m[rows]
    expected = np.maximum(expected_m[rows], max(distances.usual_m, np.finfo(np.float64).tiny))
    held = np.minimum(1.0, OUTLIER_RATIO * expected / np.maximum(watched, np.finfo(np.float64).tiny))
    halves = [slice(0, None, 2), slice(1, None, 2)]
    first, second = (_find_direction(away[half], seen[half], expected[half], held[half]) for half in halves)
    common = (first * second).sum(axis=2)
    if not common.sum() > LEAST_ALIKE * np.linalg.norm(first) * np.linalg.norm(second):
        return None
    along = np.full(len(reference), np.nan)
    for half, other in zip(halves, (second, first), strict=True):
        along[rows[half]] = _project(away[half], seen[half], other, common)
    weight = np.full(len(reference), np.nan)
    weight[rows] = np.square(held / expected)
    if not _is_most_along(along, weight, reference, distances):
        return None
    return along if np.nansum(along) >= 0 else -along


def _is_most_along(along_m: Floats, weight: Floats, reference: Bools, distances: ShapeDistances) -> bool:
    """Return whether the weighted squared distances lie along the line, but for what those of the reference do not."""
    known, square = np.isfinite(along_m), np.square(distances.watched_m)
    beside = (square - along_m**2)[reference & known]
    if len(beside) < FEWEST_BESIDE:
        return False
    most_m2 = np.median(beside) + DOUBT_SIGMAS * beside.std(ddof=1) * np.sqrt(np.pi / 2 / len(beside))
    total = (weight * (square - most_m2))[known].sum()
    return bool((weight * along_m**2)[known].sum() >= LEAST_ALONG * total)


def _median(offset_m: Floats32) -> Floats:
    return median_of_rows(offset_m.reshape(len(offset_m), -1)).reshape(offset_m.shape[1:])


def _find_direction(away_m: Floats, seen: Bools, expected_m: Floats, held: Floats) -> Floats:
    """Return (P, k, 3): by how much each marker moves in each bin for each metre of the expected distance."""
    weight = expected_m - expected_m.mean()
    moved = np.einsum("c,cpkx->pkx", weight * held, away_m)
    known = np.einsum("c,cpk->pk", np.square(weight), seen)
    return np.asarray(moved / np.where(known > 0, known, np.inf)[..., None])


def _project(away_m: Floats, seen: Bools, direction: Floats, common: Floats) -> Floats:
    """Return (C,): the position on the line, of what was seen of each cycle."""
    part = np.einsum("cpk,pk->c", seen, common)
    enough = part >= LEAST_SEEN * common.sum()
    position = np.einsum("cpkx,pkx->c", away_m, direction) * np.sqrt(common.mean())
    return np.asarray(np.where(enough, position / np.where(enough, part, 1.0), np.nan))
