"""One frame as the paper's Fig. 5 shows it: before sorting, after sorting, and the curvature along the cable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.report.figures.axes import add_radius_axis, draw_limit, say_nothing_to_show
from bench.report.figures.svg import INK, MUTED, PALE, drawing, new_figure, to_svg
from bench.report.results import ExampleFrame, Results

__all__ = ["drawable_example", "example_figure", "n_points_outside"]

Floats = npt.NDArray[np.float64]

AXIS_NAMES = "xyz"
LABELS_LIMIT = 20
"""Most numbers written beside points; with more markers every second, third … is numbered."""
PANEL_WIDTH_IN = 3.6
"""Width of one of the two columns of projections."""
ANCHOR_ROOM_M = 0.005
"""A static marker is seen within this of where it is on average; nothing else can be there."""
NO_FRAME = "No frame was complete enough to draw a curve through it."


@dataclass(frozen=True, eq=False)
class _View:
    """What part of the lab frame is drawn, in millimetres."""

    low_mm: Floats
    """(3,)"""
    high_mm: Floats
    """(3,)"""
    planes: tuple[tuple[int, int], tuple[int, int]]
    """Across and up of the upper and the lower projection."""

    def height_in(self, plane: tuple[int, int]) -> float:
        across, up = self.high_mm[plane[0]] - self.low_mm[plane[0]], self.high_mm[plane[1]] - self.low_mm[plane[1]]
        return float(PANEL_WIDTH_IN * up / across)


def example_figure(results: Results) -> str:
    """Draw the example frame (two orthographic projections before and after sorting, and the curvature) as SVG."""
    title = "One frame before and after sorting, and the curvature along the cable"
    about = (
        "Left: the points joined in the tracker's order. Right: the markers numbered along the interpolated cable. "
        "Below: curvature by arc length with a band of two standard deviations and the catalogue limit."
    )
    with drawing():
        example = drawable_example(results)
        figure = say_nothing_to_show(NO_FRAME) if example is None else _drawn(results, example)
        return to_svg(figure, "example", title, about)


def drawable_example(results: Results) -> ExampleFrame | None:
    """Return the example frame if there is one with at least one marker to draw."""
    example = results.example
    return example if example is not None and np.isfinite(example.position_m).all(axis=1).any() else None


def n_points_outside(example: ExampleFrame) -> int:
    """Return how many recorded points lie outside the picture, which keeps to the neighbourhood of the cable."""
    view = _view(example)
    points_mm = 1e3 * example.points_m.astype(float)
    inside = np.all((points_mm >= view.low_mm) & (points_mm <= view.high_mm), axis=1)
    return int(np.count_nonzero(~inside & np.isfinite(points_mm).all(axis=1)))


def _drawn(results: Results, example: ExampleFrame) -> Figure:
    view = _view(example)
    heights = [view.height_in(plane) for plane in view.planes]
    below = 2.2
    figure = new_figure(sum(heights) + below + 1.5)
    rows = figure.add_gridspec(3, 2, height_ratios=[*heights, below])
    for row, plane in enumerate(view.planes):
        before, after = figure.add_subplot(rows[row, 0]), figure.add_subplot(rows[row, 1])
        _draw_before(before, example, plane)
        _draw_after(after, example, plane)
        for axes in (before, after):
            _frame_projection(axes, view, plane)
        after.tick_params(labelleft=False)
        after.set_ylabel("")
        if row == 0:
            _drop_across_labels(before, after)
            before.set_title("(a)  Before sorting: joined in the tracker's order", pad=10)
            after.set_title("(b)  After sorting: markers along the cable", pad=10)
    _draw_curvature(figure.add_subplot(rows[2, :]), results, example)
    return figure


def _drop_across_labels(*upper: Axes) -> None:
    """Leave the numbers to the lower projections: both have the same axis across."""
    for axes in upper:
        axes.tick_params(labelbottom=False)
        axes.set_xlabel("")


def _view(example: ExampleFrame) -> _View:
    """Choose the neighbourhood of the cable, seen from the front and from above."""
    cable_mm = 1e3 * np.concatenate([example.position_m.astype(float), example.curve_m])
    cable_mm = cable_mm[np.isfinite(cable_mm).all(axis=1)]
    low, high = cable_mm.min(axis=0), cable_mm.max(axis=0)
    largest = max(float((high - low).max()), 1.0)
    margin = np.maximum(0.10 * largest, (0.30 * largest - (high - low)) / 2)
    low, high = low - margin, high + margin
    return _View(low, high, _planes(high - low, example.up_axis))


def _planes(extent: Floats, up: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the front view and below it the top view, seen across the longer horizontal axis."""
    across, deep = sorted((axis for axis in range(3) if axis != up), key=lambda axis: -extent[axis])
    return (across, up), (across, deep)


