"""``accuracy.html``: the study, or what was measured on a recorded shape, with its figures and how to read them."""

from __future__ import annotations

from collections.abc import Sequence
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
from bench.report.accuracy.text import explain_skipped, say_percent_error, smallest_radius_mm, tabulate_study
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
MARKERS_ALONE, ROD = "menger_gp", "elastica"
"""What the analysis takes by itself: the second where places and directions of both clamps are known."""
FREE = ("unknown", "unused")
"""How a row is marked whose estimator was told nothing of the ends."""
TABLE = "one row for each estimator and case, with all figures"


def write_study_page(study: Study, versions: dict[str, str], folder: Path) -> Path:
    """Write ``accuracy.html``; raise as `bench.report.pages.write_page`."""
    tables = tabulate_study(study)
    rods = [subject for subject in study.subjects if subject.is_rod]
    subjects = [subject for subject in study.subjects if not subject.is_rod]
    pictures = [_subject_pictures(study, subject) for subject in subjects] + ([_rod_pictures(study)] if rods else [])
    context = {
        "keys": _keys(study),
        "paper": _say_paper(study),
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
    """Return what the methods in use err by: between the clamps, and where a cable is bent most, beside them."""
    rods = [subject for subject in study.subjects if subject.is_rod]
    picked = [_radius_key(study)]
    if rods:
        tightest = min(rods, key=smallest_radius_mm)
        picked += [
            _peak_key(study, tightest, MARKERS_ALONE, FREE, "Beside a clamp, markers alone"),
            _peak_key(study, tightest, ROD, ("known",), "Beside a clamp, clamps given"),
        ]
    return [key for key in picked if key]


def _radius_key(study: Study) -> dict[str, str]:
    row = study.find("circle", "noise", MARKERS_ALONE, FREE)
    if row is None or row.figures is None:
        return {}
    noise = f"{1e3 * study.conditions['noise'].noise_m:g} mm noise"
    value = say_percent_error(row.figures.max_radius_error)
    return {"name": "Circle, markers alone", "value": value, "about": f"largest error of the radius, {noise}"}


def _peak_key(study: Study, rod: Subject, estimator: str, ends: Sequence[str], name: str) -> dict[str, str]:
    row = study.find(rod.key, "noise", estimator, ends)
    if row is None or row.figures is None:
        return {}
    about = f"error of the largest curvature where the true smallest radius is {smallest_radius_mm(rod):.0f} mm"
    return {"name": name, "value": say_percent_error(row.figures.peak_bias), "about": about}


def _say_paper(study: Study) -> str:
    """Return how near the paper's own figures come out: they say that its method is the one measured here."""
    rows = [study.find(key, "ideal", SPLINE, FREE) for key in ("circle", "catenary")]
    figures = [row.figures for row in rows if row and row.figures]
    if len(figures) < 2:
        return ""
    circle, catenary = (say_number(100 * one.max_radius_error, 1) for one in figures)
    return (
        f"The paper's own figures come out again: its spline errs by up to {circle} % on the ideal circle (around "
        f"15 % in its Fig. 7) and {catenary} % on the ideal catenary (around 10 % in its Fig. 8)."
    )
