"""What no sorting may claim: a point for two markers, markers farther apart than the cable between them, and leaps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Indices, Ints
from bench.analysis.sorting.gates import SortSettings, SpacingGates, make_gates
from bench.analysis.sorting.markers import MarkerReason, PointFrames, SortedMarkers

__all__ = ["BrokenPairs", "find_leaps", "find_shared_points", "find_wrong_spacings", "take_broken_away", "tell_broken"]

NOISES = 6.0
"""Standard deviations of a distance's noise by which a gate may be missed."""
DOUBTFUL_SHARE = 0.05
"""Where two neighbours miss their gate in more of the frames, the gate is wrong and not the sorting."""
FEWEST_DOUBTS = 10
"""Frames; fewer are no habit."""
NO_LIMIT_M = 1e3
"""Of a gate that is not believed; finite, for gates are added up."""
ROUNDS = 3
"""Of taking away the marker that is to blame: with more than that wrong in a row a frame keeps what is left."""
LONGEST_STEP_S = 0.1
"""Over a longer time a marker may have gone anywhere."""
LEAP_SHARE = 0.6
"""Of the distance to the next marker, by which a marker cannot leave those beside it from one frame to the next. Labels
that are exchanged leap by all of it; a cable that whips at 1.5 m/s, seen at 33 Hz, bends by less than half of it."""
NOWHERE = -2
"""As the marker last found, before any was."""
COMPANIONS = 4
"""Markers beside it whose median step is the cable's own."""


@dataclass(frozen=True, eq=False)
class BrokenPairs:
    """Pairs of positions that cannot both be right: n of them, each a frame and a marker, twice."""

    first_frame: Ints
    first: Ints
    """Marker; -1 is the anchor."""
    second_frame: Ints
    second: Ints
    """Marker; k is the cable's other end."""

    def blame(self, sure: Floats32) -> Bools:
        """Return (F, k) who is to blame: who is in more of the pairs, else the less sure one, else both."""
        k = sure.shape[1]
        padded = np.pad(sure.astype(np.float64), ((0, 0), (0, 2)), constant_values=np.inf)  # columns k and -1
        count = np.zeros(padded.shape)
        for frame, marker in ((self.first_frame, self.first), (self.second_frame, self.second)):
            np.add.at(count, (frame, marker), 1)
        count[:, k:] = 0.0
        blamed = np.zeros(padded.shape, dtype=bool)
        a, b = (self.first_frame, self.first), (self.second_frame, self.second)
        more = np.sign(count[a] - count[b])
        more = np.where(more == 0, np.sign(padded[b] - padded[a]), more)
        blamed[self.first_frame[more >= 0], self.first[more >= 0]] = True
        blamed[self.second_frame[more <= 0], self.second[more <= 0]] = True
        return blamed[:, :k]


def take_broken_away(frames: PointFrames, markers: SortedMarkers, settings: SortSettings) -> SortedMarkers:
    """Return the markers without those that break an invariant; warnings count the frames.

    Of two markers at a wrong distance the one that is wrong towards another neighbour too is taken, of a leap the frame
    from which the marker leaps back; else the less sure one; both if nothing tells. Neighbours that miss their gate in
    more than 5 % of the frames are blamed on the configuration, and left.
    """
    wrong, warnings = _find_broken(frames, markers, settings)
    n_broken = int(wrong.any(axis=1).sum())
    if not n_broken:
        return replace(markers, warnings=[*markers.warnings, *warnings])
    return SortedMarkers.from_source(
        frames,
        np.where(wrong, -1, markers.source).astype(np.int16),
        np.where(wrong, np.float32(0.0), markers.marker_confidence),
        np.where(wrong, MarkerReason.BROKEN, markers.reason).astype(np.uint8),
        markers.method,
        markers.notes,
        [*markers.warnings, *warnings, f"{_count_broken(n_broken, len(frames))} and was taken away."],
    )


def tell_broken(frames: PointFrames, markers: SortedMarkers, settings: SortSettings) -> SortedMarkers:
    """Return the markers as they are, with warnings that count the frames in which one breaks an invariant."""
    wrong, warnings = _find_broken(frames, markers, settings)
    n_broken = int(wrong.any(axis=1).sum())
    if n_broken:
        told = f"{_count_broken(n_broken, len(frames))}: it is wrongly sorted. 'auto' takes such markers away."
        warnings.append(told)
    return replace(markers, warnings=[*markers.warnings, *warnings])


