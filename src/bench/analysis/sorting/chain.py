"""Each frame by itself, at its best: the most probable chain of points, with hidden markers and ghosts among them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from bench.analysis.arrays import Floats32, Indices
from bench.analysis.sorting.chain_costs import ChainPrior
from bench.analysis.sorting.chain_prior import (
    DOUBT_NATS,
    FEWEST_FREE_MARKERS,
    is_alike_from_both_ends,
    known_places,
    search,
)
from bench.analysis.sorting.chain_spacing import SpacingCalibration, calibrate_spacing
from bench.analysis.sorting.free_chain import orient_alike
from bench.analysis.sorting.gates import SortSettings
from bench.analysis.sorting.markers import MarkerReason, PointFrames, SortedMarkers, gather_positions
from bench.analysis.sorting.paper import sort_by_paper
from bench.errors import TooFewMarkersError

__all__ = ["sort_by_chain"]

GREEDY_NOTE = (
    "Nothing tells where the cable starts, and its spacings are the same from both ends, so nothing could be learnt of "
    "how it bends: the paper's chain finds more whole cables than the most probable chain."
)


def sort_by_chain(
    frames: PointFrames, settings: SortSettings, known: SpacingCalibration | None = None
) -> SortedMarkers:
    """Sort by the most probable chain of points, each frame by itself.

    Every chain of points within the cable's reach is weighed by its distances, its turning angles, its hidden markers
    (up to three in a row) and, where it is known, the cable's other end; the search over pairs of points finds the best
    of them (maximum a posteriori, a second-order Viterbi search) and for each marker the best chain in which that one
    marker has another point or none. The difference tells how sure the marker is.

    The markers' places and which bends are usual at each marker are learnt from a sample of the frames
    (`calibrate_spacing`). A frame whose anchor is unknown starts at any point, unless the cable looks the same from
    both ends and its other end is unknown too. A cable of this kind without any anchor is sorted as `sort_by_paper`
    does: all frames get the direction of the first.

    Parameters
    ----------
    frames : PointFrames
    settings : SortSettings
        As configured.
    known : SpacingCalibration, optional
        What `calibrate_spacing` learnt of this cable, for some of the frames that it was learnt from.

    Raises
    ------
    TooFewMarkersError
        Without an anchor two markers make no chain.
    """
    if frames.anchor_m is None and settings.n_markers < FEWEST_FREE_MARKERS:
        raise TooFewMarkersError(
            f"The cable has {settings.n_markers} markers: without an anchor, at least {FEWEST_FREE_MARKERS} are needed "
            "to tell their order.",
            hint="Give the cable an anchor ([cable.anchor]) or more markers.",
        )
    measured = known or calibrate_spacing(frames, settings)
    settings, prior = measured.settings, measured.prior
    if frames.anchor_m is None and frames.end_m is None and is_alike_from_both_ends(settings):
        source, margin = _sort_with_one_direction(frames, settings, prior)
        greedy = sort_by_paper(frames, settings)
        if _count_whole(greedy.source) > _count_whole(source):
            return replace(greedy, notes=[GREEDY_NOTE])
    else:
        source, margin = search(frames, settings, prior)
    confidence, reason = _confidence(source, margin), _reasons(frames, source, margin)
    return SortedMarkers.from_source(frames, source, confidence, reason, "chain", warnings=measured.warnings)


def _sort_with_one_direction(
    frames: PointFrames, settings: SortSettings, prior: ChainPrior
) -> tuple[Indices, Floats32]:
    """Search chains from any point, then again from the points that are marker 0 once all have one direction."""
    source, _ = search(frames, settings, prior, starts_anywhere=True)
    position = gather_positions(frames.points_m, frames.offsets, source)
    first = orient_alike(source, position)[:, 0]
    started = np.flatnonzero(first >= 0)
    usable = frames.usable.copy()
    usable[frames.offsets[started] + first[started]] = False
    anchor = gather_positions(frames.points_m, frames.offsets, first[:, None])[:, 0].astype(np.float64)
    place = np.array(settings.arc_length_m[1:]) - settings.arc_length_m[0]
    beyond = replace(settings, arc_length_m=tuple(place.tolist()))
    onwards = replace(prior, curvature_per_m=prior.curvature_per_m[1:], nodes_m=prior.nodes_m[:, 1:])
    later, margin = search(replace(frames, usable=usable, anchor_m=anchor), beyond, onwards)
    return np.concatenate([first[:, None], later], axis=1), np.concatenate([margin[:, :1], margin], axis=1)


def _count_whole(source: Indices) -> int:
    return int((source >= 0).all(axis=1).sum())


def _confidence(source: Indices, margin: Floats32) -> Floats32:
    return np.where(source >= 0, 1.0 / (1.0 + np.exp(-margin)), 0.0).astype(np.float32)


def _reasons(frames: PointFrames, source: Indices, margin: Floats32) -> npt.NDArray[np.uint8]:
    reason = np.where(source >= 0, MarkerReason.FOUND, MarkerReason.HIDDEN)
    reason[margin < DOUBT_NATS] = MarkerReason.AMBIGUOUS
    unstarted = (source < 0).all(axis=1) & ~np.isfinite(known_places(frames.anchor_m, len(frames))).all(axis=1)
    reason[unstarted] = MarkerReason.NO_START
    return reason.astype(np.uint8)
