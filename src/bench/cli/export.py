"""``bench export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.cli.report import name_without_suffix, with_limits
from bench.config import load_config
from bench.report.export import ExportFormat

__all__ = ["export"]


def export(
    run: Annotated[Path, typer.Argument(metavar="RUN.mcap", help="Run file, of a run or of an import.")],
    format_: Annotated[ExportFormat, typer.Option("--format", help="What to write.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="FILE", help="File to write, never overwritten. Left out: RUN.FORMAT."),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", help="Take \\[analysis] and the cable's limits from here, not from the recording."),
    ] = None,
) -> None:
    """Write the sorted markers of a run file for other programs: M1, M2, … from the anchor along the cable."""
    target = output or run.with_name(f"{name_without_suffix(run)}.{format_}")
    settings = load_config(config) if config else None
    from bench.recording import open_run
    from bench.report.export.formats import export_markers
    from bench.report.pipeline import analyse_run

    recording = open_run(run)
    settings_used = with_limits(recording.config, settings, run) if settings else recording.config
    results = analyse_run(recording, settings_used, run_path=run.name)
    export_markers(recording, results, format_, target)
    found = (results.frames.source >= 0).mean() if results.frames.source.size else 0.0
    n_frames, n_markers = results.frames.source.shape
    print(f"{target}: {n_markers} markers in {n_frames} frames, {found:.1%} of the positions found.")
