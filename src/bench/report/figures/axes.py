"""What several figures share: the catalogue limit, the second axis in bend radius, edges between samples."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bench.report.figures.svg import MUTED, WARNING_INK, new_figure

__all__ = ["add_radius_axis", "cell_edges", "draw_limit", "say_nothing_to_show"]

Floats = npt.NDArray[np.float64]

NICE = np.array([1, 1.5, 2, 3, 4, 5, 7])
NICE_RADII_MM: Floats = np.concatenate([NICE * 10.0**power for power in range(-2, 7)])
"""Bend radii that get a tick: round numbers, about evenly spaced on the axis."""


def draw_limit(axes: Axes, limit_per_m: float) -> None:
    """Draw the catalogue limit; what lies beyond it is tinted. Call when the axes' limits are final."""
    bottom, top = axes.get_ylim()
    if limit_per_m < top:
        axes.axhspan(max(limit_per_m, bottom), top, color=WARNING_INK, alpha=0.06, linewidth=0, zorder=0)
    if limit_per_m >= top:
        _name_limit(axes, limit_per_m, top, " ↑")
    elif limit_per_m <= bottom:
        _name_limit(axes, limit_per_m, bottom, " ↓")
    else:
        axes.axhline(limit_per_m, color=WARNING_INK, linewidth=1.1, zorder=2.5)
        _name_limit(axes, limit_per_m, limit_per_m, "")
    axes.set_ylim(bottom, top)


def _name_limit(axes: Axes, limit_per_m: float, height_per_m: float, arrow: str) -> None:
    """Write the limit's name at a height; an arrow says that the limit itself lies outside."""
    below = arrow == " ↑"
    axes.annotate(
        f"catalogue limit {1e3 / limit_per_m:.4g} mm{arrow}",
        xy=(0.0, height_per_m),
        xycoords=("axes fraction", "data"),
        xytext=(4, -3 if below else 3),
        textcoords="offset points",
        va="top" if below else "bottom",
        color=WARNING_INK,
        fontsize=8.5,
    )


def add_radius_axis(axes: Axes) -> None:
    """Put bend radii (mm) on the right of an axis of curvatures (1/m). Call when the axes' limits are final."""
    bottom, top = axes.get_ylim()
    right = axes.twinx()
    right.set_ylim(bottom, top)
    right.grid(visible=False)
    right.spines["right"].set_visible(True)
    places = 1e3 / _radii_mm(bottom, top)
    lowest = bottom + 0.04 * (top - bottom)
    inside = _apart(places[(places > lowest) & (places <= top)], (top - bottom) / 12)
    right.set_yticks(inside, [f"{1e3 / place:.6g}" for place in inside])
    right.set_ylabel("bend radius (mm)")


def _radii_mm(bottom_per_m: float, top_per_m: float) -> Floats:
    """Return candidates for ticks: evenly spaced over a narrow range, round numbers of all sizes over a wide one."""
    if bottom_per_m > top_per_m / 3:
        return np.asarray(MaxNLocator(6, steps=[1, 2, 5, 10]).tick_values(1e3 / top_per_m, 1e3 / bottom_per_m))
    return NICE_RADII_MM


def _apart(places: Floats, distance: float) -> list[float]:
    """Keep the places, largest first, that stand at least `distance` from the one kept before."""
    kept: list[float] = []
    for place in sorted(places.tolist(), reverse=True):
        if not kept or kept[-1] - place >= distance:
            kept.append(place)
    return kept


def cell_edges(centres: Floats, lowest: float = -np.inf, highest: float = np.inf) -> Floats:
    """Return the n + 1 edges of cells around n ascending centres, kept inside `lowest`…`highest`."""
    if centres.size == 1:
        edges = np.concatenate([centres - 0.5, centres + 0.5])
    else:
        middles = (centres[1:] + centres[:-1]) / 2
        edges = np.concatenate([2 * centres[:1] - middles[:1], middles, 2 * centres[-1:] - middles[-1:]])
    return np.asarray(np.clip(edges, lowest, highest))


def say_nothing_to_show(sentence: str) -> Figure:
    """Return a small figure that holds one sentence: why there is nothing to show."""
    figure = new_figure(0.8)
    axes = figure.add_subplot()
    axes.set_axis_off()
    axes.text(0.5, 0.5, sentence, transform=axes.transAxes, ha="center", va="center", color=MUTED)
    return figure
