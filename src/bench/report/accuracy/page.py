"""``accuracy.html``: the study, or what was measured on a recorded shape, with its figures and how to read them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from bench.report.accuracy.figures import rods_figure, subject_figure, template_figure
from bench.report.accuracy.study import HIGH_NOISE_M, N_FRAMES, PLACEMENT_M, TURN_RAD, Study, Subject
from bench.report.accuracy.template import Template
from bench.report.accuracy.template_text import (
    describe_template,
    explain_unmeasured,
    judge_noise,
    tabulate_template,
)
from bench.report.accuracy.text import explain_skipped, tabulate_study
from bench.report.pages import render_page, write_page
from bench.report.wording import say_number

__all__ = ["ACCURACY_PAGE", "write_study_page", "write_template_page"]

ACCURACY_PAGE = "accuracy.html"
PICTURES = {
    "ideal": "As the paper's Figs. 6 to 8: without errors, so that the error is the estimator's own.",
    "placement": "As the paper's Figs. 9 and 10: tracked, with noise and with markers beside their places. Lines: "
    "median over the frames; bands: nine frames of ten.",
}
SPLINE = "spline"
TABLE = "one row for each estimator and case, with all figures"


def write_study_page(study: Study, versions: dict[str, str], folder: Path) -> Path:
    """Write ``accuracy.html``; raise as `bench.report.pages.write_page`."""
    tables = tabulate_study(study)
    rods = [subject for subject in study.subjects if subject.is_rod]
    subjects = [subject for subject in study.subjects if not subject.is_rod]
    pictures = [_subject_pictures(study, subject) for subject in subjects] + ([_rod_pictures(study)] if rods else [])
    context = {
        "keys": _keys(study),
        "noise": f"{1e3 * study.conditions['noise'].noise_m:g}",
        "high_noise": f"{1e3 * HIGH_NOISE_M:g}",
        "placement": f"{1e3 * PLACEMENT_M:g}",
        "n_frames": N_FRAMES,
        "turn": f"{np.rad2deg(TURN_RAD):g}",
        "shapes": list(zip(tables, pictures, strict=True)),
        "skipped": explain_skipped(study),
        "versions": versions,
        "files": {"accuracy.parquet": TABLE, "summary.json": "shapes, conditions, versions"},
    }
    return write_page(folder / ACCURACY_PAGE, render_page("accuracy.html.j2", context))


def write_template_page(template: Template, folder: Path) -> Path:
    """Write ``accuracy.html``; raise as `bench.report.pages.write_page`."""
    results = template.results
    context = {
        "run": results.run_path,
        "shape": template.shape.name,
        "warnings": [*filter(None, [judge_noise(template)]), *results.warnings, *explain_unmeasured(template)],
        "lines": describe_template(template),
        "figure": Markup(template_figure(template)),  # noqa: S704 - SVG of our own making
        "tables": tabulate_template(template),
        "versions": results.versions,
        "files": {"accuracy.parquet": TABLE, "summary.json": "the fit, each marker's errors, versions"},
    }
    return write_page(folder / ACCURACY_PAGE, render_page("known_shape.html.j2", context))


def _subject_pictures(study: Study, subject: Subject) -> list[dict[str, Any]]:
    return [
        _picture(subject_figure(study, subject, condition), f"{subject.key.capitalize()}, {name}.", PICTURES[condition])
        for condition, name in (("ideal", "ideal"), ("placement", "tracked"))
    ]


def _rod_pictures(study: Study) -> list[dict[str, Any]]:
    caption = (
        "Curvature along the cable. Beside a clamp a cable is bent over a length that may be shorter than the "
        "distance between markers; what is not seen there must come from elsewhere: the clamp's direction, or how a "
        "cable bends."
    )
    return [_picture(rods_figure(study), "Clamped cables.", caption)]


def _picture(svg: str, name: str, caption: str) -> dict[str, Any]:
    return {"svg": Markup(svg), "name": name, "caption": caption}  # noqa: S704 - SVG of our own making


def _keys(study: Study) -> list[dict[str, str]]:
    """Return the paper's own two figures first: they say that its method is the one measured here."""
    keys = []
    for key, paper in (("circle", "around 15 % in the paper's Fig. 7"), ("catenary", "around 10 % in its Fig. 8")):
        row = next((r for r in study.rows if (r.subject, r.condition, r.estimator) == (key, "ideal", SPLINE)), None)
        if row and row.figures:
            value = say_number(100 * row.figures.max_radius_error, 1)
            keys.append({"name": f"Paper's spline, {key}, ideal", "value": value, "about": paper})
    return keys