def _count_broken(n_broken: int, n_frames: int) -> str:
    return (
        f"In {n_broken} of {n_frames} frames a marker broke an invariant (its spacing, a leap, a point for two markers)"
    )


def _find_broken(frames: PointFrames, markers: SortedMarkers, settings: SortSettings) -> tuple[Bools, list[str]]:
    """Return the markers (F, k) to blame, and what to say of the configuration."""
    position, sure = markers.position_m.copy(), markers.marker_confidence
    leaping = find_leaps(frames, position, settings).blame(sure)
    wrong = find_shared_points(markers.source, sure) | leaping
    position[wrong] = np.nan
    gates = make_gates(settings)
    doubtful = _find_doubtful(frames, position, settings, gates)
    spacings = doubtful[doubtful < settings.n_markers]
    gates.low_m[spacings], gates.high_m[spacings] = 0.0, NO_LIMIT_M
    believed = replace(frames, end_m=None) if settings.n_markers in doubtful else frames
    for _ in range(ROUNDS):
        blamed = find_wrong_spacings(believed, position, settings, gates).blame(sure) & np.isfinite(position[..., 0])
        if not blamed.any():
            break
        wrong |= blamed
        position[blamed] = np.nan
    return wrong & (markers.source >= 0), [_blame_configuration(marker, settings) for marker in doubtful]


def find_shared_points(source: Indices, sure: Floats32) -> Bools:
    """Return (F, k) the markers whose point a surer one has as well."""
    order = np.argsort(-sure, axis=1, kind="stable")
    ranked = np.take_along_axis(source, order, axis=1)
    again = np.zeros(source.shape, dtype=bool)
    for rank in range(1, source.shape[1]):
        again[:, rank] = (ranked[:, rank] >= 0) & (ranked[:, :rank] == ranked[:, rank : rank + 1]).any(axis=1)
    shared = np.zeros_like(again)
    np.put_along_axis(shared, order, again, axis=1)
    return shared


def find_wrong_spacings(
    frames: PointFrames, position_m: Floats32, settings: SortSettings, gates: SpacingGates
) -> BrokenPairs:
    """Return the consecutively found markers (F, k, 3) whose distance is outside the gates.

    Between neighbours both gates hold, over hidden markers the upper ones together; the anchor is the first neighbour,
    the cable's other end, where both are known, the last.
    """
    k, slack = settings.n_markers, NOISES * np.sqrt(2.0) * settings.noise_m
    longest = np.concatenate([[0.0], np.cumsum(gates.high_m - settings.tolerance_m), [np.nan]])
    longest[-1] = longest[k] + (settings.length_m - settings.arc_length_m[-1]) * (1.0 + settings.stretch)
    shortest = np.append(gates.low_m, 0.0)
    last, place = _anchors(frames)
    pairs: list[tuple[Ints, Ints, Ints]] = []
    for marker in range(k + 1):
        here, doubt = _places_of(frames, position_m, marker)
        rows = np.flatnonzero(np.isfinite(here[:, 0]))
        judged = rows[last[rows] > NOWHERE]
        before = last[judged]
        distance = np.linalg.norm(here[judged] - place[judged], axis=1)
        most = longest[marker + 1] - longest[before + 1] + settings.tolerance_m + slack + NOISES * doubt[judged]
        broken = (distance > most) | ((before == marker - 1) & (distance < shortest[marker] - slack))
        pairs.append((judged[broken], before[broken], np.full(int(broken.sum()), marker)))
        last[rows], place[rows] = marker, here[rows]
    frame, first, second = (np.concatenate(part).astype(np.int64) for part in zip(*pairs, strict=True))
    return BrokenPairs(frame, first, frame, second)


def _anchors(frames: PointFrames) -> tuple[Ints, Floats]:
    """Return the marker (F,) last found, -1 where the anchor is known, and its place (F, 3)."""
    last, place = np.full(len(frames), NOWHERE), np.full((len(frames), 3), np.nan)
    if frames.anchor_m is not None:
        known = np.isfinite(frames.anchor_m).all(axis=1)
        last[known], place[known] = -1, frames.anchor_m[known]
    return last, place


