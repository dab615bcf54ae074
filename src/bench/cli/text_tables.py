"""What the commands that make a folder of results share: its check beforehand, and tables on the screen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import RecordingExistsError

if TYPE_CHECKING:
    from bench.report.accuracy import TextTable

__all__ = ["show_tables", "verify_folder"]

PLAIN_WIDTH = 140
"""Columns where there is no terminal: a file has no edge, and a wrapped table cannot be searched."""


def show_tables(tables: Sequence[TextTable]) -> None:
    """Print tables, the first column to the left, the others to the right."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    if not console.is_terminal:
        console = Console(width=PLAIN_WIDTH)
    for table in tables:
        drawn = Table(title=table.title, caption=table.caption, title_justify="left", caption_justify="left")
        for number, name in enumerate(table.columns):
            drawn.add_column(name, justify="right" if number else "left", no_wrap=not number)
        for row in table.rows:
            drawn.add_row(*row)
        console.print(drawn)


def verify_folder(folder: Path, names: tuple[str, ...]) -> None:
    """Raise `RecordingExistsError` where results would be written over others, before anything is calculated."""
    from bench.report.tables import verify_folder_is_free

    if folder.exists() and not folder.is_dir():
        raise RecordingExistsError(f"{folder} is a file, not a folder.", hint="Choose another --output.")
    verify_folder_is_free(folder, names)
