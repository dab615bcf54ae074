"""Sorting for motion that does not repeat: points are joined into tracks first, then each track is given its marker."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from bench.analysis.arrays import Bools, Floats, Floats32, Indices, Ints, chunks
from bench.analysis.sorting.chain import sort_by_chain
from bench.analysis.sorting.chain_prior import is_alike_from_both_ends
from bench.analysis.sorting.chain_spacing import SpacingCalibration, calibrate_spacing
from bench.analysis.sorting.gates import SortSettings
from bench.analysis.sorting.marker_motion import find_longest
from bench.analysis.sorting.markers import MarkerReason, PointFrames, SortedMarkers
from bench.analysis.sorting.point_tracks import LinkGates, leave_out_twins, link_tracks, measure_gates
from bench.analysis.sorting.track_labels import TrackLabels, label_by_votes
from bench.analysis.sorting.track_votes import choose_voting_rows, collect_votes, split_by_votes

__all__ = ["sort_by_track"]

STRETCH = 100_000
"""Frames that are sorted at once: tracks and motion of ten markers take 2 kB for each of them."""
AROUND_S = 10.0
"""Sorted with a stretch on both sides and left out again: twenty times the gaps that a marker's motion bridges."""


def sort_by_track(frames: PointFrames, settings: SortSettings) -> SortedMarkers:
    """Sort by tracks: time tells what a single frame does not.

    1. Points are linked from frame to frame into short tracks, whichever marker they are.
    2. The chain search sorts frames spread over all tracks; a long track gets the marker that most of its frames give
       it, and is cut where they change for good.
    3. How each marker moves, by itself and with the markers beside it, is learnt from these tracks. Where a marker is
       hidden, a bridge from its motion before and after tells where it must be and how well that is known; the tracks
       left over are weighed against it, by place and by distance to both neighbours, against the chance of a ghost
       there. Tracks that fit become the marker's, unless another one fits as well.
    4. Points that do not fit between those before and after them are taken away again, and so is what breaks the
       cable's spacing.

    Every gate is derived from time and from the recording's own motion and noise; none counts frames.

    Parameters
    ----------
    frames : PointFrames
        In any order of time.
    settings : SortSettings
        Arc lengths and gates, as the chain search takes them.

    Returns
    -------
    SortedMarkers
        `MarkerReason.FOUND` where the chain search named the track, ``FILLED`` where it is the marker's by its motion.
        The confidence of the former is the share of the votes. Notes and warnings are those of the chain search.
    """
    single = leave_out_twins(frames)
    if not single.usable.any():
        return replace(sort_by_chain(single, settings), method="track")
    order = np.argsort(frames.time_ns, kind="stable")
    gates = measure_gates(single, order)
    can_part = frames.anchor_m is not None or frames.end_m is not None or not is_alike_from_both_ends(settings)
    if not can_part or len(frames) <= STRETCH:
        return _in_order_of_frames(frames, order, [_sort_stretch(single.take(order), settings, gates)])
    known = calibrate_spacing(single, settings)
    return _in_order_of_frames(frames, order, _sort_stretches(single, order, settings, gates, known))


@dataclass(frozen=True, eq=False)
class _Sorted:
    """F frames in order of time."""

    source: Indices
    """(F, k)"""
    confidence: Floats32
    """(F, k)"""
    reason: npt.NDArray[np.uint8]
    """(F, k)"""
    notes: list[str]
    warnings: list[str]

    def take(self, rows: slice) -> _Sorted:
        return replace(
            self,
            source=self.source[rows].copy(),
            confidence=self.confidence[rows].copy(),
            reason=self.reason[rows].copy(),
        )


