"""Markers as text: Motive's CSV and TRC, both in millimetres with a blank for each gap."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

from bench.report.export.markers import SortedMarkers

__all__ = ["write_csv", "write_trc"]

MM_PER_M = 1e3
FORMAT_VERSION = "1.25"
"""The newest of Motive's layouts that is known here."""
TRC_KEYS = (
    "DataRate",
    "CameraRate",
    "NumFrames",
    "NumMarkers",
    "Units",
    "OrigDataRate",
    "OrigDataStartFrame",
    "OrigNumFrames",
)
NS = 1_000_000_000


def write_csv(markers: SortedMarkers, path: Path) -> None:
    """Write the layout of a Motive CSV export, as programs that read Motive's files take it."""
    axes = [(name, axis) for name in markers.names for axis in "XYZ"]
    rows: list[Sequence[object]] = [
        [cell for pair in _motive_keys(markers).items() for cell in pair],
        [],
        ["", "Type", *("Marker" for _ in axes)],
        ["", "Name", *(name for name, _ in axes)],
        ["", "ID", *(name.removeprefix("M") for name, _ in axes)],
        ["", "Parent", *("" for _ in axes)],
        ["", "", *("Position" for _ in axes)],
        ["Frame", "Time (Seconds)", *(axis for _, axis in axes)],
    ]
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
        _write_rows(file, markers, ",", first_number=0)


def write_trc(markers: SortedMarkers, path: Path) -> None:
    """Write a TRC file. Its frames count from 1, as usual."""
    n, rate = len(markers.names), _rate_text(markers)
    header: list[Sequence[object]] = [
        ["PathFileType", 4, "(X/Y/Z)", _plain(markers.title) + ".trc"],
        TRC_KEYS,
        [rate, rate, markers.n_rows, n, "mm", rate, 1, markers.n_rows],
        ["Frame#", "Time", *(cell for name in markers.names for cell in (name, "", ""))],
        ["", "", *(f"{axis}{i}" for i in range(1, n + 1) for axis in "XYZ")],
        [],
    ]
    with path.open("w", encoding="utf-8", newline="") as file:
        file.writelines("\t".join(map(str, row)) + "\n" for row in header)
        _write_rows(file, markers, "\t", first_number=1)


def _write_rows(file: IO[str], markers: SortedMarkers, delimiter: str, first_number: int) -> None:
    for start, position_m in markers.blocks():
        cells = (position_m.astype(float) * MM_PER_M).tolist()
        file.writelines(
            delimiter.join((str(row + first_number), f"{row / markers.rate_hz:.6f}", *_cells(points))) + "\n"
            for row, points in enumerate(cells, start=start)
        )


def _cells(points: list[list[float]]) -> Iterator[str]:
    for x, y, z in points:
        yield from ("", "", "") if x != x else (f"{x:.6f}", f"{y:.6f}", f"{z:.6f}")


def _motive_keys(markers: SortedMarkers) -> dict[str, object]:
    rate = _rate_text(markers)
    moment = datetime.fromtimestamp(markers.start_ns // NS, tz=UTC)
    milliseconds = markers.start_ns % NS // 1_000_000
    return {
        "Format Version": FORMAT_VERSION,
        "Take Name": markers.title,
        "Capture Frame Rate": rate,
        "Export Frame Rate": rate,
        "Capture Start Time": f"{moment:%Y-%m-%d %I.%M.%S}.{milliseconds:03d} {moment:%p}",
        "Capture Start Frame": markers.first_frame,
        "Total Frames in Take": markers.n_rows,
        "Total Exported Frames": markers.n_rows,
        "Rotation Type": "Quaternion",
        "Length Units": "Millimeters",
        "Coordinate Space": "Global",
    } | ({"Up Axis": markers.up_axis.upper()} if markers.up_axis else {})


def _rate_text(markers: SortedMarkers) -> str:
    return f"{markers.rate_hz:.6f}"


def _plain(text: str) -> str:
    """Return a name without what separates cells and lines."""
    return " ".join(text.split())
