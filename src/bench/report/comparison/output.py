"""A comparison as files: a page, a table, a summary."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
from markupsafe import Markup

from bench.report.comparison.compare import Comparison
from bench.report.comparison.figures import difference_figure, motions_figure
from bench.report.comparison.text import describe_comparison, find_largest
from bench.report.pages import render_page, write_page
from bench.report.tables import to_plain, write_then_rename
from bench.report.writing import explain_write

__all__ = ["COMPARISON_FILES", "write_comparison"]

Floats = npt.NDArray[np.float64]

COMPARISON_FILES = ("comparison.html", "difference.parquet", "summary.json")


def write_comparison(found: Comparison, folder: Path) -> Path:
    """Write ``difference.parquet``, ``summary.json`` and ``comparison.html``; return the page.

    Raises
    ------
    RecordingExistsError
        One of the files exists.
    RecordingError, DiskFullError
        The folder cannot be written.
    """
    page = render_page("comparison.html.j2", _context(found))
    plain = json.dumps(to_plain(_summary(found)), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with explain_write(f"The comparison cannot be written to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        write_then_rename(folder / "difference.parquet", lambda path: _write_table(path, found))
        write_then_rename(folder / "summary.json", lambda path: _write_text(path, plain))
    return write_page(folder / "comparison.html", page)


def _write_table(path: Path, found: Comparison) -> None:
    n_phases, n_places = found.difference.distance_m.shape
    columns = {
        "cycle_phase": pa.array(np.repeat(found.cycle_phase, n_places)),
        "arc_length_m": pa.array(np.tile(found.arc_length_m, n_phases)),
        "first_position_m": pa.FixedSizeListArray.from_arrays(_single(found.first_m), 3),
        "second_position_m": pa.FixedSizeListArray.from_arrays(_single(found.second_m), 3),
        "distance_m": _single(found.difference.distance_m),
    }
    pq.write_table(pa.table(columns), path, compression="zstd")


def _single(values: Floats) -> Any:
    return pa.array(values.ravel().astype(np.float32))


def _summary(found: Comparison) -> dict[str, Any]:
    phase, place = find_largest(found)
    difference, moved = found.difference, found.moved
    return {
        "first": found.first.run_path,
        "second": found.second_name,
        "e_mm": 1e3 * difference.e_m,
        "e2_m2": difference.e2_m2,
        "coordinate_rms_mm": 1e3 * difference.coordinate_m,
        "largest_mm": 1e3 * float(difference.distance_m[phase, place]),
        "largest_cycle_phase": float(found.cycle_phase[phase]),
        "largest_arc_length_m": float(found.arc_length_m[place]),
        "compared_fraction": difference.compared,
        "late_phase": found.late,
        "late_s": found.late_s,
        "rotation": moved.rotation if moved else None,
        "shift_m": moved.shift_m if moved else None,
        "notes": found.notes,
        "methods": found.first.methods,
        "versions": found.first.versions,
    }


def _context(found: Comparison) -> dict[str, Any]:
    return {
        "first": found.first.run_path,
        "second": found.second_name,
        "e": 1e3 * found.difference.e_m,
        "lines": describe_comparison(found),
        "notes": found.notes,
        "motions": Markup(motions_figure(found)),  # noqa: S704 - SVG of our own making
        "difference": Markup(difference_figure(found)),  # noqa: S704 - SVG of our own making
        "versions": found.first.versions,
        "files": {
            "difference.parquet": "one row for each phase and place: both positions and their distance",
            "summary.json": "the numbers of this page",
        },
    }


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, "utf-8")
