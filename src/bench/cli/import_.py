"""``bench import``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.cli.settings import verify_run_name

if TYPE_CHECKING:
    from rich.progress import TaskID

    from bench.run.import_take import ImportSummary

__all__ = ["import_"]


def import_(
    take: Annotated[
        Path, typer.Argument(metavar="TAKE", help="Motive or Tracking Tools CSV export, C3D, TRC, or bench's Parquet.")
    ],
    config: Annotated[Path, typer.Option("--config", help="Configuration with the \\[cable] to analyse it for.")],
    output: Annotated[Path, typer.Option("--output", help="Run file to write. Never overwritten.")],
) -> None:
    """Turn a tracker's own recording into a run file, for `bench report`."""
    from bench.config import load_config, to_toml

    verify_run_name(output)
    settings = load_config(config)
    from bench.run.import_take import import_take
    from bench.timing import RunClock

    with _progress_bar() as tell:
        summary = import_take(take, settings, to_toml(settings), output, RunClock.start(), tell)
    _print_summary(take, summary)


@contextmanager
def _progress_bar() -> Iterator[Callable[[str, float], None]]:
    """Show a bar for each step of the work, on a terminal and nowhere else."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        tasks: dict[str, TaskID] = {}

        def tell(step: str, share: float) -> None:
            if step not in tasks:
                tasks[step] = bar.add_task(step, total=1.0)
            bar.update(tasks[step], completed=share)

        yield tell


def _print_summary(take: Path, summary: ImportSummary) -> None:
    info = summary.info
    least, most = summary.points_min, summary.points_max
    points = f"{least} points" if least == most else f"{least} to {most} points"
    for text in summary.warnings:
        print(f"warning: {text}", file=sys.stderr)
    print(
        f"{take.name} ({info.format} {info.version}".rstrip() + f"): {summary.n_frames} frames at {info.rate_hz:g} Hz, "
        f"{points} in each."
    )
    print(f"{summary.path}: {summary.bytes_written / 1e6:.1f} MB.")
    print(f"Next: bench report {summary.path}")
