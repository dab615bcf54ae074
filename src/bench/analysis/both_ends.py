"""The paper's chain from the cable's other end, for the markers that the chain from the anchor did not reach."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Ints, chunks, pad_points
from bench.analysis.chain import follow_chain
from bench.analysis.gates import SortSettings, make_gates
from bench.analysis.sorting import AMBIGUITY_COST, SortedMarkers, gather_positions

__all__ = ["fill_from_end"]


def fill_from_end(
    points_m: Floats32,
    offsets: Ints,
    usable: Bools,
    markers: SortedMarkers,
    end_m: Floats,
    end_arc_length_m: float,
    settings: SortSettings,
) -> SortedMarkers:
    """Continue chains that ended at a hidden marker, from the cable's other end towards it.

    The end of the cable is a second anchor: the same chain starts there, over the points that are still free, and gives
    markers that are not found yet theirs. So one hidden marker costs one marker, not all beyond it.

    Parameters
    ----------
    points_m, offsets, usable
        The point lists of F frames, and which points may be the cable's.
    markers : SortedMarkers
        As sorted from the anchor.
    end_m : (F, 3)
        The cable's end, lab frame; NaN leaves a frame as it is.
    end_arc_length_m : float
        Its arc length from the anchor: beyond the last marker.
    settings : SortSettings
        The cable.
    """
    backward = replace(settings, arc_length_m=tuple(end_arc_length_m - s for s in reversed(settings.arc_length_m)))
    gates, source, confidence = make_gates(backward), markers.source.copy(), markers.confidence.copy()
    waiting = np.flatnonzero((source < 0).any(axis=1) & np.isfinite(end_m).all(axis=1))
    for start, stop in chunks(len(waiting)):
        frames = waiting[start:stop]
        position, free = pad_points(points_m, offsets, usable, frames)
        row, marker = np.nonzero(source[frames] >= 0)
        free[row, source[frames][row, marker]] = False
        found = follow_chain(position, free, end_m[frames], gates)
        slot = found.slot[:, ::-1]
        new = (source[frames] < 0) & (slot >= 0)
        source[frames] = np.where(new, slot, source[frames])
        gained = new.sum(axis=1) - AMBIGUITY_COST * np.minimum(found.n_ambiguous, new.sum(axis=1))
        confidence[frames] += (gained / settings.n_markers).astype(np.float32)
    return SortedMarkers(source, gather_positions(points_m, offsets, source), confidence)
