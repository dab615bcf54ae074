"""The sorter for a robot's cycles: a marker is where it was at the same place of the path in the cycles before."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.arrays import Bools, Ints
from bench.analysis.sorting.chain import sort_by_chain
from bench.analysis.sorting.gates import SortSettings
from bench.analysis.sorting.markers import MarkerReason, PointFrames, SortedMarkers
from bench.analysis.sorting.phase_following import FollowedFrames, follow_frames, measure_movement
from bench.analysis.sorting.phase_learning import (
    FEWEST_CYCLES,
    LEARNT_CYCLES,
    count_usable,
    learn_cycle,
    rows_in_cycles,
)
from bench.analysis.sorting.phase_template import FEWEST_SHOWING, PhaseTemplate, lay_over_cycles, refresh_template

__all__ = ["sort_by_phase", "sort_by_template"]

BLOCK_CYCLES = 25
"""After so many, at the latest, the template is refreshed: a cable that settles by 100 mm in 1000 cycles has moved by
2.5 mm then."""
MOVED_SHARE = 0.5
"""Of a marker's gate, by which its places in a block's last cycles are off the template (root mean square along the
path): then the block is halved, or the marker leaves its gate. Chance moves none of the made motions by more than a
third in 25 cycles. With less a cable that strays is sorted worse, for medians of few cycles stray more."""
LOST_SHARE = 0.5
"""A frame in which less than this part of what is in sight is found is left to the chain search."""
CHANGED_SHARE = 0.3
"""Where more of a cycle's frames are lost, the cable is not what was learnt."""
CHECKED_FRAMES = 300
"""Which the chain search sorts as well, spread over the recording."""
DISAGREES_SHARE = 0.06
"""Of these: a sound template has up to 4 %, with many ghosts; one whose learnt labels were wrong in 27 % of the frames
has 7 to 87 % (made motions for development)."""


