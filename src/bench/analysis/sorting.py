"""Which point of a frame is which marker of the cable. A sorter is a function, chosen by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol

from bench.analysis.chain import sort_by_chain
from bench.analysis.gates import SortSettings
from bench.analysis.markers import PointFrames, SortedMarkers
from bench.analysis.paper import sort_by_paper
from bench.analysis.track_sorting import sort_by_track
from bench.errors import AnalysisError

__all__ = ["SORTERS", "Sorter", "get_sorter"]


class Sorter(Protocol):
    """Gives every marker of every frame its point."""

    def __call__(self, frames: PointFrames, settings: SortSettings) -> SortedMarkers:
        """Sort the points of all frames."""
        ...


SORTERS: Mapping[str, Sorter] = MappingProxyType(
    {"chain": sort_by_chain, "paper": sort_by_paper, "track": sort_by_track}
)
"""Sorters by the names of `[analysis] sorting`."""
RECOMMENDED = "paper"


def get_sorter(name: str) -> Sorter:
    """Return the sorter of that name; 'auto' is the recommended one.

    Raises
    ------
    AnalysisError
        There is no sorter of that name.
    """
    chosen = RECOMMENDED if name == "auto" else name
    if chosen not in SORTERS:
        raise AnalysisError(f"There is no sorting method '{name}'.", hint=f"Choose one of: auto, {', '.join(SORTERS)}.")
    return SORTERS[chosen]
