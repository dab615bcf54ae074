"""The study's figures as files: one table and a summary."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.analysis import ErrorFigures
from bench.report.accuracy.study import N_FRAMES, TURN_RAD, Study
from bench.report.accuracy.template import Template
from bench.report.accuracy.template_text import explain_unmeasured
from bench.report.accuracy.text import explain_skipped
from bench.report.tables import to_plain, write_then_rename
from bench.report.writing import explain_write

__all__ = ["ACCURACY_FILES", "write_study_tables", "write_template_tables"]

ACCURACY_FILES = ("accuracy.parquet", "summary.json")
FIGURES = [field.name for field in fields(ErrorFigures) if field.name != "radius_quantiles_m"]


def write_study_tables(study: Study, versions: dict[str, str], folder: Path) -> list[Path]:
    """Write one row for each case and estimator as ``accuracy.parquet``, and ``summary.json``.

    Raises
    ------
    RecordingExistsError
        One of the files exists.
    RecordingError, DiskFullError
        The folder cannot be written.
    """
    rows = [
        {
            "shape": row.subject,
            "condition": row.condition,
            "noise_mm": 1e3 * study.conditions[row.condition].noise_m,
            "placement_mm": 1e3 * study.conditions[row.condition].placement_m,
            "n_hidden": study.conditions[row.condition].n_hidden,
            "estimator": row.estimator,
            "ends": row.ends,
            "n_frames": row.n_frames,
            **_figures(row.figures),
            "skipped": row.skipped,
        }
        for row in study.rows
    ]
    shapes = {
        subject.key: {
            "title": subject.title,
            "shape": subject.shape.name,
            "marker_arc_length_m": subject.marker_arc_length_m,
            "smallest_radius_mm": 1e3 / float(subject.shape.curvature(subject.arc_length_m).max()),
        }
        for subject in study.subjects
    }
    summary = {
        "shapes": shapes,
        "conditions": {name: asdict(condition) for name, condition in study.conditions.items()},
        "frames_per_case": N_FRAMES,
        "end_direction_sd_deg": float(np.rad2deg(TURN_RAD)),
        "skipped": explain_skipped(study),
        "versions": versions,
        "seconds": study.seconds,
    }
    return _write(folder, rows, summary)


def write_template_tables(template: Template, folder: Path) -> list[Path]:
    """Write one row for each estimator as ``accuracy.parquet``, and ``summary.json``. Errors as for the study's."""
    results = template.results
    rows = [
        {
            "shape": template.shape.name,
            "estimator": one.estimator,
            "ends": "unknown",
            "n_frames": template.n_frames,
            **_figures(one.figures),
            "skipped": one.skipped,
        }
        for one in template.estimators
    ]
    summary = {
        "run": results.run_path,
        "shape": template.shape.name,
        "own_size_mm": 1e3 * template.own_size_m,
        "offset_m": template.fit.offset_m,
        "n_complete": template.n_complete,
        "n_frames": template.n_frames,
        "distance_rms_mm": 1e3 * float(np.median(template.frame_rms_m)),
        "distance_max_mm": 1e3 * float(np.median(template.frame_max_m)),
        "noise_mm": 1e3 * template.noise_m,
        "marker_arc_length_m": results.marker_arc_length_m,
        "placement_mm": 1e3 * template.placement_m,
        "marker_distance_mm": 1e3 * template.fit.distance_m,
        "marker_noise_mm": 1e3 * template.marker_noise_m,
        "skipped": explain_unmeasured(template),
        "methods": results.methods,
        "versions": results.versions,
        "config_sha256": results.config_sha256,
    }
    return _write(folder, rows, summary)


def _figures(figures: ErrorFigures | None) -> dict[str, float]:
    return {name: getattr(figures, name) if figures else np.nan for name in FIGURES}


def _write(folder: Path, rows: Sequence[dict[str, Any]], summary: dict[str, Any]) -> list[Path]:
    table, text = folder / ACCURACY_FILES[0], folder / ACCURACY_FILES[1]
    plain = json.dumps(to_plain(summary), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with explain_write(f"The tables cannot be written to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        write_then_rename(table, lambda path: pq.write_table(pa.Table.from_pylist(list(rows)), path))
        write_then_rename(text, lambda path: _write_text(path, plain))
    return [table, text]


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, "utf-8")
