"""The sorter for a robot's cycles: a marker is where it was at the same place of the path in the cycles before."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from bench.analysis.arrays import Bools, Floats32, Indices, Ints
from bench.analysis.chain import sort_by_chain
from bench.analysis.gates import SortSettings
from bench.analysis.markers import MarkerReason, PointFrames, SortedMarkers
from bench.analysis.phase_following import FollowedFrames, follow_frames
from bench.analysis.phase_learning import FEWEST_CYCLES, LEARNT_CYCLES, count_usable, learn_cycle, rows_in_cycles
from bench.analysis.phase_template import PhaseTemplate, lay_over_cycles, refresh_template

__all__ = ["sort_by_phase", "sort_by_template"]

BLOCK_CYCLES = 50
"""After so many the template is refreshed: a cable that settles by 30 mm in 1000 cycles has moved by 1.5 mm then."""
LOST_SHARE = 0.5
"""A frame in which less than this part of what is in sight is found is left to the chain search."""
CHANGED_SHARE = 0.3
"""Where more of a cycle's frames are lost, the cable is not what was learnt."""
CHECKED_FRAMES = 300
"""Which the chain search sorts as well, spread over the recording."""


def sort_by_phase(frames: PointFrames, settings: SortSettings) -> SortedMarkers:
    """Sort by the template of the robot's cycle, learnt from this recording's first good cycles.

    The chain search sorts up to ten cycles; the median of each marker over them, for each place of the path, is the
    template. In every frame each marker gets the point that is nearest to where the template and its own straying in
    the frames before put it, within gates that the scatter of the learnt cycles sets. Every 50 cycles the template
    follows what the cable has become since. Where most frames of five cycles fit it no longer, as after a slip in a
    clamp, it is learnt anew from these. Frames in which it finds too little, and those outside cycles, are sorted by
    the chain search.

    Without five whole cycles each frame is sorted by itself, and a note says so.
    """
    template = learn_cycle(frames, settings)
    if template is not None:
        return sort_by_template(frames, settings, template)
    chained = sort_by_chain(frames, settings)
    note = f"Fewer than {FEWEST_CYCLES} whole cycles could be sorted to learn from: each frame is sorted by itself."
    return replace(chained, notes=[note, *chained.notes])


def sort_by_template(frames: PointFrames, settings: SortSettings, template: PhaseTemplate) -> SortedMarkers:
    """Sort by a template of the cycle, as `sort_by_phase` does."""
    markers = _Markers.nothing(len(frames), settings.n_markers)
    inside = rows_in_cycles(frames)
    notes = [
        f"The template of the cycle was learnt from {template.n_cycles} cycles; a cycle strays from it by "
        f"{template.cycle_sigma_m * 1e3:.1f} mm (standard deviation of the worst marker in each coordinate)."
    ]
    for rows in _blocks(np.asarray(frames.cycle)[inside], inside):
        template = _sort_block(frames, rows, settings, template, markers, notes)
    notes += _compare_with_chain(frames, inside, settings, markers)
    notes += _sort_rest(frames, inside, settings, markers)
    return SortedMarkers.from_source(frames, markers.source, markers.confidence, markers.reason, "phase", notes)


@dataclass(frozen=True, eq=False)
class _Markers:
    """What is being written: all F frames."""

    source: Indices
    confidence: Floats32
    reason: npt.NDArray[np.uint8]

    @classmethod
    def nothing(cls, n_frames: int, k: int) -> _Markers:
        reason = np.full((n_frames, k), MarkerReason.NO_START, dtype=np.uint8)
        return cls(np.full((n_frames, k), -1, dtype=np.int16), np.zeros((n_frames, k), dtype=np.float32), reason)

    def put(self, rows: Ints, other: FollowedFrames) -> None:
        self.source[rows], self.confidence[rows], self.reason[rows] = other.source, other.confidence, other.reason


