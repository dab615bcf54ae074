"""The rows of the one table that the benchmark prints."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    what: str
    ours: str
    peer: str
    ratio: str


def ratio_row(what: str, ours: float, peer: float, name: str) -> Row:
    return Row(what, f"{ours:,.4g}", f"{peer:,.4g} ({name})", f"{ours / peer:.3g}")


def print_table(rows: list[Row]) -> None:
    header = Row("what", "ours", "peer or limit", "ratio")
    widths = [max(len(getattr(row, f)) for row in [header, *rows]) for f in ("what", "ours", "peer", "ratio")]
    for row in [header, *rows]:
        cells = (row.what, row.ours, row.peer, row.ratio)
        print("  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip())
