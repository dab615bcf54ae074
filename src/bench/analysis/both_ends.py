"""The paper's chain from the cable's other end, for the markers that the chain from the anchor did not reach."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.analysis.arrays import chunks, pad_points
from bench.analysis.gates import SortSettings, make_gates
from bench.analysis.greedy import follow_chain
from bench.analysis.markers import MarkerReason, PointFrames, SortedMarkers
from bench.analysis.paper import AMBIGUOUS_CONFIDENCE

__all__ = ["fill_from_end"]


def fill_from_end(frames: PointFrames, markers: SortedMarkers, settings: SortSettings) -> SortedMarkers:
    """Continue chains that ended at a hidden marker, from the cable's other end towards it.

    The end of the cable is a second anchor: the same chain starts there, over the points that are still free, and gives
    markers that are not found yet theirs. So one hidden marker costs one marker, not all beyond it.

    Parameters
    ----------
    frames : PointFrames
        An end of NaN leaves a frame as it is; without any known end all are returned as they are.
    markers : SortedMarkers
        As sorted from the anchor.
    settings : SortSettings
        The cable, with the arc length of its other end.
    """
    if frames.end_m is None:
        return markers
    end_m = frames.end_m
    backward = replace(settings, arc_length_m=tuple(settings.length_m - s for s in reversed(settings.arc_length_m)))
    gates, source = make_gates(backward), markers.source.copy()
    confidence, reason = markers.marker_confidence.copy(), markers.reason.copy()
    waiting = np.flatnonzero((source < 0).any(axis=1) & np.isfinite(end_m).all(axis=1))
    for start, stop in chunks(len(waiting)):
        rows = waiting[start:stop]
        position, free = pad_points(frames.points_m, frames.offsets, frames.usable, rows)
        row, marker = np.nonzero(source[rows] >= 0)
        free[row, source[rows][row, marker]] = False
        found = follow_chain(position, free, end_m[rows], gates)
        slot, ambiguous = found.slot[:, ::-1], found.ambiguous[:, ::-1]
        new = (source[rows] < 0) & (slot >= 0)
        source[rows] = np.where(new, slot, source[rows])
        confidence[rows] = np.where(new, np.where(ambiguous, AMBIGUOUS_CONFIDENCE, 1.0), confidence[rows])
        reason[rows] = np.where(new, np.where(ambiguous, MarkerReason.AMBIGUOUS, MarkerReason.FOUND), reason[rows])
    return SortedMarkers.from_source(frames, source, confidence, reason, f"{markers.method}, from both ends")
