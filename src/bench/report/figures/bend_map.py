"""Where along the cable, and when in the cycle, it is bent how tightly."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke

from bench.report.figures.axes import cell_edges, say_nothing_to_show
from bench.report.figures.svg import INK, drawing, new_figure, to_svg
from bench.report.results import Results

__all__ = ["bend_map_figure"]

Floats = npt.NDArray[np.float64]

COLOURS = "magma"
"""Evenly perceived, readable without colour vision and in grey: tight bends dark, gentle ones pale."""
UNSEEN: dict[str, Any] = {"facecolor": "#f2f2f2", "edgecolor": "#c9c9c9", "hatch": "////", "linewidth": 0.0}
WIDEST_RATIO = 30.0
"""Bends wider than this many times the limit look alike: they do not harm the cable."""
TIGHTEST_RATIO = 0.25
"""Bends tighter than this part of the limit look alike: all are far beyond it."""
LIMIT_LINE = "#00c2b2"


def bend_map_figure(results: Results) -> str:
    """Draw the median bend radius by cycle phase and arc length as SVG; the colours are a picture inside it."""
    with drawing():
        if np.isfinite(results.bend_map_per_m).any():
            figure = new_figure(3.7)
            _draw_map(figure, figure.add_subplot(), results)
        else:
            figure = say_nothing_to_show("No place on the cable was seen in any cycle: there is no map to draw.")
        about = "Median bend radius over all cycles, as colour, by cycle phase (across) and arc length (up)."
        return to_svg(figure, "bend-map", "Bend-radius map", about)


def _draw_map(figure: Figure, axes: Axes, results: Results) -> None:
    phase = cell_edges(results.phase_grid, 0.0, 1.0)
    arc_mm = 1e3 * cell_edges(results.arc_length_m)
    radius_mm = _radius_mm(results.bend_map_per_m)
    axes.grid(visible=False)
    axes.add_patch(Rectangle((0, 0), 1, 1, transform=axes.transAxes, zorder=0, **UNSEEN))
    ends_mm = _ends_mm(radius_mm, results.config.cable.minimum_bend_radius_mm)
    picture = axes.pcolormesh(
        phase, arc_mm, radius_mm.T, cmap=colormaps[COLOURS], norm=LogNorm(*ends_mm, clip=True), rasterized=True
    )
    handles = _draw_limit_contour(axes, results)
    if np.isnan(radius_mm).any():
        handles.append(Patch(label="not seen", **UNSEEN))
    if handles:
        axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=2, borderaxespad=0.2)
    axes.set(xlim=(0, 1), ylim=(arc_mm[0], arc_mm[-1]))
    axes.set_xlabel("cycle phase (0 = start, 1 = end of the path)")
    axes.set_ylabel("arc length from the anchor (mm)")
    _mark_markers(axes, results)
    _add_scale(figure, axes, picture, ends_mm, results.config.cable.minimum_bend_radius_mm)


def _radius_mm(curvature_per_m: Floats) -> npt.NDArray[np.float64]:
    """Return bend radii; a straight cable is a very large radius, not a division by zero."""
    return np.asarray(1e3 / np.maximum(curvature_per_m, 1e-6))


def _ends_mm(radius_mm: Floats, limit_mm: float) -> tuple[float, float]:
    """Return the radii at the ends of the colour scale; it always holds the limit."""
    low = np.clip(float(np.nanmin(radius_mm)), TIGHTEST_RATIO * limit_mm, 0.8 * limit_mm)
    high = np.clip(float(np.nanpercentile(radius_mm, 95)), 4 * limit_mm, WIDEST_RATIO * limit_mm)
    return float(low), float(high)


def _draw_limit_contour(axes: Axes, results: Results) -> list[Patch]:
    """Outline what is tighter than the catalogue limit; return the legend's entry, if there is such a place."""
    limit_mm = results.config.cable.minimum_bend_radius_mm
    field = np.ma.masked_invalid(results.bend_map_per_m.T)
    level = 1e3 / limit_mm
    if min(field.shape) < 2 or not field.min() < level < field.max():
        return []
    lines = axes.contour(
        results.phase_grid, 1e3 * results.arc_length_m, field, levels=[level], colors=LIMIT_LINE, linewidths=1.3
    )
    lines.set_path_effects([withStroke(linewidth=2.6, foreground="#10201f")])
    lines.set_rasterized(field.size > 20_000)  # a ragged outline of so many cells would be megabytes of path
    label = f"tighter than the catalogue limit, {limit_mm:g} mm"
    return [Patch(facecolor="none", edgecolor=LIMIT_LINE, linewidth=1.5, label=label)]


def _scale_ticks_mm(ends_mm: tuple[float, float], limit_mm: float) -> list[float]:
    """Return round numbers between the ends of the scale that leave room for the limit's own label."""
    candidates = [digit * 10.0**power for power in range(-3, 8) for digit in (1, 2, 5)]
    return [tick for tick in candidates if ends_mm[0] <= tick <= ends_mm[1] and abs(np.log(tick / limit_mm)) > 0.2]


def _mark_markers(axes: Axes, results: Results) -> None:
    """Set a small triangle at each marker's place along the right edge."""
    place = 1e3 * results.marker_arc_length_m
    style: dict[str, Any] = {"marker": "<", "color": INK, "markersize": 3.5, "linestyle": "none", "clip_on": False}
    axes.plot(np.full(place.size, 1.008), place, transform=axes.get_yaxis_transform(), **style)


def _add_scale(figure: Figure, axes: Axes, picture: QuadMesh, ends_mm: tuple[float, float], limit_mm: float) -> None:
    scale = figure.colorbar(picture, ax=axes, pad=0.02, aspect=26)
    scale.set_label("bend radius (mm)")
    ticks = _scale_ticks_mm(ends_mm, limit_mm)
    scale.set_ticks([*ticks, limit_mm], labels=[*(f"{tick:g}" for tick in ticks), f"{limit_mm:g} limit"])
    scale.minorticks_off()
    scale.ax.axhline(limit_mm, color=LIMIT_LINE, linewidth=2.2)
    scale.ax.invert_yaxis()  # tight bends on top, where the eye begins
    scale.outline.set_linewidth(0.5)
