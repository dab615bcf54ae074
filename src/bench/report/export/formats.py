"""Which format is written by what; never over a file."""

from __future__ import annotations

from pathlib import Path

from bench.errors import RecordingExistsError
from bench.recording import Run
from bench.report.export.c3d_file import write_c3d
from bench.report.export.kinds import ExportFormat
from bench.report.export.markers import collect_markers
from bench.report.export.tables import write_csv, write_trc
from bench.report.results import Results
from bench.report.tables import write_markers, write_then_rename
from bench.report.writing import explain_write, in_system_words

__all__ = ["export_markers"]

_GRID_WRITERS = {ExportFormat.CSV: write_csv, ExportFormat.C3D: write_c3d, ExportFormat.TRC: write_trc}


def export_markers(run: Run, results: Results, kind: ExportFormat, path: Path) -> None:
    """Write the sorted markers of an analysed run.

    CSV, C3D and TRC have one row for each period of the tracker, from the first frame to the last, in millimetres; a
    marker that was not found, and every marker of a frame that never came, is a gap as the format has it. Parquet is
    the table ``markers.parquet`` of the report.

    Raises
    ------
    AnalysisError
        No marker was sorted, or the frames are on no grid.
    RecordingExistsError
        `path` exists; it is not touched.
    RecordingError, DiskFullError
        It cannot be written.
    """
    if path.exists():
        raise RecordingExistsError(f"{path} exists already and is not overwritten.", hint="Choose another --output.")
    with explain_write(f"{path} cannot be written", in_system_words):
        if kind is ExportFormat.PARQUET:
            write_then_rename(path, lambda partial: write_markers(results, partial))
        else:
            markers, write = collect_markers(run, results), _GRID_WRITERS[kind]
            write_then_rename(path, lambda partial: write(markers, partial))
