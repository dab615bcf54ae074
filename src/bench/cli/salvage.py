"""``bench salvage``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.cli.settings import verify_run_name
from bench.errors import ConfigError, RecordingError, RecordingUnfinishedError

if TYPE_CHECKING:
    from bench.recording import Salvaged

__all__ = ["salvage"]

COMPLETE, NOTHING, LOSSY = 0, 1, 3
"""Exit codes, those of the MCAP project's own `mcap recover`."""


def salvage(
    run: Annotated[Path, typer.Argument(metavar="RUN.mcap", help="Unfinished or damaged recording; .mcap.active too.")],
    output: Annotated[
        Path | None, typer.Option("--output", metavar="GOOD.mcap", help="New file to write. Never overwritten.")
    ] = None,
    in_place: Annotated[
        bool,
        typer.Option("--in-place", help="Finish the file itself instead; RUN.mcap.active becomes RUN.mcap."),
    ] = False,
) -> None:
    """Rebuild an unfinished or damaged recording, and say what was lost.

    A run that was split by size is named by its first part: --in-place finishes every part that needs it, --output
    puts all parts into one file. A later part that is named is salvaged alone.

    Exit code 0: everything that stood in the file was kept. 3: something of it was lost. 1: nothing can be kept.
    """
    if (output is None) != in_place:
        raise ConfigError(
            "Say where the salvaged recording goes: --output GOOD.mcap, or --in-place.",
            hint="A copy leaves the old file as it is.",
        )
    verify_run_name(output)
    from bench.recording import salvage_copy, salvage_in_place
    from bench.run.journal import is_held

    if is_held(run):
        raise RecordingError(f"{run} is being written by a bench that still runs.", hint="Let it finish.")
    try:
        salvaged = salvage_in_place(run) if output is None else salvage_copy(run, output)
    except RecordingUnfinishedError as error:
        print(f"error: {error}", file=sys.stderr)
        raise typer.Exit(NOTHING) from error
    _print_salvaged(salvaged, run)
    raise typer.Exit(LOSSY if salvaged.lost else COMPLETE)


def _print_salvaged(salvaged: Salvaged, run: Path) -> None:
    if salvaged.was_complete:
        print(f"{run} has its end and no damage: there was nothing to salvage.")
    counts = ", ".join(f"{n} of {topic}" for topic, n in sorted(salvaged.topics.items()))
    print(f"{salvaged.path}: {sum(salvaged.topics.values())} messages: {counts}.")
    for text in salvaged.lost:
        print(f"lost: {text}")
    if not salvaged.is_closed:
        print("The recording broke off: about the last second before that never reached the file.")
    print(f"Next: bench report {salvaged.path}")
