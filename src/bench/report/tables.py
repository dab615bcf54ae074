"""The three Parquet tables and the summary. Written beside their names and renamed when complete; never over a file."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from bench.analysis import MarkerReason
from bench.errors import RecordingExistsError
from bench.model import Verdict
from bench.recording import rename_new
from bench.report.headline import find_tightest_bend
from bench.report.results import CycleColumns, Drift, DriftColumns, Results
from bench.report.writing import explain_write

__all__ = [
    "TABLE_FILES",
    "to_plain",
    "verify_folder_is_free",
    "write_markers",
    "write_summary",
    "write_tables",
    "write_then_rename",
]

TABLE_FILES = ("cycles.parquet", "markers.parquet", "curvature.parquet", "summary.json")
"""What `write_tables` leaves in the folder."""
ENDS_FILE = "ends.parquet"
"""And this one, where the cable's ends are known."""
DRIFT_FILE = "drift.parquet"
"""And this one, where there are cycles enough to see a change."""
ROWS_PER_GROUP = 20_000
"""Row groups hold whole cycles up to this many frames: a reader that wants one cycle reads 1 to 9 MB."""
ZSTD_LEVEL = 3
"""Level 9 saves 3 % more of the floats and takes five times as long."""

Array = npt.NDArray[Any]


def verify_folder_is_free(folder: Path, names: tuple[str, ...] = (*TABLE_FILES, ENDS_FILE, DRIFT_FILE)) -> None:
    """Raise `RecordingExistsError` if the folder holds any of the files that would be written."""
    taken = [name for name in names if (folder / name).exists()]
    if taken:
        raise RecordingExistsError(
            f"{folder} already holds {', '.join(taken)}.",
            hint="Nothing is overwritten: give another folder with --output, or delete them.",
        )


