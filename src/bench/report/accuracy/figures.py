"""The study's figures, after the paper's Figs. 6 to 10: the shape, its bend radius along it, the radius' error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.analysis import ErrorFigures, interpolate_curve
from bench.report.accuracy.study import Study, Subject
from bench.report.accuracy.template import Template
from bench.report.accuracy.text import say_variant
from bench.report.figures.svg import INK, MUTED, WARNING_INK, drawing, new_figure, to_svg

__all__ = ["rods_figure", "subject_figure", "template_figure"]

Floats = npt.NDArray[np.float64]

COLOURS = (INK, WARNING_INK, "#2e7d4f", "#8a5200", "#6a4c93", "#00798c")
"""Of the estimators, in the order of the registry: told apart without colour vision by their lines, too."""
LINES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)))
MOST_ERROR = 60.0
"""Errors beyond this, in %, lie outside the picture: nobody needs to read them."""


@dataclass(frozen=True, eq=False)
class _Line:
    """What one estimator reads along the cable."""

    label: str
    figures: ErrorFigures
    style: int


def subject_figure(study: Study, subject: Subject, condition: str) -> str:
    """Draw one of the paper's shapes under one condition as SVG: Figs. 7 and 8 without errors, 9 and 10 with them."""
    lines = _lines(study, subject.key, condition)
    places, truth = subject.arc_length_m, subject.shape.curvature(subject.arc_length_m)
    markers = subject.shape.place(subject.marker_arc_length_m)
    curve = interpolate_curve(markers.astype(np.float32), subject.marker_arc_length_m, places)
    with drawing():
        figure = new_figure(3.3)
        left, middle, right = figure.subplots(1, 3, width_ratios=[1, 1.5, 1.5])
        _draw_shape(left, subject.shape.place(places), markers, curve)
        _draw_radius(middle, places, truth, lines, "(b)  Bend radius")
        _draw_error(right, places, truth, lines, "(c)  Its error")
        _name_lines(figure, middle)
        about = "Left: the curve with its markers. Middle: bend radius by arc length. Right: its error in per cent."
        return to_svg(figure, f"{subject.key}-{condition.replace(' ', '-')}", subject.title, about)


def rods_figure(study: Study) -> str:
    """Draw the curvature of the clamped cables by arc length, true and as each estimator reads it, as SVG."""
    rods = [subject for subject in study.subjects if subject.is_rod]
    with drawing():
        figure = new_figure(2.5 * ((len(rods) + 1) // 2) + 0.5)
        panels = figure.subplots((len(rods) + 1) // 2, 2, squeeze=False).ravel()
        for axes, subject in zip(panels, rods, strict=False):
            _draw_rod(axes, study, subject)
        for axes in panels[len(rods) :]:
            axes.set_axis_off()
        _name_lines(figure, panels[0])
        about = "For each bending stiffness the true curvature along the cable and what each estimator reads."
        return to_svg(figure, "rods", "Curvature of clamped cables", about)


def template_figure(template: Template) -> str:
    """Draw a recorded shape: the markers on it, the radius by arc length, its error; as SVG."""
    places, truth = template.results.arc_length_m, template.truth_per_m
    tried = [(one.estimator, one.figures) for one in template.estimators]
    lines = [_Line(name, figures, i) for i, (name, figures) in enumerate(tried) if figures is not None]
    curve, markers = template.drawn_m
    with drawing():
        figure = new_figure(3.3)
        left, middle, right = figure.subplots(1, 3, width_ratios=[1, 1.5, 1.5])
        _draw_shape(left, curve, markers, None)
        if truth.max() > 0:
            _draw_radius(middle, places, truth, lines, "(b)  Bend radius")
            _draw_error(right, places, truth, lines, "(c)  Its error")
        else:
            _draw_curvature(middle, places, truth, lines)
            middle.set_title("(b)  Curvature")
            right.set_axis_off()
        _name_lines(figure, middle)
        about = "Left: the shape with the markers' mean places. Middle: bend radius by arc length. Right: its error."
        return to_svg(figure, "template", "The recorded shape", about)


def _lines(study: Study, subject: str, condition: str) -> list[_Line]:
    rows = [(study.find(subject, condition, *variant), i) for i, variant in enumerate(study.variants)]
    return [_Line(say_variant(r.estimator, r.ends), r.figures, i) for r, i in rows if r and r.figures]


def _draw_shape(axes: Axes, shape_m: Floats, markers_m: Floats, curve_m: Floats | None) -> None:
    axes.plot(1e3 * shape_m[:, 0], 1e3 * shape_m[:, 1], color=MUTED, linewidth=3, alpha=0.4)
    if curve_m is not None:
        axes.plot(1e3 * curve_m[:, 0], 1e3 * curve_m[:, 1], color=INK, linewidth=0.9)
    axes.plot(1e3 * markers_m[:, 0], 1e3 * markers_m[:, 1], "o", color=INK, markersize=3.5)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(title="(a)  Markers", xlabel="x (mm)", ylabel="y (mm)")


def _draw_radius(axes: Axes, places: Floats, truth: Floats, lines: Sequence[_Line], title: str) -> None:
    _draw_all(axes, places, [(line, 1e3 * line.figures.radius_quantiles_m) for line in lines])
    axes.plot(1e3 * places, 1e3 / truth, color=MUTED, linewidth=3, alpha=0.4, label="truth", zorder=1)
    low, high = 1e3 / truth.max(), 1e3 / truth.min()
    margin = max(0.35 * low, 0.2 * (high - low))
    axes.set(title=title, ylabel="bend radius (mm)", ylim=(max(low - margin, 0.0), high + margin))


def _draw_error(axes: Axes, places: Floats, truth: Floats, lines: Sequence[_Line], title: str) -> None:
    errors = [100 * (line.figures.radius_quantiles_m * truth - 1) for line in lines]
    _draw_all(axes, places, list(zip(lines, errors, strict=True)))
    largest = max((float(np.nanmax(np.abs(error), initial=0.0)) for error in errors), default=1.0)
    axes.set(title=title, ylabel="error of the radius (%)")
    axes.set_ylim(-min(1.1 * largest, MOST_ERROR), min(1.1 * largest, MOST_ERROR))


def _draw_rod(axes: Axes, study: Study, subject: Subject) -> None:
    truth = subject.shape.curvature(subject.arc_length_m)
    _draw_curvature(axes, subject.arc_length_m, truth, _lines(study, subject.key, "noise"))
    axes.set(title=subject.title, ylim=(0, 1.08 * float(truth.max())))


def _draw_curvature(axes: Axes, places: Floats, truth: Floats, lines: Sequence[_Line]) -> None:
    _draw_all(axes, places, [(line, 1 / line.figures.radius_quantiles_m) for line in lines])
    axes.plot(1e3 * places, truth, color=MUTED, linewidth=3, alpha=0.4, label="truth", zorder=1)
    axes.set(ylabel="curvature (1/m)")


def _draw_all(axes: Axes, places: Floats, drawn: Sequence[tuple[_Line, Floats]]) -> None:
    """Draw for each estimator its median over the frames, and the band that holds nine frames of ten."""
    for line, (low, middle, high) in drawn:
        colour, dashes = COLOURS[line.style % len(COLOURS)], LINES[line.style % len(LINES)]
        axes.fill_between(1e3 * places, low, high, color=colour, alpha=0.15, linewidth=0)
        axes.plot(1e3 * places, middle, linewidth=1.2, label=line.label, color=colour, linestyle=dashes)
    axes.set_xlabel("arc length (mm)")
    axes.set_xlim(1e3 * places[0], 1e3 * places[-1])


def _name_lines(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 6))