def _places_of(frames: PointFrames, position_m: Floats32, marker: int) -> tuple[Floats, Floats]:
    """Return (F, 3) where a marker is, NaN where it is not found, and (F,) its standard deviation beyond noise."""
    n_frames, k = position_m.shape[:2]
    if marker < k:
        return position_m[:, marker].astype(np.float64), np.zeros(n_frames)
    if frames.end_m is None:
        return np.full((n_frames, 3), np.nan), np.zeros(n_frames)
    sigma = np.zeros(n_frames) if frames.end_sigma_m is None else np.nan_to_num(frames.end_sigma_m)
    return frames.end_m, sigma


def find_leaps(frames: PointFrames, position_m: Floats32, settings: SortSettings) -> BrokenPairs:
    """Return the steps from one frame to the next in which a marker (F, k, 3) leaves those beside it.

    Only where another marker was found in both frames; over at most 0.1 s.
    """
    order = np.argsort(frames.time_ns, kind="stable")
    time_s = (frames.time_ns[order] - frames.time_ns.min(initial=0)) * 1e-9
    spacing = np.diff(settings.arc_length_m, prepend=0.0)
    if frames.anchor_m is None or spacing[0] == 0.0:  # no anchor with which the first marker could be exchanged
        spacing[0] = np.inf
    nearest = np.minimum(spacing, np.append(spacing[1:], np.inf))
    pairs: list[tuple[Ints, Ints, Ints]] = []
    for marker in range(settings.n_markers):
        found = np.flatnonzero(np.isfinite(position_m[order, marker, 0]))
        before, after = found[:-1], found[1:]
        step = np.linalg.norm(position_m[order[after], marker] - position_m[order[before], marker], axis=1)
        far = (step > LEAP_SHARE * nearest[marker]) & (time_s[after] - time_s[before] <= LONGEST_STEP_S)
        before, after = order[before[far]], order[after[far]]
        leaves = _way_from_others(position_m[before], position_m[after], marker) > LEAP_SHARE * nearest[marker]
        pairs.append((before[leaves], after[leaves], np.full(int(leaves.sum()), marker)))
    before, after, which = (np.concatenate(part).astype(np.int64) for part in zip(*pairs, strict=True))
    return BrokenPairs(before, which, after, which)


def _way_from_others(before_m: Floats32, after_m: Floats32, marker: int) -> Floats:
    """Return (n,) how far a marker's step is from the median step of the nearest others, NaN where there are none."""
    away = np.abs(np.arange(before_m.shape[1]) - marker)
    beside = np.argsort(away, kind="stable")[1 : COMPANIONS + 1]
    step = after_m.astype(np.float64) - before_m
    ordered = np.sort(step[:, beside], axis=1)
    n_known = np.isfinite(ordered[..., 0]).sum(axis=1)
    middle = np.maximum(n_known - 1, 0)[:, None, None] // 2
    usual = np.take_along_axis(ordered, np.broadcast_to(middle, (len(step), 1, 3)), axis=1)[:, 0]
    return np.asarray(np.linalg.norm(step[:, marker] - usual, axis=1))


def _find_doubtful(frames: PointFrames, position_m: Floats32, settings: SortSettings, gates: SpacingGates) -> Ints:
    """Return the markers that miss their gate from the one before in more than a twentieth of the frames; k is the end.

    The end's gate is judged from whichever marker is found last.
    """
    k = settings.n_markers
    pairs = find_wrong_spacings(frames, position_m, settings, gates)
    counted = (pairs.second - pairs.first == 1) | (pairs.second == k)
    n_wrong = np.bincount(pairs.second[counted], minlength=k + 1)
    n_found = np.append(np.isfinite(position_m[..., 0]).sum(axis=0), len(frames))
    return np.flatnonzero(n_wrong > np.maximum(DOUBTFUL_SHARE * n_found, FEWEST_DOUBTS))


def _blame_configuration(marker: int, settings: SortSettings) -> str:
    often = f"in more than {DOUBTFUL_SHARE:.0%} of the frames"
    if marker == settings.n_markers:
        return (
            f"The cable's other end is farther from its last marker than the cable is long, {often}: check its place."
        )
    spacing_mm = 1e3 * np.diff(settings.arc_length_m, prepend=0.0)[marker]
    before = f"marker {marker - 1}" if marker else "the anchor"
    return (
        f"The distance from {before} to marker {marker} is not {spacing_mm:.0f} mm, as configured, {often}: check "
        "marker_arc_length_m."
    )
