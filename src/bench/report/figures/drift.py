"""The cable over the test: how far its shape and its largest curvature are from those of the first cycles."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from bench.report.figures.axes import say_nothing_to_show
from bench.report.figures.cycles import FEW, cycles_per_group, fold, label_cycle_axis, median_of_rows
from bench.report.figures.svg import INK, MUTED, PALE, WARNING_INK, drawing, new_figure, to_svg
from bench.report.results import Drift, DriftChange, Results

__all__ = ["drift_figure"]

Floats = npt.NDArray[np.float64]

LEAST_SHARE = 0.02
"""The curvature's axis reaches at least to this part of it, on either side: twice what matters."""


def drift_figure(results: Results) -> str:
    """Draw shape distance and change of the largest curvature by cycle, with what was found in them, as SVG."""
    with drawing():
        if results.drift is None:
            figure = say_nothing_to_show("Too few cycles to see a change over the test.")
        else:
            figure = new_figure(4.4)
            top, bottom = figure.subplots(2, 1, sharex=True)
            _draw_shape(top, results, results.drift)
            _draw_curvature(bottom, results, results.drift)
            label_cycle_axis(bottom, results)
            top.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=4, handlelength=1.4, columnspacing=1.4)
        title = "Change over the test"
        about = "Distance of each cycle's shape, and change of its largest curvature, from those of the first cycles."
        return to_svg(figure, "drift", title, about)


def _draw_shape(axes: Axes, results: Results, drift: Drift) -> None:
    columns = drift.columns
    _draw_series(axes, results, columns.shape_distance_mm, columns.shape_distance_fitted_mm)
    _mark(axes, drift, [change for change in drift.changes if change.quantity == "shape"])
    least = results.config.analysis.marker_noise_mm  # noise must not fill the panel
    axes.set_ylim(0, max(axes.get_ylim()[1], 1.5 * least))
    axes.set_ylabel("shape distance (mm)")


def _draw_curvature(axes: Axes, results: Results, drift: Drift) -> None:
    columns = drift.columns
    change = np.where(columns.watched, columns.max_curvature_change_per_m, np.nan)
    _draw_series(
        axes,
        results,
        change,
        columns.max_curvature_change_fitted_per_m,
        np.nan_to_num(columns.max_curvature_change_sigma_per_m),
    )
    _mark(axes, drift, [change for change in drift.changes if change.quantity == "max_curvature"])
    usual = results.cycles.max_curvature_per_m[columns.watched]
    least = LEAST_SHARE * float(np.median(usual[np.isfinite(usual)])) if np.isfinite(usual).any() else 0.0
    bottom, top = axes.get_ylim()
    axes.set_ylim(min(bottom, -least), max(top, least))
    axes.set_ylabel("change of the largest\ncurvature (1/m)")


def _draw_series(axes: Axes, results: Results, value: Floats, fitted: Floats, sigma: Floats | None = None) -> None:
    """Draw a quantity with the band of its group, or of its noise, and the line that was found in it."""
    size = cycles_per_group(len(value))
    place = median_of_rows(fold(results.cycles.cycle_index.astype(float), size))
    band = fold(np.zeros(len(value)) if sigma is None else 2 * sigma, size)
    rows = np.ma.masked_invalid(fold(value, size))
    low, high = (np.ma.filled(edge, np.nan) for edge in ((rows - band).min(axis=1), (rows + band).max(axis=1)))
    axes.fill_between(place, low, high, color=PALE, linewidth=0)
    dot = "o" if len(place) <= FEW else ""
    label = "cycle" if size == 1 else f"median of {size} cycles, band: all of them"
    middle = median_of_rows(np.ma.filled(rows, np.nan))
    axes.plot(place, middle, color=INK, linewidth=0.8, marker=dot, markersize=3, label=label)
    found = median_of_rows(fold(fitted, size))
    axes.plot(place, found, color="#222222", linewidth=1.4, linestyle=(0, (4, 2)), label="steps and trend found")


def _mark(axes: Axes, drift: Drift, changes: list[DriftChange]) -> None:
    """Tint the reference cycles, and draw a line where something changed that matters."""
    reference = drift.reference_cycle_index
    axes.axvspan(reference[0] - 0.5, reference[-1] + 0.5, color=MUTED, alpha=0.12, linewidth=0, label="reference")
    label = "change that matters"
    for change in changes:
        if change.matters:
            axes.axvline(change.cycle_index - 0.5, color=WARNING_INK, linewidth=1.1, label=label)
            label = "_"  # one entry in the legend for all of them
