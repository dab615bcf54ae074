"""The comparison's figures, after the paper's Fig. 11: both motions, and how far they are apart where and when."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from bench.report.comparison.compare import Comparison
from bench.report.comparison.text import find_largest
from bench.report.figures.axes import cell_edges
from bench.report.figures.svg import INK, MUTED, WARNING_INK, drawing, new_figure, to_svg

__all__ = ["difference_figure", "motions_figure"]

Floats = npt.NDArray[np.float64]

SHOWN_PHASES = 6
ERROR_LINES = 25
UNSEEN = "#e4e7ea"
"""Colour of where one of both was not seen."""


def motions_figure(found: Comparison) -> str:
    """Draw both motions in front view, and the moment of the largest distance with what is between them, as SVG."""
    plane = _front(found)
    with drawing():
        figure = new_figure(3.9)
        left, right = figure.subplots(1, 2)
        shown = np.unique(np.linspace(0, len(found.cycle_phase) - 1, SHOWN_PHASES).astype(int))
        for index in shown:
            _draw_pair(left, found, int(index), plane)
        worst, _ = find_largest(found)
        _draw_pair(right, found, worst, plane)
        _draw_between(right, found, worst, plane)
        left.set_title(f"(a)  {len(shown)} moments of the cycle")
        right.set_title(f"(b)  Phase {found.cycle_phase[worst]:.3f}, where they are furthest apart")
        for axes in (left, right):
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_xlabel(f"{'xyz'[plane[0]]} (mm)")
        left.set_ylabel(f"{'xyz'[plane[1]]} (mm)")
        handles, labels = right.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
        about = "Left: both cables at moments spread over the cycle. Right: the moment of the largest distance."
        return to_svg(figure, "motions", "Two motions of a cable", about)


def difference_figure(found: Comparison) -> str:
    """Draw the distance of both motions by cycle phase and arc length as SVG, with its rms along either."""
    distance_mm, square = 1e3 * found.difference.distance_m, 1e6 * found.difference.distance_m**2
    phase, arc_mm = cell_edges(found.cycle_phase, 0.0, 1.0), 1e3 * cell_edges(found.arc_length_m)
    with drawing():
        figure = new_figure(4.6)
        grid = figure.subplots(2, 2, width_ratios=[4, 1], height_ratios=[1, 3], sharex="col", sharey="row")
        field, above, beside = grid[1, 0], grid[0, 0], grid[1, 1]
        grid[0, 1].set_axis_off()
        field.grid(visible=False)
        field.set_facecolor(UNSEEN)
        picture = field.pcolormesh(phase, arc_mm, distance_mm.T, cmap="viridis", rasterized=True)
        field.set(xlabel="cycle phase", ylabel="arc length from the anchor (mm)", xlim=(0, 1))
        above.plot(found.cycle_phase, _rms(square, axis=1), color=INK, linewidth=1.2)
        above.set(ylabel="rms (mm)", ylim=(0, None))
        beside.plot(_rms(square, axis=0), 1e3 * found.arc_length_m, color=INK, linewidth=1.2)
        beside.set(xlabel="rms (mm)", xlim=(0, None))
        figure.colorbar(picture, ax=grid[:, 1], label="distance (mm)", pad=0.02)
        about = (
            "Distance of the same place of the cable in both motions, as colour, by phase (across) and arc length (up)."
        )
        return to_svg(figure, "difference", "Distance by phase and arc length", about)


def _front(found: Comparison) -> tuple[int, int]:
    """Return the lab frame's axes across and up: across is the longer horizontal one."""
    up = found.first.example.up_axis if found.first.example else 1
    both = np.concatenate([found.first_m, found.second_m]).reshape(-1, 3)
    extent = np.nanmax(both, axis=0) - np.nanmin(both, axis=0)
    across = max((axis for axis in range(3) if axis != up), key=lambda axis: extent[axis])
    return across, up


def _draw_pair(axes: Axes, found: Comparison, phase: int, plane: tuple[int, int]) -> None:
    named = not axes.lines
    for motion, colour, dashes, label in (
        (found.first_m, INK, "-", found.first.run_path),
        (found.second_m, WARNING_INK, "--", found.second_name),
    ):
        curve_mm = 1e3 * motion[phase][:, plane]
        axes.plot(*curve_mm.T, color=colour, linestyle=dashes, linewidth=1.2, label=label if named else "_")


def _draw_between(axes: Axes, found: Comparison, phase: int, plane: tuple[int, int]) -> None:
    places = np.unique(np.linspace(0, len(found.arc_length_m) - 1, ERROR_LINES).astype(int))
    pairs = 1e3 * np.stack([found.first_m[phase, places][:, plane], found.second_m[phase, places][:, plane]], axis=1)
    known = np.isfinite(pairs).all(axis=(1, 2))
    axes.add_collection(LineCollection(list(pairs[known]), colors=MUTED, linewidths=0.6))


def _rms(square: Floats, axis: int) -> Floats:
    known = np.isfinite(square)
    count = known.sum(axis=axis)
    total = np.where(known, square, 0.0).sum(axis=axis)
    return np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))
