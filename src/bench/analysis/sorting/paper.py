"""The paper's sorter: a greedy chain from the anchor, each frame by itself (section 3.2). Kept as the reference."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.analysis.arrays import Bools, Floats32, Indices, chunks, pad_points
from bench.analysis.sorting.free_chain import FREE_CHAIN_CHUNK, follow_from_every_point, is_symmetric, orient_alike
from bench.analysis.sorting.gates import SortSettings, make_gates
from bench.analysis.sorting.greedy import follow_chain
from bench.analysis.sorting.markers import MarkerReason, PointFrames, SortedMarkers, gather_positions

__all__ = ["sort_by_paper"]

AMBIGUOUS_CONFIDENCE = 0.5
"""Of two candidates in the gate, one is right."""


def sort_by_paper(frames: PointFrames, settings: SortSettings) -> SortedMarkers:
    """Sort by the paper's greedy chain (section 3.2), each frame by itself.

    Without an anchor each usable point is tried as marker 0; the longest chain wins, and of equally long ones the one
    whose spacings are nearest to the predefined ones. Which end is first is told by unequal spacings only: where they
    are the same from both ends, all frames get the direction of the first, and frames with a marker hidden stay
    unsorted, for nothing tells which one is.

    Parameters
    ----------
    frames : PointFrames
        An anchor of NaN leaves a frame unsorted.
    settings : SortSettings
        Arc lengths and gates.
    """
    gates, n_frames = make_gates(settings), len(frames)
    source = np.full((n_frames, settings.n_markers), -1, dtype=np.int16)
    ambiguous = np.zeros(source.shape, dtype=bool)
    anchored = frames.anchor_m is not None
    for start, stop in chunks(n_frames) if anchored else chunks(n_frames, FREE_CHAIN_CHUNK):
        rows = np.arange(start, stop)
        position, free = pad_points(frames.points_m, frames.offsets, frames.usable, rows)
        if frames.anchor_m is not None:
            found = follow_chain(position, free, frames.anchor_m[start:stop], gates)
        else:
            found = follow_from_every_point(position, free, gates)
        source[start:stop], ambiguous[start:stop] = found.slot, found.ambiguous
    if not anchored and is_symmetric(gates):
        source = orient_alike(source, gather_positions(frames.points_m, frames.offsets, source))
    return SortedMarkers.from_source(
        frames, source, _confidence(source, ambiguous), _reasons(frames, source, ambiguous), "paper"
    )


def _confidence(source: Indices, ambiguous: Bools) -> Floats32:
    sure = np.where(ambiguous, AMBIGUOUS_CONFIDENCE, 1.0)
    return np.where(source >= 0, sure, 0.0).astype(np.float32)


def _reasons(frames: PointFrames, source: Indices, ambiguous: Bools) -> npt.NDArray[np.uint8]:
    reason = np.where(ambiguous, MarkerReason.AMBIGUOUS, MarkerReason.FOUND)
    reason[source < 0] = MarkerReason.HIDDEN
    if frames.anchor_m is not None:
        reason[np.isnan(frames.anchor_m[:, 0])] = MarkerReason.NO_START
    return reason.astype(np.uint8)
