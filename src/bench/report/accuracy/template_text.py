"""What was measured on a recorded shape, in words and tables."""

from __future__ import annotations

import numpy as np

from bench.analysis import ErrorFigures
from bench.report.accuracy.template import MeasuredOn, Template
from bench.report.accuracy.text import TextTable, say_peak, say_radius_error
from bench.report.wording import say_count, say_mm, say_number, say_percent

__all__ = ["describe_template", "explain_unmeasured", "judge_noise", "tabulate_template"]

CURVATURE_CAPTION = (
    "Radius: largest / rms error along the cable, median over the frames. Largest curvature: mean error ± standard "
    "deviation, and the frames, in %, whose own interval of ± 2 standard deviations holds it. Tightest: radius that "
    "5 % of the frames go below somewhere. Scatter: over the frames, as a share of the standard deviation that the "
    "estimator gives; inside: values within two of them."
)
NOISE_RATIO = 1.5
"""Measured and configured noise that differ by more than this make the report's intervals too narrow or too wide."""


def describe_template(template: Template) -> dict[str, str]:
    """Return what was found about the set-up, by name."""
    lines = {
        "Shape": template.shape.name,
        "Frames": f"{say_count(template.n_frames)} measured, {say_count(template.n_complete)} of "
        f"{say_count(len(template.results.frames.frame_number))} complete",
        "Distance from the shape": f"rms {_mm(np.median(template.frame_rms_m))}, largest "
        f"{_mm(np.median(template.frame_max_m))} (median over the frames); of the markers' mean places rms "
        f"{_mm(template.fit.rms_m)}",
        "Noise of a marker": f"{_mm(template.noise_m, 3)} in each coordinate, standard deviation over the frames",
        "Placement": f"rms {_mm(np.sqrt(np.mean(template.placement_m**2)))}, largest "
        f"{_mm(np.abs(template.placement_m).max())} along the cable",
    }
    if np.isfinite(template.own_size_m):
        lines["Size by the markers"] = f"{say_number(1e3 * template.own_size_m, 2)} mm fits them best"
    return lines


def judge_noise(template: Template) -> str:
    """Return what to do where the configured noise is not the measured one, else an empty text."""
    told_mm, found_mm = template.results.config.analysis.marker_noise_mm, 1e3 * template.noise_m
    if template.n_frames < 2 or told_mm / NOISE_RATIO <= found_mm <= told_mm * NOISE_RATIO:
        return ""
    return (
        f"[analysis] marker_noise_mm is {told_mm:g}, but {found_mm:.3g} was measured here. Markers in motion are "
        "noisier than at rest; if this was recorded in motion, take the measured one."
    )


def tabulate_template(template: Template) -> list[TextTable]:
    """Return one table of the markers and one of the estimators."""
    arc_mm = 1e3 * template.results.marker_arc_length_m
    columns = (arc_mm, 1e3 * template.placement_m, 1e3 * template.fit.distance_m, 1e3 * template.marker_noise_m)
    markers = [
        [str(i), say_number(arc, 1), _signed(placed), say_number(distance, 2), say_number(noise, 3)]
        for i, (arc, placed, distance, noise) in enumerate(zip(*columns, strict=True))
    ]
    return [
        TextTable(
            "Curvature",
            CURVATURE_CAPTION,
            ["estimator", "radius %", "largest curvature %", "tightest mm", "scatter", "inside"],
            [_estimator_row(one, one.figures) for one in template.estimators if one.figures],
        ),
        TextTable(
            "Markers",
            "Along: beside the configured place, less what all have in common. Off: of the mean place, from the shape.",
            ["marker", "at mm", "along mm", "off mm", "noise mm"],
            markers,
        ),
    ]


def explain_unmeasured(template: Template) -> list[str]:
    """Return why an estimator gave nothing."""
    return [f"{one.estimator}: {one.skipped}" for one in template.estimators if one.skipped]


def _estimator_row(one: MeasuredOn, figures: ErrorFigures) -> list[str]:
    tightest_mm = 1e3 * float(np.nanmin(figures.radius_quantiles_m[0]))
    return [
        one.estimator,
        say_radius_error(figures),
        say_peak(figures),
        say_mm(tightest_mm),
        say_number(figures.scatter, 2),
        say_percent(figures.inside_band),
    ]


def _mm(value_m: float, digits: int = 2) -> str:
    return f"{say_number(1e3 * float(value_m), digits)} mm"


def _signed(value_mm: float) -> str:
    rounded = round(value_mm, 2) + 0.0  # no minus before a zero
    return f"{'+' if rounded > 0 else ''}{say_number(rounded, 2)}"
