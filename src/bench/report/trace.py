"""The cable in every frame: its markers sorted and the curve through them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.analysis import (
    TRUSTED_CONFIDENCE,
    CurveEstimate,
    SortedMarkers,
    fill_from_end,
    find_isolated_bends,
    find_tighter,
    get_estimator,
    get_sorter,
)
from bench.config import Config
from bench.report.markers import ChainStart, make_sort_settings
from bench.report.source import TrackerFrames

__all__ = ["TracedCable", "trace_cable"]

Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TracedCable:
    """Markers and curvature of F frames."""

    sorting: str
    """Name of the method."""
    curvature: str
    """Name of the method."""
    markers: SortedMarkers
    curve: CurveEstimate
    complete: Bools
    """(F,): every marker was found."""
    trusted: Bools
    """(F,): the frame may enter the figures: confident enough, not impossible, not isolated."""
    impossible: Bools
    """(F,): bent tighter than the cable's own radius somewhere, so wrongly sorted."""
    isolated: Bools
    """(F,): bent far tighter than just before and after, so probably wrongly sorted."""
    arc_length_m: Floats
    """(G,)"""
    marker_arc_length_m: Floats
    """(k,)"""


def trace_cable(frames: TrackerFrames, start: ChainStart, config: Config, end_m: Floats | None = None) -> TracedCable:
    """Sort the markers of every frame and estimate the curvature along the cable.

    Parameters
    ----------
    frames : TrackerFrames
    start : ChainStart
    config : Config
    end_m : (F, 3), optional
        The cable's other end, NaN where unknown: a second anchor for frames in which markers are hidden.
    """
    analysis, marker_places = config.analysis, np.array(config.cable.arc_length_m)
    places = np.linspace(marker_places[0], marker_places[-1], analysis.arc_length_samples)
    sorting, sort_markers = get_sorter(analysis.sorting)
    curvature, estimate_curve = get_estimator(analysis.curvature)
    settings = make_sort_settings(config)
    markers = sort_markers(frames.points_m, frames.offsets, start.usable, start.anchor_m, settings)
    if end_m is not None:
        usable, length_m = start.usable, config.cable.length_m
        markers = fill_from_end(frames.points_m, frames.offsets, usable, markers, end_m, length_m, settings)
    curve = estimate_curve(markers.position_m, marker_places, places, analysis.marker_noise_mm * 1e-3)
    impossible = find_tighter(curve.curvature_per_m, 2e3 / config.cable.diameter_mm)
    plausible = np.asarray(markers.confidence >= TRUSTED_CONFIDENCE, dtype=bool) & ~impossible
    isolated = find_isolated_bends(curve.curvature_per_m, curve.sigma_per_m, plausible, frames.time_ns)
    return TracedCable(
        sorting=sorting if end_m is None else f"{sorting}, from both ends",
        curvature=curvature,
        markers=markers,
        curve=curve,
        complete=np.asarray((markers.source >= 0).all(axis=1), dtype=bool),
        trusted=plausible & ~isolated,
        impossible=impossible,
        isolated=isolated,
        arc_length_m=places,
        marker_arc_length_m=marker_places,
    )