def write_tables(results: Results, folder: Path) -> list[Path]:
    """Write ``cycles.parquet``, ``markers.parquet``, ``curvature.parquet`` and ``summary.json``.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    RecordingExistsError
        One of the files exists: nothing is written then.
    RecordingError, DiskFullError
        The folder cannot be written.
    """
    writers: dict[str, Callable[[Path], None]] = {
        "cycles.parquet": lambda path: _write_columns(results, path, results.cycles),
        "markers.parquet": lambda path: write_markers(results, path),
        "curvature.parquet": lambda path: _write_frames(results, path, _curvature),
        "summary.json": lambda path: write_summary(results, path),
    }
    if results.ends is not None:
        writers[ENDS_FILE] = lambda path: _write_frames(results, path, _ends)
    if results.drift is not None:
        drift = results.drift.columns
        writers[DRIFT_FILE] = lambda path: _write_columns(results, path, drift)
    with explain_write(f"The tables cannot be written to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        verify_folder_is_free(folder)
        for name, write in writers.items():
            write_then_rename(folder / name, write)
    return [folder / name for name in writers]


def write_summary(results: Results, path: Path) -> None:
    """Write the numbers of the report's first page, with what is needed to repeat them, as JSON."""
    path.write_text(json.dumps(_summary(results), indent=2, ensure_ascii=False, allow_nan=False) + "\n", "utf-8")


def write_markers(results: Results, path: Path) -> None:
    """Write the sorted markers, one row for each tracker frame, as Parquet."""
    _write_frames(results, path, _markers)


def write_then_rename(path: Path, write: Callable[[Path], None]) -> None:
    """Let `write` make the file under another name, and give it its own when it is complete; never over a file."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        write(partial)
        rename_new(partial, path)
    except FileExistsError as error:
        raise RecordingExistsError(f"{path} appeared while it was written.", hint="Give another folder.") from error
    finally:
        partial.unlink(missing_ok=True)


def _write_columns(results: Results, path: Path, rows: CycleColumns | DriftColumns) -> None:
    columns = {field.name: getattr(rows, field.name) for field in fields(rows)}
    table = pa.table({name: _column(values) for name, values in columns.items()})
    with _open_writer(path, table.schema, results) as writer:
        writer.write_table(table)


def _column(values: Any) -> Any:
    return pa.array(values, type=pa.string()) if isinstance(values, list) else pa.array(values)


def _write_frames(results: Results, path: Path, make: Callable[[Results, slice], dict[str, Any]]) -> None:
    bounds = _row_groups(results.frames.cycle_index)
    first = pa.table(make(results, slice(0, 0)))
    with _open_writer(path, first.schema, results) as writer:
        for start, stop in bounds:
            writer.write_table(pa.table(make(results, slice(start, stop))), row_group_size=stop - start)


def _keys(results: Results, rows: slice) -> dict[str, Any]:
    frames = results.frames
    names = ("frame_number", "time_ns", "cycle_index", "cycle_phase")
    return {name: pa.array(getattr(frames, name)[rows]) for name in names}


def _markers(results: Results, rows: slice) -> dict[str, Any]:
    frames = results.frames
    return _keys(results, rows) | {
        "source": _lists(frames.source[rows]),
        "position_m": _lists(frames.position_m.reshape(len(frames.position_m), 3 * frames.source.shape[1])[rows]),
        "confidence": pa.array(frames.confidence[rows]),
        "marker_confidence": _lists(frames.marker_confidence[rows]),
        "reason": _lists(frames.reason[rows]),
    }


def _curvature(results: Results, rows: slice) -> dict[str, Any]:
    frames = results.frames
    return _keys(results, rows) | {
        "curvature_per_m": _lists(frames.curvature_per_m[rows]),
        "sigma_per_m": _lists(frames.sigma_per_m[rows]),
    }


def _ends(results: Results, rows: slice) -> dict[str, Any]:
    if results.ends is None:
        return {}
    columns = ((field.name, getattr(results.ends, field.name)[rows]) for field in fields(results.ends))
    return _keys(results, rows) | {
        name: _lists(values) if values.ndim == 2 else pa.array(values) for name, values in columns
    }


def _lists(values: Array) -> Any:
    return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(values).ravel()), values.shape[1])


def _row_groups(cycle_index: npt.NDArray[np.int64]) -> list[tuple[int, int]]:
    """Return (start, stop) of row groups that end where a cycle ends, as many cycles in each as fit."""
    n_rows = len(cycle_index)
    ends = np.append(np.flatnonzero(np.diff(cycle_index)) + 1, n_rows)
    groups, start = [], 0
    while start < n_rows:
        fitting = ends[(ends > start) & (ends <= start + ROWS_PER_GROUP)]
        stop = int(fitting[-1]) if len(fitting) else int(ends[ends > start][0])
        groups.append((start, stop))
        start = stop
    return groups


def _open_writer(path: Path, schema: Any, results: Results) -> Any:
    floats = [field.name for field in schema if pa.types.is_floating(field.type)]
    leaves = [f"{field.name}.list.element" for field in schema if _is_float_list(field.type)]
    metadata = {
        "arc_length_m": json.dumps(results.arc_length_m.tolist()),
        "marker_arc_length_m": json.dumps(results.marker_arc_length_m.tolist()),
        "methods": json.dumps(results.methods),
        "config_sha256": results.config_sha256,
        "run": results.run_path,
        "reasons": json.dumps({reason.value: reason.name.lower() for reason in MarkerReason}),
    }
    return pq.ParquetWriter(
        path,
        schema.with_metadata(metadata),
        compression="zstd",
        compression_level=ZSTD_LEVEL,
        use_byte_stream_split=floats + leaves,
        use_dictionary=False,
        write_statistics=[field.name for field in schema if not pa.types.is_fixed_size_list(field.type)],
    )


def _is_float_list(kind: Any) -> bool:
    return bool(pa.types.is_fixed_size_list(kind) and pa.types.is_floating(kind.value_type))


def _summary(results: Results) -> dict[str, Any]:
    cycles, frames = results.cycles, results.frames
    bend, calibration = find_tightest_bend(results), results.config.calibration.measured
    row = -1 if bend is None else cycles.cycle_index.tolist().index(bend.cycle_index)
    summary: dict[str, Any] = to_plain(
        {
            "run": results.run_path,
            "outcome": str(results.outcome),
            "outcome_reasons": results.outcome_reasons,
            "exit_status": results.exit_status,
            "exit_reason": results.exit_reason,
            "n_cycles": len(cycles.cycle_index),
            "cycles_by_verdict": {str(verdict): cycles.verdict.count(verdict) for verdict in Verdict},
            "n_frames": len(frames.frame_number),
            "complete_fraction": (frames.source >= 0).all(axis=1).mean() if len(frames.source) else math.nan,
            "minimum_bend_radius_limit_mm": results.config.cable.minimum_bend_radius_mm,
            "min_bend_radius_mm": cycles.min_bend_radius_mm[row] if row >= 0 else math.nan,
            "max_curvature_per_m": cycles.max_curvature_per_m[row] if row >= 0 else math.nan,
            "max_curvature_sigma_per_m": cycles.max_curvature_sigma_per_m[row] if row >= 0 else math.nan,
            "max_curvature_arc_length_m": cycles.max_curvature_arc_length_m[row] if row >= 0 else math.nan,
            "max_curvature_cycle_index": cycles.cycle_index[row] if row >= 0 else None,
            "streams": [asdict(stream) for stream in results.streams],
            "drift": _summarise_drift(results.drift) if results.drift else None,
            "calibration": calibration.model_dump(mode="json") if calibration else None,
            "clocks": [asdict(clock) for clock in results.clocks],
            "attention": {str(index): reasons for index, reasons in results.attention.items()},
            "warnings": results.warnings,
            "run_facts": results.run_facts,
            "methods": results.methods,
            "versions": results.versions,
            "config_sha256": results.config_sha256,
            "marker_arc_length_m": results.marker_arc_length_m,
            "arc_length_m": results.arc_length_m,
            "analysis_s": results.analysis_s,
        }
    )
    return summary


def _summarise_drift(drift: Drift) -> dict[str, Any]:
    return {
        "reference_cycle_index": drift.reference_cycle_index,
        "usual_shape_distance_mm": drift.usual_shape_distance_mm,
        "changes": [asdict(change) for change in drift.changes],
        "trends": [asdict(trend) for trend in drift.trends],
    }


def to_plain(value: Any) -> Any:
    """Return plain JSON data; a number that is not finite becomes null."""
    if isinstance(value, Mapping):
        return {str(key): to_plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [to_plain(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