def _frame_projection(axes: Axes, view: _View, plane: tuple[int, int]) -> None:
    across, up = plane
    axes.set_xlim(view.low_mm[across], view.high_mm[across])
    axes.set_ylim(view.low_mm[up], view.high_mm[up])
    axes.set_aspect("equal")
    axes.set_xlabel(f"{AXIS_NAMES[across]} (mm)")
    axes.set_ylabel(f"{AXIS_NAMES[up]} (mm)")
    axes.locator_params(nbins=6)


def _draw_before(axes: Axes, example: ExampleFrame, plane: tuple[int, int]) -> None:
    points_mm = 1e3 * example.points_m[:, plane]
    axes.plot(
        points_mm[:, 0], points_mm[:, 1], color=MUTED, linewidth=0.7, marker="o", markersize=4, markerfacecolor="w"
    )
    _number(axes, points_mm)


def _draw_after(axes: Axes, example: ExampleFrame, plane: tuple[int, int]) -> None:
    others_mm = 1e3 * _points_not_taken(example)[:, plane]
    curve_mm, markers_mm = 1e3 * example.curve_m[:, plane], 1e3 * example.position_m[:, plane]
    anchor_mm = 1e3 * example.anchor_m[list(plane)]
    axes.plot(others_mm[:, 0], others_mm[:, 1], "x", color=MUTED, markersize=4.5)
    axes.plot(*anchor_mm, "s", color=INK, markersize=6, markerfacecolor="none")
    axes.plot(curve_mm[:, 0], curve_mm[:, 1], color=INK, linewidth=1.4)
    axes.plot(markers_mm[:, 0], markers_mm[:, 1], "o", color=INK, markersize=4.5)
    _number(axes, markers_mm)


def _points_not_taken(example: ExampleFrame) -> npt.NDArray[np.float32]:
    """Return the recorded points that are neither a marker of the cable nor its anchor: labeled markers, ghosts."""
    if not example.points_m.size or not example.position_m.size:
        return example.points_m
    apart = np.abs(example.points_m[:, None, :] - example.position_m[None, :, :]).max(axis=2)
    taken = (apart <= 1e-6).any(axis=1) | (np.abs(example.points_m - example.anchor_m).max(axis=1) <= ANCHOR_ROOM_M)
    return np.asarray(example.points_m[~taken])


def _number(axes: Axes, places_mm: npt.NDArray[np.float32]) -> None:
    """Write each marker's index beside it, across the line through its neighbours so that the line stays clear."""
    step = max(1, -(-places_mm.shape[0] // LABELS_LIMIT))
    away = _across_line(places_mm.astype(float))
    for index, place in enumerate(places_mm):
        if index % step == 0 and np.isfinite(place).all():
            axes.annotate(
                str(index),
                (float(place[0]), float(place[1])),
                (9 * away[index, 0], 9 * away[index, 1]),
                textcoords="offset points",
                ha="center",
                va="center",
                fontsize=7.5,
                color="#222222",
                annotation_clip=True,
            )


def _across_line(places_mm: Floats) -> Floats:
    """Return for each place the unit vector across the line through its neighbours, upwards; up if there is none."""
    if places_mm.shape[0] < 2:
        return np.tile([0.0, 1.0], (places_mm.shape[0], 1))
    along = np.gradient(places_mm, axis=0)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = np.where(length > 0, across / np.where(length > 0, length, 1.0), [0.0, 1.0])
    across = np.where(np.isfinite(across), across, [0.0, 1.0])
    return np.asarray(across * np.where(across[:, 1:] < 0, -1.0, 1.0))


def _draw_curvature(axes: Axes, results: Results, example: ExampleFrame) -> None:
    arc_mm, limit_per_m = 1e3 * results.arc_length_m, 1e3 / results.config.cable.minimum_bend_radius_mm
    value = example.curvature_per_m.astype(float)
    band = 2 * np.nan_to_num(example.sigma_per_m.astype(float))
    axes.set_title("(c)  Curvature along the cable")
    axes.fill_between(
        arc_mm, np.maximum(value - band, 0), value + band, color=PALE, linewidth=0, label="± 2 standard deviations"
    )
    axes.plot(arc_mm, value, color=INK, linewidth=1.3, label="curvature")
    axes.plot(
        1e3 * results.marker_arc_length_m,
        np.zeros(results.marker_arc_length_m.size),
        "^",
        color=INK,
        markersize=4.5,
        clip_on=False,
        label="markers",
        zorder=4,
    )
    highest = float(np.nanmax(value + band)) if np.isfinite(value).any() else 0.0
    axes.set_ylim(0, 1.15 * _shown_height(highest, limit_per_m))
    axes.set_xlim(float(arc_mm.min(initial=0.0)), float(arc_mm.max(initial=1.0)))
    axes.set_xlabel("arc length from the anchor (mm)")
    axes.set_ylabel("curvature (1/m)")
    draw_limit(axes, limit_per_m)
    add_radius_axis(axes)
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1.0), ncols=3, borderaxespad=0.2)


def _shown_height(highest: float, limit_per_m: float) -> float:
    """Return the curvature that must be seen: the limit too, unless the cable is far from it."""
    return max(highest, limit_per_m) if limit_per_m < 4 * highest or highest <= 0 else highest
