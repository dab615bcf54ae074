"""``bench import``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.config import load_config, to_toml

if TYPE_CHECKING:
    from bench.run.import_take import ImportSummary

__all__ = ["import_"]


def import_(
    take: Annotated[Path, typer.Argument(metavar="TAKE", help="Motive or Tracking Tools CSV export, or C3D file.")],
    config: Annotated[Path, typer.Option("--config", help="Configuration with the [cable] to analyse it for.")],
    output: Annotated[Path, typer.Option("--output", help="Run file to write. Never overwritten.")],
) -> None:
    """Turn a tracker's own recording into a run file, for `bench report`."""
    settings = load_config(config)
    from bench.run.import_take import import_take
    from bench.timing import RunClock

    summary = import_take(take, settings, to_toml(settings), output, RunClock.start())
    _print_summary(take, summary)


def _print_summary(take: Path, summary: ImportSummary) -> None:
    info = summary.info
    least, most = info.points_min, info.points_max
    points = f"{least} points" if least == most else f"{least} to {most} points"
    for text in summary.warnings:
        print(f"warning: {text}", file=sys.stderr)
    print(
        f"{take.name} ({info.format} {info.version}".rstrip() + f"): {summary.n_frames} frames at {info.rate_hz:g} Hz, "
        f"{points} in each."
    )
    print(f"{summary.path}: {summary.bytes_written / 1e6:.1f} MB.")
    print(f"Next: bench report {summary.path}")
