"""Which point of a frame is which marker of the cable. A sorter is a function, chosen by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Indices, Ints, chunks, pad_points
from bench.analysis.chain import follow_chain
from bench.analysis.free_chain import FREE_CHAIN_CHUNK, follow_from_every_point, is_symmetric, orient_alike
from bench.analysis.gates import SortSettings, make_gates
from bench.errors import AnalysisError

__all__ = ["SORTERS", "SortedMarkers", "Sorter", "gather_positions", "get_sorter", "sort_by_chain"]

AMBIGUITY_COST = 0.5
"""An ambiguous step counts as half a marker: of two candidates in the gate, one is right."""
MOST_POINTS = np.iinfo(np.int16).max


@dataclass(frozen=True, eq=False)
class SortedMarkers:
    """The cable's k markers in each of F frames, counted from the anchor."""

    source: Indices
    """(F, k): index of the marker's point in the frame's list, -1 where it was not found."""
    position_m: Floats32
    """(F, k, 3): lab frame, NaN where not found."""
    confidence: Floats32
    """(F,): fraction of markers found, each ambiguous step counting half a marker less; 0…1."""


class Sorter(Protocol):
    """Gives every marker of every frame its point."""

    def __call__(
        self, points_m: Floats32, offsets: Ints, usable: Bools, anchor_m: Floats | None, settings: SortSettings
    ) -> SortedMarkers:
        """Sort the points (N, 3) of F frames; `anchor_m` (F, 3) is NaN where unknown, None for a cable without one."""
        ...


def sort_by_chain(
    points_m: Floats32, offsets: Ints, usable: Bools, anchor_m: Floats | None, settings: SortSettings
) -> SortedMarkers:
    """Sort by the paper's greedy chain (section 3.2), each frame by itself.

    Without an anchor each usable point is tried as marker 0; the longest chain wins, and of equally long ones the one
    whose spacings are nearest to the predefined ones. Which end is first is told by unequal spacings only: where they
    are the same from both ends, all frames get the direction of the first, and frames with a marker hidden stay
    unsorted, for nothing tells which one is.

    Parameters
    ----------
    points_m : (N, 3)
        Points of all frames, lab frame.
    offsets : (F + 1,)
        Where each frame's points begin.
    usable : (N,)
        Points that may be the cable's: not those of rigid bodies or static markers.
    anchor_m : (F, 3) or None
        Start of the chain; NaN leaves a frame unsorted.
    settings : SortSettings
        Arc lengths and gates.

    Raises
    ------
    AnalysisError
        A frame has more points than an index can name (32 767).
    """
    counts = np.diff(offsets)
    if counts.max(initial=0) > MOST_POINTS:
        raise AnalysisError(f"A frame has {counts.max()} points; at most {MOST_POINTS} can be sorted.")
    gates, n_frames = make_gates(settings), len(counts)
    source = np.full((n_frames, settings.n_markers), -1, dtype=np.int16)
    confidence = np.zeros(n_frames, dtype=np.float32)
    for start, stop in chunks(n_frames) if anchor_m is not None else chunks(n_frames, FREE_CHAIN_CHUNK):
        position, free = pad_points(points_m, offsets, usable, np.arange(start, stop))
        if anchor_m is not None:
            found = follow_chain(position, free, anchor_m[start:stop], gates)
        else:
            found = follow_from_every_point(position, free, gates)
        source[start:stop] = found.slot
        confidence[start:stop] = (found.n_found - AMBIGUITY_COST * found.n_ambiguous) / settings.n_markers
    if anchor_m is None and is_symmetric(gates):
        source = orient_alike(source, gather_positions(points_m, offsets, source))
        confidence[(source < 0).all(axis=1)] = 0.0
    return SortedMarkers(source, gather_positions(points_m, offsets, source), np.maximum(confidence, 0.0))


def gather_positions(points_m: Floats32, offsets: Ints, source: Indices) -> Floats32:
    """Return the positions (F, k, 3) of the points that `source` (F, k) names, NaN where it is -1."""
    position = np.full((*source.shape, 3), np.nan, dtype=np.float32)
    found = source >= 0
    position[found] = points_m[(offsets[:-1, None] + source)[found]]
    return position


SORTERS: Mapping[str, Sorter] = MappingProxyType({"paper": sort_by_chain})
"""Sorters by the names of `[analysis] sorting`."""
RECOMMENDED = "paper"


def get_sorter(name: str) -> tuple[str, Sorter]:
    """Return the sorter of that name and its own name; 'auto' is the recommended one.

    Raises
    ------
    AnalysisError
        There is no sorter of that name.
    """
    chosen = RECOMMENDED if name == "auto" else name
    if chosen not in SORTERS:
        raise AnalysisError(f"There is no sorting method '{name}'.", hint=f"Choose one of: auto, {', '.join(SORTERS)}.")
    return chosen, SORTERS[chosen]
