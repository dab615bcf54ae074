"""The run at a glance, cycle by cycle: the tightest bend of each, and how much of each was seen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, PercentFormatter

from bench.report.figures.axes import add_radius_axis, draw_limit, say_nothing_to_show
from bench.report.figures.svg import INK, MUTED, PALE, WARNING_INK, drawing, new_figure, to_svg
from bench.report.results import Results

__all__ = [
    "FEW",
    "GROUPS_LIMIT",
    "completeness_figure",
    "cycles_figure",
    "cycles_per_group",
    "fold",
    "label_cycle_axis",
    "median_of_rows",
]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

GROUPS_LIMIT = 1000
"""Most places along the cycle axis: about one for each pixel of the page; more cycles are drawn in groups."""
PLACES_AT_LEAST = 8
"""Width of the cycle axis when there are hardly any cycles: one cycle is not as wide as the page."""
FEW = 60
"""Up to this many cycles, each gets a dot."""
OUTLIER_RATIO = 2.0
"""A value above this many times the limit or the median is drawn at the upper edge: it must not flatten the rest."""


@dataclass(frozen=True, eq=False)
class _Groups:
    """The n cycles as m groups of neighbours; n = m when there are few."""

    cycle: Floats
    """(m,): middle cycle index of each group."""
    middle: Floats
    """(m,): median of the groups' largest curvatures, 1/m."""
    low: Floats
    """(m,): smallest of them minus two standard deviations."""
    high: Floats
    """(m,): largest of them plus two standard deviations."""
    largest: Floats
    """(m,): largest of them."""


