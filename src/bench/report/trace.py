"""The cable in every frame: its markers sorted and the curve through them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.analysis import (
    TRUSTED_CONFIDENCE,
    ClampedEnds,
    CurveEstimate,
    CurveEstimator,
    PointFrames,
    SortedMarkers,
    find_folds,
    find_isolated_bends,
    find_tighter,
    fit_spline,
    get_estimator,
    get_sorter,
    tell_broken,
)
from bench.config import Config
from bench.report.markers import make_sort_settings

__all__ = ["TracedCable", "find_nodes", "trace_cable"]

Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TracedCable:
    """Markers and curvature of F frames."""

    markers: SortedMarkers
    curve: CurveEstimate
    complete: Bools
    """(F,): every marker was found."""
    trusted: Bools
    """(F,): the frame may enter the figures: confident enough, not impossible, not isolated."""
    impossible: Bools
    """(F,): bent tighter than the cable's own radius somewhere, or folded back, so wrongly sorted."""
    isolated: Bools
    """(F,): bent far tighter than just before and after, so probably wrongly sorted."""
    isolated_bend_per_m: float
    """The tightest of these bends, 0 without any."""
    arc_length_m: Floats
    """(G,)"""
    marker_arc_length_m: Floats
    """(k,)"""


def find_nodes(traced: TracedCable) -> Floats:
    """Return the arc lengths of the curve's ends and of the markers between them, from the anchor on."""
    return np.unique(np.concatenate([traced.arc_length_m[[0, -1]], traced.marker_arc_length_m]))


def trace_cable(
    points: PointFrames, config: Config, ends: ClampedEnds | None = None, estimate: CurveEstimator | None = None
) -> TracedCable:
    """Sort the markers of every frame and estimate the curvature along the cable.

    Parameters
    ----------
    points : PointFrames
    config : Config
    ends : ClampedEnds, optional
        What is known of the cable's ends; the curve reaches as far as it is known.
    estimate : CurveEstimator, optional
        Replaces the configured one.
    """
    analysis, marker_places = config.analysis, np.array(config.cable.arc_length_m)
    places = np.linspace(*_find_span(marker_places, ends), analysis.arc_length_samples)
    settings = make_sort_settings(config)
    markers = get_sorter(analysis.sorting)(points, settings)
    if analysis.sorting != "auto":  # which has taken them away
        markers = tell_broken(points, markers, settings)
    noise_m = analysis.marker_noise_mm * 1e-3
    estimate = estimate or get_estimator(analysis.curvature)
    curve = estimate(markers.position_m, marker_places, places, noise_m, ends=ends)
    drawn = fit_spline(markers.position_m, marker_places, _judged_places(marker_places), noise_m)
    impossible = find_tighter(drawn.curvature_per_m, 2e3 / config.cable.diameter_mm) | find_folds(markers.position_m)
    plausible = np.asarray(markers.confidence >= TRUSTED_CONFIDENCE, dtype=bool) & ~impossible
    isolated = find_isolated_bends(drawn.curvature_per_m, drawn.sigma_per_m, plausible, points.time_ns)
    return TracedCable(
        markers=markers,
        curve=curve,
        complete=np.asarray((markers.source >= 0).all(axis=1), dtype=bool),
        trusted=plausible & ~isolated,
        impossible=impossible,
        isolated=isolated,
        isolated_bend_per_m=float(np.nanmax(drawn.curvature_per_m[isolated])) if isolated.any() else 0.0,
        arc_length_m=places,
        marker_arc_length_m=marker_places,
    )


def _judged_places(marker_places: Floats) -> Floats:
    """Return where the curve through every marker is asked for wrong labels: at the markers and half way between.

    A smooth curve averages a wrong label away; the spline goes through it and is bent most there.
    """
    return np.sort(np.concatenate([marker_places, (marker_places[1:] + marker_places[:-1]) / 2]))


def _find_span(marker_places: Floats, ends: ClampedEnds | None) -> tuple[float, float]:
    """Return the arc lengths between which places are known on the curve: the markers, and the clamps beyond them."""
    first, last = float(marker_places[0]), float(marker_places[-1])
    if ends and ends.anchor and np.isfinite(ends.anchor.position_m).any():
        first = 0.0
    if ends and ends.end and np.isfinite(ends.end.position_m).any():
        last = ends.length_m
    return first, last
