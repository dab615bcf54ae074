"""The static marker: a point that never moves, from which the cable starts (the paper's first case)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Ints, frame_of_points, pad_points
from bench.analysis.sorting.gates import SortSettings, SpacingGates, make_gates
from bench.analysis.sorting.greedy import follow_chain
from bench.errors import AnalysisError

__all__ = ["StaticMarker", "exclude_near", "find_static_marker", "locate_static_marker", "spread_frames"]

STATIC_RADIUS_M = 0.003
"""A static marker stays within this of its median: four standard deviations of the largest noise measured, 0.74 mm."""
STATIC_PRESENCE = 0.8
"""Part of the frames in which it must be seen: markers are hidden in 5 to 10 % of frames, in bursts."""
SCANNED_FRAMES = 60
"""Frames looked at. The paper scans 10 lines; 60 spread over a motion also tell still markers from moving ones."""
SEED_FRAMES = 8
"""Frames whose points are tried as static: hidden in all 8 has a chance below 1e-6."""
SEARCH_RADIUS_M = 0.02
"""How far a configured position may be off: it is measured by hand."""


@dataclass(frozen=True, eq=False)
class StaticMarker:
    """A point that does not move."""

    position_m: Floats
    """(3,): median position, lab frame."""
    presence: float
    """Part of the scanned frames in which it was seen."""
    chain_fraction: float = float("nan")
    """Part of the cable's markers that the chain from it finds, mean of the scanned frames."""


def spread_frames(first: int, last: int, n_wanted: int = SCANNED_FRAMES) -> Ints:
    """Return up to `n_wanted` frame indices spread evenly over [first, last)."""
    return np.unique(np.linspace(first, max(first, last - 1), n_wanted).astype(np.int64)) if last > first else _NONE


_NONE = np.zeros(0, dtype=np.int64)


def find_static_marker(
    points_m: Floats32, offsets: Ints, usable: Bools, frames: Ints, settings: SortSettings
) -> StaticMarker:
    """Find the static marker at the cable's start.

    Candidates are the points seen, and unmoved, in nearly all of the scanned frames. While the robot rests
    everything is unmoved, and a reflection never moves at all: so the candidate is taken from which the chain finds
    most of the cable, and of equally good ones the one whose spacings fit best.

    Parameters
    ----------
    points_m, offsets, usable
        The point lists of all frames, and which points may be the marker.
    frames : (C,)
        Indices of the frames to scan, spread over a motion.
    settings : SortSettings
        The cable.

    Raises
    ------
    AnalysisError
        Nothing stands still, or no chain starts at what does.
    """
    position, free = pad_points(points_m, offsets, usable, frames)
    gates, best, best_rank = make_gates(settings), None, (0.0, 0.0)
    for candidate in _static_points(position, free):
        fraction, misfit = _chain_from(position, free, candidate.position_m, gates)
        if fraction > 0 and (fraction, -misfit) > best_rank:
            best, best_rank = StaticMarker(candidate.position_m, candidate.presence, fraction), (fraction, -misfit)
    if best is None:
        raise AnalysisError(
            f"No static marker was found: in {len(frames)} frames no point stands still within "
            f"{STATIC_RADIUS_M * 1e3:g} mm with a marker of the cable at "
            f"{settings.arc_length_m[0] * 1e3:g} mm from it.",
            hint="Give its place as [cable.anchor] position_m, check marker_arc_length_m, or use kind = 'none'.",
        )
    return best


def locate_static_marker(
    points_m: Floats32, offsets: Ints, usable: Bools, frames: Ints, position_m: Floats
) -> StaticMarker:
    """Refine a configured position: the median of the nearest points within 20 mm, where half of the frames have one.

    Otherwise the configured position stays as it is, with the presence that was found.
    """
    position, free = pad_points(points_m, offsets, usable, frames)
    place, presence = _median_near(position, free, position_m, SEARCH_RADIUS_M)
    return StaticMarker(place if presence >= 0.5 else np.asarray(position_m, dtype=np.float64), presence)


def exclude_near(
    points_m: Floats32, offsets: Ints, usable: Bools, position_m: Floats, radius_m: float = STATIC_RADIUS_M
) -> Bools:
    """Return `usable` without the points that are a known marker itself: the nearest one of each frame, if near.

    `position_m` is (3,) for a static marker, (F, 3) for one that moves, NaN where its place is not known.
    """
    kept, place = usable.copy(), position_m if position_m.ndim == 1 else position_m[frame_of_points(offsets)]
    apart = np.linalg.norm(points_m - place, axis=1)
    near = np.flatnonzero(usable & (apart <= radius_m))
    near = near[np.argsort(apart[near], kind="stable")]
    _, nearest = np.unique(np.searchsorted(offsets, near, side="right"), return_index=True)
    kept[near[nearest]] = False
    return kept


def _distance(position: Floats, free: Bools, place_m: Floats) -> Floats:
    return np.where(free, np.linalg.norm(position - place_m, axis=2), np.inf)


def _median_near(position: Floats, free: Bools, place_m: Floats, radius_m: float) -> tuple[Floats, float]:
    """Return the median of each row's nearest point within the radius, and the part of rows that have one."""
    distance = _distance(position, free, place_m)
    seen = distance.min(axis=1, initial=np.inf) <= radius_m
    if not seen.any():
        return np.full(3, np.nan), 0.0
    nearest = position[np.arange(len(position)), distance.argmin(axis=1)]
    return np.median(nearest[seen], axis=0), float(seen.mean())


def _static_points(position: Floats, free: Bools) -> list[StaticMarker]:
    seeds = position[:: max(1, len(position) // SEED_FRAMES)]
    known: list[StaticMarker] = []
    for seed in seeds[free[:: max(1, len(position) // SEED_FRAMES)]]:
        if any(np.linalg.norm(seed - other.position_m) < 2 * STATIC_RADIUS_M for other in known):
            continue
        place, presence = _median_near(position, free, seed, 2 * STATIC_RADIUS_M)
        _, presence = _median_near(position, free, place, STATIC_RADIUS_M)
        if presence >= STATIC_PRESENCE:
            known.append(StaticMarker(place, presence))
    return known


def _chain_from(position: Floats, free: Bools, place_m: Floats, gates: SpacingGates) -> tuple[float, float]:
    """Return the mean part of the cable that a chain from `place_m` finds, and its mean spacing error."""
    others = free & ~(np.linalg.norm(position - place_m, axis=2) <= STATIC_RADIUS_M)
    chains = follow_chain(position, others, np.broadcast_to(place_m, (len(position), 3)), gates)
    found = int(chains.n_found.sum())
    return found / (len(position) * len(gates.nominal_m)), float(chains.spacing_error.sum()) / max(found, 1)
