"""Which point of a frame is which marker of the cable. A sorter is a function, chosen by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Protocol

import numpy as np

from bench.analysis.sorting.chain import sort_by_chain
from bench.analysis.sorting.gates import SortSettings
from bench.analysis.sorting.invariants import take_broken_away
from bench.analysis.sorting.markers import PointFrames, SortedMarkers
from bench.analysis.sorting.paper import sort_by_paper
from bench.analysis.sorting.phase_learning import FEWEST_CYCLES, learn_cycle
from bench.analysis.sorting.phase_sorting import sort_by_phase, sort_by_template
from bench.analysis.sorting.track_sorting import sort_by_track
from bench.errors import AnalysisError

__all__ = ["SORTERS", "Sorter", "get_sorter", "sort_automatically"]


class Sorter(Protocol):
    """Gives every marker of every frame its point."""

    def __call__(self, frames: PointFrames, settings: SortSettings) -> SortedMarkers:
        """Sort the points of all frames."""
        ...


SORTERS: Mapping[str, Sorter] = MappingProxyType(
    {"phase": sort_by_phase, "track": sort_by_track, "chain": sort_by_chain, "paper": sort_by_paper}
)
"""Sorters by the names of `[analysis] sorting`."""
REPEATS_SHARE = 0.08
"""Of the smallest spacing, by which a cycle may stray in each coordinate: beyond it the gates of neighbours, of 5.5
standard deviations each, would touch."""
FEWEST_FRAMES = 50
"""With fewer, the frames before and after tell little, and learning takes longer than it saves."""


def get_sorter(name: str) -> Sorter:
    """Return the sorter of that name; 'auto' decides for each recording (`sort_automatically`).

    Raises
    ------
    AnalysisError
        There is no sorter of that name.
    """
    if name == "auto":
        return sort_automatically
    if name not in SORTERS:
        raise AnalysisError(f"There is no sorting method '{name}'.", hint=f"Choose one of: auto, {', '.join(SORTERS)}.")
    return SORTERS[name]


def sort_automatically(frames: PointFrames, settings: SortSettings) -> SortedMarkers:
    """Sort by the method that suits the recording, and take away what breaks an invariant.

    By the robot's cycle where at least five whole cycles were recorded and repeat: where they stray from their median
    by little against the markers' spacing. Else by tracks through time, and fewer than 50 frames each by
    itself. The first note says which and why.
    """
    sort, why = _choose(frames, settings)
    markers = sort(frames, settings)
    return take_broken_away(frames, replace(markers, notes=[why, *markers.notes]), settings)


def _choose(frames: PointFrames, settings: SortSettings) -> tuple[Sorter, str]:
    if len(frames) < FEWEST_FRAMES:
        return sort_by_chain, f"Sorted each frame by itself ('chain'): there are only {len(frames)} frames."
    template = learn_cycle(frames, settings)
    spacing_mm = 1e3 * float(np.diff(settings.arc_length_m, prepend=0.0).min())
    if template is None:
        why = f"fewer than {FEWEST_CYCLES} whole cycles were recorded and could be sorted"
    else:
        strays_mm = 1e3 * template.cycle_sigma_m
        why = f"a cycle strays from the median by {strays_mm:.1f} mm, with markers {spacing_mm:.0f} mm apart"
        if strays_mm <= REPEATS_SHARE * spacing_mm:
            by_template = partial(sort_by_template, template=template)
            return by_template, f"Sorted by the robot's cycle ('phase'), which repeats: {why}."
    return sort_by_track, f"Sorted by tracks through time ('track'), for no cycle repeats: {why}."
