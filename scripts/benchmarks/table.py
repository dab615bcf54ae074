"""The rows of the one table that the benchmark prints."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

WIDTHS = 92, 22, 34
"""Of all columns but the last; a longer text takes the room it needs."""


@dataclass(frozen=True)
class Row:
    what: str
    ours: str
    peer: str
    ratio: str


def ratio_row(what: str, ours: float, peer: float, name: str) -> Row:
    return Row(what, f"{ours:,.4g}", f"{peer:,.4g} ({name})", f"{ours / peer:.3g}")


def print_table(rows: Iterable[Row]) -> None:
    """Print each row as soon as it is measured."""
    _print_row(Row("what", "ours", "peer or limit", "ratio"))
    for row in rows:
        _print_row(row)


def _print_row(row: Row) -> None:
    cells = zip((row.what, row.ours, row.peer), WIDTHS, strict=True)
    print("  ".join([*(cell.ljust(width) for cell, width in cells), row.ratio]), flush=True)
