"""``bench export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.cli.report import name_without_suffix
from bench.cli.settings import settings_or_none, with_limits
from bench.errors import ConfigError
from bench.report.export import ExportFormat

__all__ = ["export"]


def export(
    run: Annotated[Path, typer.Argument(metavar="RUN.mcap", help="Run file, of a run or of an import.")],
    format_: Annotated[ExportFormat, typer.Option("--format", help="What to write.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            metavar="FILE",
            help="File to write, never overwritten. Left out: RUN.FORMAT. With --topic a folder; left out: RUN.topics.",
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", help="Take \\[analysis] and the cable's limits from here, not from the recording."),
    ] = None,
    topics: Annotated[
        list[str] | None,
        typer.Option(
            "--topic",
            metavar="TOPIC",
            help="Write this topic as it was recorded, not the sorted markers; may be repeated; all: every topic that "
            "has messages. With --format parquet.",
        ),
    ] = None,
) -> None:
    """Write the sorted markers of a run file for other programs: M1, M2, … from the anchor along the cable.

    With --topic, what was recorded instead: a Parquet file for each topic.
    """
    if topics:
        if format_ is not ExportFormat.PARQUET or config is not None:
            raise ConfigError("--topic goes with --format parquet, and not with --config: nothing is analysed.")
        _export_topics(run, topics, output or run.with_name(f"{name_without_suffix(run)}.topics"))
        return
    target = output or run.with_name(f"{name_without_suffix(run)}.{format_}")
    settings = settings_or_none(config)
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


def _export_topics(path: Path, topics: list[str], folder: Path) -> None:
    from bench.recording import open_run
    from bench.report.export.topics import export_topics

    run = open_run(path)
    rows = export_topics(run, run.topics if "all" in topics else topics, folder)
    for table, n_rows in rows.items():
        print(f"{table}: {n_rows} rows.")
    if not run.status.complete:
        print(run.status)