def cycles_per_group(n_cycles: int) -> int:
    """Return how many neighbouring cycles share one place along the axis."""
    return max(1, -(-n_cycles // GROUPS_LIMIT))


def cycles_figure(results: Results) -> str:
    """Draw the largest curvature of each cycle with its band, the catalogue limit, and marks on odd cycles as SVG."""
    with drawing():
        if np.isfinite(results.cycles.max_curvature_per_m).any():
            figure = new_figure(3.1)
            _draw_cycles(figure.add_subplot(), results)
        else:
            figure = say_nothing_to_show("No cycle has a curvature to show.")
        title = "Largest curvature in each cycle"
        about = "Curvature in 1/m by cycle index, with a band of two standard deviations and the catalogue limit."
        return to_svg(figure, "cycles", title, about)


def completeness_figure(results: Results) -> str:
    """Draw the share of frames in which every marker was found, for each cycle, as SVG."""
    with drawing():
        if np.isfinite(results.cycles.complete_fraction).any():
            figure = new_figure(1.7)
            _draw_completeness(figure.add_subplot(), results)
        else:
            figure = say_nothing_to_show("No cycle has frames to count.")
        title = "Complete frames in each cycle"
        return to_svg(figure, "completeness", title, "Share of frames with every marker found, by cycle index.")


def _draw_cycles(axes: Axes, results: Results) -> None:
    limit_per_m = 1e3 / results.config.cable.minimum_bend_radius_mm
    groups = _grouped(results)
    dot = "o" if groups.cycle.size <= FEW else ""
    known = bool(np.isfinite(results.cycles.max_curvature_sigma_per_m).any())
    label = _band_label(results) if known else "_"  # matplotlib leaves such a name out of the legend
    axes.fill_between(groups.cycle, groups.low, groups.high, color=PALE, linewidth=0, label=label)
    axes.plot(
        groups.cycle, groups.middle, color=INK, linewidth=0.9, label=_line_label(results), marker=dot, markersize=3.5
    )
    if groups.cycle.size == 1:
        _draw_lone_band(axes, groups)
    bottom, top = _curvature_range(groups, limit_per_m)
    axes.set_ylim(bottom, top)
    _mark_crossings(axes, groups, limit_per_m, top)
    _mark_attention(axes, results)
    label_cycle_axis(axes, results)
    axes.set_ylabel("largest curvature (1/m)")
    draw_limit(axes, limit_per_m)
    add_radius_axis(axes)
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=4, handlelength=1.4, columnspacing=1.4)


def _draw_lone_band(axes: Axes, groups: _Groups) -> None:
    """Show the band of a single cycle as a bar: between one point and itself there is no area."""
    axes.vlines(groups.cycle, groups.low, groups.high, color=PALE, linewidth=9, zorder=1)


def _grouped(results: Results) -> _Groups:
    cycles = results.cycles
    size = cycles_per_group(cycles.cycle_index.size)
    value = fold(cycles.max_curvature_per_m, size)
    sigma = fold(np.nan_to_num(cycles.max_curvature_sigma_per_m), size)
    masked = np.ma.masked_invalid(value)
    return _Groups(
        cycle=_filled(np.ma.masked_invalid(fold(cycles.cycle_index.astype(float), size)).mean(axis=1)),
        middle=median_of_rows(value),
        low=np.maximum(_filled((masked - 2 * sigma).min(axis=1)), 0.0),
        high=_filled((masked + 2 * sigma).max(axis=1)),
        largest=_filled(masked.max(axis=1)),
    )


def median_of_rows(value: Floats) -> Floats:
    """Return the median of each row, NaN for a row of NaN (where `numpy.nanmedian` would warn)."""
    seen: npt.NDArray[np.bool_] = np.asarray(np.isfinite(value).any(axis=1))
    return np.where(seen, np.nanmedian(np.where(seen[:, None], value, 0.0), axis=1), np.nan)


def fold(column: Floats, size: int) -> Floats:
    """Return the column as rows of `size` neighbours, the last row filled up with NaN."""
    missing = -column.size % size
    return np.concatenate([column, np.full(missing, np.nan)]).reshape(-1, size)


def _filled(masked: np.ma.MaskedArray[tuple[int, ...], np.dtype[np.float64]]) -> Floats:
    return np.asarray(np.ma.filled(masked.astype(float), np.nan))


def _curvature_range(groups: _Groups, limit_per_m: float) -> tuple[float, float]:
    """Return a range that shows the drift of the values, and the limit where it is not far away."""
    cap = OUTLIER_RATIO * max(float(np.nanmedian(groups.middle)), limit_per_m)
    low, high = float(np.nanmin(groups.low)), min(float(np.nanmax(groups.high)), cap)
    low = min(low, high)
    if limit_per_m < 3 * high and limit_per_m > low / 3:
        low, high = min(low, limit_per_m), max(high, limit_per_m)
    margin = 0.12 * (high - low) or 0.1 * high or 1.0
    return max(low - margin, 0.0), high + margin


def _mark_crossings(axes: Axes, groups: _Groups, limit_per_m: float, top: float) -> None:
    """Mark what is beyond the limit in the warning colour, at the upper edge what is beyond the axis."""
    over = (groups.largest > limit_per_m) & (groups.largest <= top)
    size = 3.5 if groups.cycle.size <= FEW else 2.0
    axes.plot(groups.cycle[over], groups.largest[over], "o", color=WARNING_INK, markersize=size, label="_", zorder=3)
    above = groups.largest > top
    if above.any():
        edge = np.full(int(above.sum()), top)
        label = f"off the scale, to {float(np.nanmax(groups.largest)):.3g} 1/m"
        style: dict[str, Any] = {
            "marker": "^",
            "color": WARNING_INK,
            "markersize": 6,
            "linestyle": "none",
            "clip_on": False,
        }
        axes.plot(groups.cycle[above], edge, label=label, zorder=4, **style)


def _mark_attention(axes: Axes, results: Results) -> None:
    """Set a tick along the lower edge for each cycle that needs a look."""
    size = cycles_per_group(results.cycles.cycle_index.size)
    odd = np.isin(results.cycles.cycle_index, np.fromiter(results.attention, dtype=np.int64))
    places = results.cycles.cycle_index[odd] // size * size + (size - 1) / 2
    if places.size:
        style: dict[str, Any] = {
            "marker": "|",
            "color": "#c26a00",
            "markersize": 9,
            "markeredgewidth": 1.3,
            "linestyle": "none",
        }
        where = axes.get_xaxis_transform()
        places = np.unique(places)
        axes.plot(places, np.full(places.size, 0.035), transform=where, label="needs a look", **style)


def _draw_completeness(axes: Axes, results: Results) -> None:
    cycles = results.cycles
    size = cycles_per_group(cycles.cycle_index.size)
    share = np.ma.masked_invalid(fold(cycles.complete_fraction, size))
    place = _filled(np.ma.masked_invalid(fold(cycles.cycle_index.astype(float), size)).mean(axis=1))
    lowest = _filled(share.min(axis=1))
    if lowest.size <= FEW:
        axes.bar(place, lowest, width=0.7, color=PALE, edgecolor=INK, linewidth=0.6)
    else:
        axes.fill_between(place, 0, lowest, color=PALE, linewidth=0)
        axes.plot(place, lowest, color=INK, linewidth=0.8)
    axes.set_ylim(0, 1.05)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.set_yticks([0, 0.5, 1.0])
    axes.set_ylabel("complete frames" if size == 1 else "complete frames\n(least of group)")
    label_cycle_axis(axes, results)


def label_cycle_axis(axes: Axes, results: Results) -> None:
    """Give an axis the run's cycles, from the first to the last."""
    first, last = float(results.cycles.cycle_index.min()), float(results.cycles.cycle_index.max())
    margin = max(0.01 * (last - first), 0.6, (PLACES_AT_LEAST - (last - first)) / 2)
    axes.set_xlim(first - margin, last + margin)
    ticks = MaxNLocator(nbins=12, integer=True).tick_values(first, max(last, first + 1))
    axes.set_xticks([tick for tick in ticks if first <= tick <= last])
    axes.set_xlabel("cycle index")
    axes.tick_params(axis="x", colors=MUTED, labelcolor="#333333")


def _line_label(results: Results) -> str:
    size = cycles_per_group(results.cycles.cycle_index.size)
    return "largest curvature" if size == 1 else f"median of {size} cycles"


def _band_label(results: Results) -> str:
    size = cycles_per_group(results.cycles.cycle_index.size)
    return "± 2 standard deviations" if size == 1 else f"all {size}, ± 2 standard deviations"