def _sort_stretches(
    frames: PointFrames, order: Ints, settings: SortSettings, gates: LinkGates, known: SpacingCalibration
) -> Iterator[_Sorted]:
    """Sort one stretch of a long recording after the other, each with what is around it, so that memory is bounded."""
    time_ns, margin_ns = frames.time_ns[order], round(AROUND_S * 1e9)
    for start, stop in chunks(len(order), STRETCH):
        low, high = np.searchsorted(time_ns, [time_ns[start] - margin_ns, time_ns[stop - 1] + margin_ns])
        stretch = _sort_stretch(frames.take(order[low:high]), settings, gates, known)
        yield stretch.take(slice(start - low, stop - low))


def _sort_stretch(
    frames: PointFrames, settings: SortSettings, gates: LinkGates, known: SpacingCalibration | None = None
) -> _Sorted:
    """Sort frames that are in order of time."""
    tracks = link_tracks(frames, gates)
    rows = choose_voting_rows(tracks)
    single_frames = sort_by_chain(frames.take(rows), settings, known)
    votes = collect_votes(tracks, rows, single_frames)
    labels = label_by_votes(split_by_votes(tracks, votes), votes, settings.n_markers)
    labels.complete(settings)
    return _list_markers(frames, labels, settings, single_frames)


def _in_order_of_frames(frames: PointFrames, order: Ints, stretches: Iterable[_Sorted]) -> SortedMarkers:
    """Return the markers in the order of the recording's frames."""
    parts = list(stretches)
    back = np.argsort(order)
    source, confidence, reason = (
        np.concatenate([getattr(part, name) for part in parts])[back] for name in ("source", "confidence", "reason")
    )
    told = parts[0].notes, parts[0].warnings  # of the whole recording
    return SortedMarkers.from_source(frames, source, confidence, reason, "track", *told)


def _list_markers(
    frames: PointFrames, labels: TrackLabels, settings: SortSettings, single_frames: SortedMarkers
) -> _Sorted:
    tracks, seen = labels.tracks, labels.places.source >= 0
    track = tracks.track[labels.places.source]
    confidence = np.where(seen, labels.confidence[track], 0.0).astype(np.float32)
    broken = labels.broken | _find_torn(labels, confidence.astype(np.float64) - labels.by_fit[track], settings)
    seen &= ~broken
    reason = np.full(seen.shape, MarkerReason.HIDDEN, dtype=np.uint8)
    reason[seen] = np.where(labels.by_fit[track], MarkerReason.FILLED, MarkerReason.FOUND)[seen]
    reason[~seen & broken] = MarkerReason.BROKEN
    reason[~seen & _find_refused(labels)] = MarkerReason.AMBIGUOUS
    if frames.anchor_m is not None:
        reason[:, ~seen.any(axis=0) & np.isnan(frames.anchor_m[:, 0])] = MarkerReason.NO_START
    source = np.where(seen, tracks.slot[labels.places.source], -1).astype(np.int16)
    confidence[~seen] = 0.0
    return _Sorted(source.T, confidence.T, reason.T, single_frames.notes, single_frames.warnings)


def _find_torn(labels: TrackLabels, sure: Floats, settings: SortSettings) -> Bools:
    """Return the markers (k, F) farther from a neighbour than the cable is long between them: the less sure of both."""
    place, longest_m = labels.places.place_m, find_longest(settings)
    torn = np.zeros(labels.places.source.shape, dtype=bool)
    for marker in range(1, len(place)):
        both = (labels.places.source[marker - 1 : marker + 1] >= 0).all(axis=0)
        distance = np.linalg.norm(place[marker] - place[marker - 1], axis=1)
        apart, is_first = both & (distance > longest_m[marker - 1]), sure[marker - 1] < sure[marker]
        torn[marker - 1] |= apart & is_first
        torn[marker] |= apart & ~is_first
    return torn


def _find_refused(labels: TrackLabels) -> Bools:
    """Return the hidden markers (k, F) that a track fits, but not it alone."""
    tracks = labels.tracks
    refused = np.zeros(labels.places.source.shape, dtype=bool)
    marker = labels.refused[tracks.track]
    points = np.flatnonzero(marker >= 0)
    refused[marker[points], tracks.row[points]] = True
    return refused