def sort_by_phase(frames: PointFrames, settings: SortSettings) -> SortedMarkers:
    """Sort by the template of the robot's cycle, learnt from this recording's first good cycles.

    The chain search sorts up to ten cycles; the median of each marker over them, for each place of the path, is the
    template. In every frame each marker gets the point that is nearest to where the template and its own straying in
    the frames before put it, within gates that the scatter of the learnt cycles sets. Every 25 cycles, and more often
    where the cable moves far in so many, the template follows what it has become since. Where most frames of five
    cycles fit it no longer, as after a slip in a clamp, it is learnt anew from these. Frames in which it finds too
    little, and those outside cycles, are sorted by the chain search.

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
    work = _TemplateSorting(frames, settings)
    work.sort_cycles(template)
    notes = [_describe(template), work.compare_with_chain(), *work.sort_rest()]
    found = work.source, work.confidence, work.reason
    return SortedMarkers.from_source(frames, *found, "phase", notes, [*template.warnings, *work.warnings])


def _describe(template: PhaseTemplate) -> str:
    return (
        f"The template of the cycle was learnt from {template.n_cycles} cycles; a cycle strays from it by "
        f"{template.cycle_sigma_m * 1e3:.1f} mm (standard deviation of the worst marker in each coordinate)."
    )


@dataclass(frozen=True, eq=False)
class _Block:
    """Some cycles that follow each other, sorted."""

    rows: Ints
    """(F,): their frames."""
    followed: FollowedFrames
    bounds: Ints
    """(C + 1,): where each cycle begins and the last one ends, in `rows`."""
    lost: Bools
    """(C,): the cycles in many frames of which little is found."""

    @property
    def is_lost(self) -> bool:
        """Whether there are enough of them to learn the cycle anew."""
        return int(self.lost.sum()) >= FEWEST_CYCLES


class _TemplateSorting:
    """What is being written of F frames, first by the template, then by the chain search."""

    def __init__(self, frames: PointFrames, settings: SortSettings) -> None:
        shape = (len(frames), settings.n_markers)
        self.source = np.full(shape, -1, dtype=np.int16)
        self.confidence = np.zeros(shape, dtype=np.float32)
        self.reason = np.full(shape, MarkerReason.NO_START, dtype=np.uint8)
        self.warnings: list[str] = []
        self._frames, self._settings = frames, settings
        self._cycle = np.full(len(frames), -1) if frames.cycle is None else frames.cycle
        self._inside = rows_in_cycles(frames)
        self._enough = LOST_SHARE * np.minimum(count_usable(frames), settings.n_markers)

    def sort_cycles(self, template: PhaseTemplate) -> None:
        """Sort the frames inside cycles, block by block; a block in which the cable moves far is halved."""
        cycle = self._cycle[self._inside]
        bounds = np.append(np.flatnonzero(np.diff(cycle, prepend=cycle[:1] - 1)), len(cycle))
        first, n_cycles, n_all = 0, BLOCK_CYCLES, len(bounds) - 1
        while first < n_all:
            stop = min(first + n_cycles, n_all)
            block = self._follow_block(self._inside[bounds[first] : bounds[stop]], template)
            newer = self._refresh(block, min(LEARNT_CYCLES, max(n_cycles // 2, FEWEST_SHOWING)), template)
            moved = measure_movement(template, newer)
            half = (stop - first) // 2
            if moved > MOVED_SHARE and half >= FEWEST_SHOWING:
                n_cycles = half
                continue
            template, first = self._learn_anew(block) or newer, stop
            n_cycles = min(2 * n_cycles, BLOCK_CYCLES) if 2 * moved <= MOVED_SHARE else n_cycles

    def _follow_block(self, rows: Ints, template: PhaseTemplate) -> _Block:
        """Sort the frames of some cycles."""
        followed, cycle = self._follow(rows, template), self._cycle[rows]
        bounds = np.append(np.flatnonzero(np.diff(cycle, prepend=cycle[0] - 1)), len(rows))
        lost = np.add.reduceat(self._is_lost(rows), bounds[:-1]) > CHANGED_SHARE * np.diff(bounds)
        return _Block(rows, followed, bounds, lost)

    def _refresh(self, block: _Block, n_newest: int, template: PhaseTemplate) -> PhaseTemplate:
        """Return the template as the last cycles have it, of those before the cable was lost if it was."""
        stop = int(block.lost.argmax()) if block.is_lost else len(block.lost)
        if not stop:
            return template
        latest = slice(int(block.bounds[max(stop - n_newest, 0)]), int(block.bounds[stop]))
        frames = self._frames.take(block.rows[latest])
        cycle, phase = np.asarray(frames.cycle), np.asarray(frames.phase)
        cycles = cycle[np.flatnonzero(np.diff(cycle, prepend=cycle[0] - 1))].tolist()
        sure_m = block.followed.take(latest).sure_positions(frames)
        return refresh_template(template, lay_over_cycles(sure_m, cycle, phase, cycles, len(template.position_m) - 1))

    def _learn_anew(self, block: _Block) -> PhaseTemplate | None:
        """Learn the cycle from those cycles in which the cable is lost, and sort them by that; None where few are."""
        beyond = block.rows[np.repeat(block.lost, np.diff(block.bounds))]
        newer = learn_cycle(self._frames.take(beyond), self._settings) if block.is_lost else None
        if newer is not None:
            self.warnings.append(
                "The cable came back to other places than before: the sorting was learnt anew at cycle "
                f"{self._cycle[beyond[0]]}."
            )
            self._follow(beyond, newer)
        return newer

    def _follow(self, rows: Ints, template: PhaseTemplate) -> FollowedFrames:
        followed = follow_frames(self._frames, rows, template)
        self.source[rows], self.confidence[rows], self.reason[rows] = (
            followed.source,
            followed.confidence,
            followed.reason,
        )
        return followed

    def _is_lost(self, rows: Ints) -> Bools:
        """Return (C,) where less is found than should be of what is in sight."""
        return np.asarray((self.source[rows] >= 0).sum(axis=1) < self._enough[rows], dtype=bool)

    def compare_with_chain(self) -> str:
        """Ask the chain search in some frames, warn where it disagrees often, and return what to say of it."""
        place = np.linspace(0, len(self._inside) - 1, min(CHECKED_FRAMES, len(self._inside)))
        rows = self._inside[place.astype(np.int64)]
        chained, ours = sort_by_chain(self._frames.take(rows), self._settings), self.source[rows]
        differs = (chained.source >= 0) & (chained.source != ours)
        contradicts = (differs & (ours >= 0)).any(axis=1)
        left_out = (differs & (ours < 0) & (chained.reason == MarkerReason.FOUND)).any(axis=1)
        if (contradicts | left_out).mean() > DISAGREES_SHARE:
            self.warnings.append(
                f"The order of the markers is in doubt. Of {len(rows)} frames that a second method looked at, it finds "
                f"another order in {contradicts.mean():.0%} and more markers in {left_out.mean():.0%}: what is "
                "expected at each phase may have been learnt from wrongly sorted cycles. Compare with [analysis] "
                "sorting = 'track'."
            )
        return f"The chain search, asked in {len(rows)} frames, contradicts in {contradicts.mean():.1%} of them."

    def sort_rest(self) -> list[str]:
        """Sort frames outside cycles, and those that the template does not fit, each by itself; return what to say."""
        outside = np.ones(len(self.source), dtype=bool)
        outside[self._inside] = False
        lost = self._is_lost(np.arange(len(outside))) & ~outside
        alone = np.flatnonzero(outside | lost)
        if not len(alone):
            return []
        chained = sort_by_chain(self._frames.take(alone), self._settings)
        better = outside[alone] | ((chained.source >= 0).sum(axis=1) > (self.source[alone] >= 0).sum(axis=1))
        rows = alone[better]
        self.source[rows], self.reason[rows] = chained.source[better], chained.reason[better]
        self.confidence[rows] = chained.marker_confidence[better]
        notes = [f"{outside.sum()} frames outside any cycle are sorted each by itself."] if outside.any() else []
        if lost.any():
            self.warnings.append(
                f"In {lost.sum()} frames less than half of the markers in sight are near their usual places at that "
                "moment of the cycle: these frames are sorted each by itself where that finds more."
            )
        return notes
