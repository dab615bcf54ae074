"""Reflections: points that stand still in the lab while the cable moves. Screws and edges shine; no marker stays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, frame_of_points
from bench.analysis.sorting.anchors import STATIC_RADIUS_M, exclude_near
from bench.analysis.sorting.chain_prior import search
from bench.analysis.sorting.chain_spacing import SpacingCalibration, calibrate_spacing, spread_sample
from bench.analysis.sorting.gates import SortSettings
from bench.analysis.sorting.markers import PointFrames

__all__ = ["Reflections", "find_reflections"]

PRESENCE = 0.5
"""Part of the frames in which a reflection is seen; one that is hidden more often is rarely in the way."""
MOST_TAKEN = 0.1
"""Of a reflection's points, the part that the most probable chain may take for a marker: cables pass by."""
LEAST_MOTION_M = 5 * STATIC_RADIUS_M
"""Root mean square motion of the marker that moves most. While the cable rests, everything stands still."""
SCATTERS = 2.5
"""Root mean square distances from its place within which a reflection is: four standard deviations of a coordinate."""
LEAST_RADIUS_M = 5e-4
CELL_M = 2 * STATIC_RADIUS_M
CELLS_AT_A_CORNER = 8


@dataclass(frozen=True, eq=False)
class Reflections:
    """The reflections of a recording."""

    usable: Bools
    """(N,): the points that were usable, without them."""
    place_m: Floats
    """(n, 3): where they are, lab frame."""


def find_reflections(frames: PointFrames, settings: SortSettings) -> Reflections:
    """Find what stands still while the cable moves, and take it out of the points that may be the cable's.

    A place is a reflection's if a point is there in half of the frames of a sample spread over the recording, and if
    the chain search takes it for a marker in few of them: a marker at rest, or beside a clamp, stands still as well. In
    each frame the one point nearest to the place is taken out, if it is as near as the reflection's own scatter
    explains. So a marker that passes by stays, and one that passes through is missing for as long as it is there.

    Where the cable does not move, or the search finds nothing without doubt, there are none.
    """
    known, found, usable = calibrate_spacing(frames, settings), [], frames.usable
    if known.places is not None and _motion(known.prior.nodes_m[:, 1:-1]) >= LEAST_MOTION_M:
        for place_m, radius_m in _find_still_places(spread_sample(frames), known):
            usable = exclude_near(frames.points_m, frames.offsets, usable, place_m, radius_m)
            found.append(place_m)
    return Reflections(usable, np.array(found).reshape(-1, 3))


def _motion(marker_m: Floats) -> float:
    """Return the root mean square motion of the marker (F, k, 3) that moves most."""
    return float(np.sqrt(np.nanvar(marker_m, axis=0).sum(axis=1)).max())


def _find_still_places(sample: PointFrames, known: SpacingCalibration) -> list[tuple[Floats, float]]:
    """Return the places (3,) of reflections and how far from it each is seen."""
    looked = sample.usable & np.isfinite(sample.points_m).all(axis=1)
    points_m, frame = sample.points_m[looked].astype(np.float64), frame_of_points(sample.offsets)[looked]
    taken, found = _is_taken(sample, known)[looked], list[tuple[Floats, float]]()
    for seed in _crowded_places(points_m, len(sample)):
        place = np.median(points_m[np.linalg.norm(points_m - seed, axis=1) <= CELL_M], axis=0)
        apart = np.linalg.norm(points_m - place, axis=1)
        near = apart <= STATIC_RADIUS_M
        if len(np.unique(frame[near])) < PRESENCE * len(sample) or taken[near].mean() > MOST_TAKEN:
            continue
        if all(np.linalg.norm(place - other) > STATIC_RADIUS_M for other, _ in found):
            radius = SCATTERS * float(np.sqrt(np.mean(np.square(apart[near]))))
            found.append((place, min(max(radius, LEAST_RADIUS_M), STATIC_RADIUS_M)))
    return found


def _is_taken(sample: PointFrames, known: SpacingCalibration) -> Bools:
    """Return which points the most probable chains take for markers."""
    source, _ = search(sample, known.settings, known.prior)
    taken = np.zeros(len(sample.points_m), dtype=bool)
    row, marker = np.nonzero(source >= 0)
    taken[sample.offsets[row] + source[row, marker]] = True
    return taken


def _crowded_places(points_m: Floats, n_frames: int) -> Floats:
    """Return the middles (n, 3) of the cells that hold a point in many frames, the fullest first."""
    cell, count = np.unique(np.floor(points_m / CELL_M), axis=0, return_counts=True)
    crowded = cell[np.argsort(-count)[: np.count_nonzero(count >= PRESENCE / CELLS_AT_A_CORNER * n_frames)]]
    return np.asarray((crowded + 0.5) * CELL_M)