def _blocks(cycle: Ints, rows: Ints) -> list[Ints]:
    """Return the rows in stretches of `BLOCK_CYCLES` cycles; `cycle` is that of each row."""
    begin = np.flatnonzero(np.diff(cycle, prepend=cycle[:1] - 1))
    return [part for part in np.split(rows, begin[BLOCK_CYCLES::BLOCK_CYCLES]) if len(part)]


def _sort_block(
    frames: PointFrames,
    rows: Ints,
    settings: SortSettings,
    template: PhaseTemplate,
    markers: _Markers,
    notes: list[str],
) -> PhaseTemplate:
    """Sort the frames of a block and return the template for the next one."""
    followed = follow_frames(frames, rows, settings, template)
    markers.put(rows, followed)
    cycle = np.asarray(frames.cycle)
    changed = _changed_cycles(cycle[rows], _is_lost(frames, rows, followed.source))
    if len(changed) >= FEWEST_CYCLES:
        beyond = rows[np.isin(cycle[rows], changed)]
        newer = learn_cycle(frames.take(beyond), settings)
        if newer is not None:
            notes.append(f"The cable changed: its cycle was learnt anew at cycle {changed[0]}.")
            markers.put(beyond, follow_frames(frames, beyond, settings, newer))
            return newer
    latest = np.isin(cycle[rows], np.unique(cycle[rows])[-LEARNT_CYCLES:])
    return _refresh(frames.take(rows[latest]), followed.take(latest), template)


def _refresh(frames: PointFrames, followed: FollowedFrames, template: PhaseTemplate) -> PhaseTemplate:
    cycle, phase = np.asarray(frames.cycle), np.asarray(frames.phase)
    n_bins = len(template.position_m) - 1
    laid = lay_over_cycles(followed.sure_positions(frames), cycle, phase, np.unique(cycle).tolist(), n_bins)
    return refresh_template(template, laid)


def _is_lost(frames: PointFrames, rows: Ints, source: Indices) -> Bools:
    """Return (C,) where a template finds less than half of what is in sight."""
    in_sight = np.minimum(count_usable(frames.take(rows)), source.shape[1])
    return np.asarray((source >= 0).sum(axis=1) < LOST_SHARE * in_sight, dtype=bool)


def _changed_cycles(cycle: Ints, is_lost: Bools) -> Ints:
    cycles, row = np.unique(cycle, return_inverse=True)
    share = np.bincount(row, is_lost, len(cycles)) / np.bincount(row, minlength=len(cycles))
    return cycles[share > CHANGED_SHARE]


def _compare_with_chain(frames: PointFrames, inside: Ints, settings: SortSettings, markers: _Markers) -> list[str]:
    rows = inside[np.unique(np.linspace(0, len(inside) - 1, min(CHECKED_FRAMES, len(inside))).astype(np.int64))]
    chained, ours = sort_by_chain(frames.take(rows), settings).source, markers.source[rows]
    contradicts = ((chained >= 0) & (ours >= 0) & (chained != ours)).any(axis=1)
    return [f"The chain search, asked in {len(rows)} frames, contradicts in {contradicts.mean():.1%} of them."]


def _sort_rest(frames: PointFrames, inside: Ints, settings: SortSettings, markers: _Markers) -> list[str]:
    """Sort the frames outside cycles and those that the template does not fit, each by itself; return what to say."""
    outside = np.setdiff1d(np.arange(len(frames)), inside)
    lost = inside[_is_lost(frames, inside, markers.source[inside])]
    alone = np.union1d(outside, lost)
    if not len(alone):
        return []
    chained = sort_by_chain(frames.take(alone), settings)
    better = (chained.source >= 0).sum(axis=1) > (markers.source[alone] >= 0).sum(axis=1)
    better |= np.isin(alone, outside)
    rows = alone[better]
    markers.source[rows], markers.reason[rows] = chained.source[better], chained.reason[better]
    markers.confidence[rows] = chained.marker_confidence[better]
    notes = []
    if len(outside):
        notes.append(f"{len(outside)} frames outside any cycle are sorted each by itself.")
    if len(lost):
        notes.append(f"In {len(lost)} frames the template fits less than half of the markers: sorted each by itself.")
    return notes
