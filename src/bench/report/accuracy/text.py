"""The study's figures as tables of words: for the terminal and for the page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bench.analysis import Condition, ErrorFigures
from bench.report.accuracy.study import Study, StudyRow, Subject
from bench.report.wording import say_number

__all__ = [
    "TextTable",
    "explain_skipped",
    "say_peak",
    "say_percent_error",
    "say_radius_error",
    "say_variant",
    "smallest_radius_mm",
    "tabulate_study",
]

MISSING = "–"
Variant = tuple[str, str]


@dataclass(frozen=True)
class TextTable:
    """A table in words."""

    title: str
    caption: str
    columns: list[str]
    rows: list[list[str]]
    """The first cell of each is its name."""


def smallest_radius_mm(subject: Subject) -> float:
    """Return the true smallest bend radius of a shape."""
    return 1e3 / float(subject.shape.curvature(subject.arc_length_m).max())


def say_variant(estimator: str, ends: str) -> str:
    """Return an estimator's name with what it knows."""
    return f"{estimator} + ends" if ends == "known" else estimator


def tabulate_study(study: Study) -> list[TextTable]:
    """Return one table for each of the paper's shapes, and one for the clamped rods."""
    rods = [subject for subject in study.subjects if subject.is_rod]
    tables = [_tabulate_shape(study, subject) for subject in study.subjects if not subject.is_rod]
    return [*tables, _tabulate_rods(study, rods)] if rods else tables


def explain_skipped(study: Study) -> list[str]:
    """Return a sentence for each estimator and reason why it gave nothing somewhere."""
    where: dict[tuple[str, str], list[str]] = {}
    for row in study.rows:
        if row.skipped:
            known = "with known ends" if row.ends == "known" else "without known ends"
            where.setdefault((f"{row.estimator} {known}", row.skipped), []).append(row.subject)
    return [f"{who} ({', '.join(dict.fromkeys(keys))}): {why}" for (who, why), keys in where.items()]


def _tabulate_shape(study: Study, subject: Subject) -> TextTable:
    names = subject.conditions
    rows = _rows(study, lambda variant: [study.find(subject.key, name, *variant) for name in names], say_radius_error)
    return TextTable(
        subject.title,
        "Error of the bend radius along the curve in %: largest / root mean square. Median over the frames.",
        ["estimator", *(_say_condition(study.conditions[name]) for name in names)],
        rows,
    )


def _tabulate_rods(study: Study, rods: Sequence[Subject]) -> TextTable:
    names = [f"{rod.shape.name}, R {smallest_radius_mm(rod):.0f} mm" for rod in rods]
    rows = _rows(study, lambda variant: [study.find(rod.key, "noise", *variant) for rod in rods], say_peak)
    return TextTable(
        "Cables clamped at both ends",
        "Error of the largest curvature in %: mean ± standard deviation over the frames; then the frames, in %, whose "
        "own interval of ± 2 standard deviations holds it. R: true smallest radius.",
        ["estimator", *names],
        rows,
    )


def _rows(
    study: Study, find: Callable[[Variant], list[StudyRow | None]], say: Callable[[ErrorFigures], str]
) -> list[list[str]]:
    """Return a row for each estimator that gave something."""
    rows = []
    for variant in study.variants:
        figures = [row.figures if row else None for row in find(variant)]
        if any(figures):
            rows.append([say_variant(*variant), *(say(one) if one else MISSING for one in figures)])
    return rows


def _say_condition(condition: Condition) -> str:
    if not condition.noise_m:
        return "ideal"
    parts = [f"{condition.noise_m * 1e3:g} mm"]
    if condition.placement_m:
        parts.append(f"{condition.placement_m * 1e3:g} mm placement")
    if condition.n_hidden:
        parts.append(f"{condition.n_hidden} hidden")
    return ", ".join(parts)


def say_radius_error(figures: ErrorFigures) -> str:
    """Return largest and rms error of the radius, %."""
    return f"{say_percent_error(figures.max_radius_error)} / {say_percent_error(figures.rms_radius_error)}"


def say_peak(figures: ErrorFigures) -> str:
    """Return the error of the largest curvature, %: mean and standard deviation; and the share inside its band, %."""
    sign = "+" if figures.peak_bias > 0 else ""
    error = f"{sign}{say_percent_error(figures.peak_bias)} ± {say_percent_error(figures.peak_sd)}"
    return f"{error}, {100 * figures.peak_inside_band:.0f}"


def say_percent_error(share: float) -> str:
    """Return an error given as a share in %, with two or three figures, without the unit."""
    value = 100 * share
    return say_number(value, 0 if abs(value) >= 100 and np.isfinite(value) else 1 if abs(value) >= 1 else 2)
