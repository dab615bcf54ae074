"""TRC files: one row a frame, three columns for each marker, separated by tabs.

Layout, as Motive, Cortex and OpenSim write it::

    PathFileType  4  (X/Y/Z)  name.trc
    DataRate  CameraRate  NumFrames  NumMarkers  Units  OrigDataRate  …
    100.00    100.00      300        10          mm     100.00        …
    Frame#  Time  name1      name2      …
                  X1  Y1  Z1  X2  Y2  Z2  …
    1  0.000  …

Columns are found by their axis and number, units and rate by their keys. A blank cell is a marker that was not seen.
Frames are usually counted from 1, which is the frame at time 0.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain, islice

import numpy as np

from bench.drivers.takes.columns import ColumnTable, make_rows
from bench.drivers.takes.grid import METRES_PER_UNIT, GridSurvey, file_ticks, grid_ticks, parse_rate
from bench.drivers.takes.rows import Rows, make_frames
from bench.drivers.takes.take import UNLABELED_FLAGS, Take, TakeInfo, unreadable
from bench.drivers.takes.text import Progress, TextFile, split_cells
from bench.model import StampKind

__all__ = ["FILE_TYPE", "read_trc"]

FILE_TYPE = "PathFileType"
"""First word of every TRC file."""
TAB = "\t"
HEADER_LINES = 5
AXIS = re.compile(r"([XYZ])(\d{1,6})")
DETAIL_KEYS = ("CameraRate", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames")
DAMAGED = "The file may be cut off or damaged: export it again."


@dataclass(frozen=True, slots=True)
class TrcHeader:
    """What stands above the rows."""

    keys: dict[str, str]
    names: tuple[str, ...]
    """The markers, in the order of their numbers."""
    columns: tuple[tuple[int, int, int], ...]
    """Of each marker: its X, Y and Z."""
    labels: tuple[str, ...]
    first_row: int


def read_trc(file: TextFile, progress: Progress | None = None) -> Take:
    """Read a TRC file. Raises as `bench.drivers.takes.read_take` does.

    The file does not tell rigid bodies' markers from others: all points are unlabeled, and a point's id is its
    marker's place in the header.
    """
    header = _read_header(file)
    units = _units(file, header)
    table = ColumnTable(file, TAB, header.first_row, header.labels, 1)
    survey = GridSurvey(rates_hz=_rates(file, header))
    for block in table.read(cut=survey.cut, progress=progress):
        survey.add(block.stamps)
    if survey.first is None:
        raise unreadable(file.name, "it holds no frames", DAMAGED)
    rate, promised = survey.grid_rate_hz, _whole_number(header.keys.get("NumFrames", ""))
    number, time_s = survey.first
    info = TakeInfo(
        format="TRC",
        version="",
        rate_hz=float(rate or survey.rates_hz[0]),
        stamp=StampKind.FRAME_GRID if rate else StampKind.FILE_TIME,
        units=units,
        frames_promised=promised,
        frames_found=survey.n_frames,
        marker_names=dict(enumerate(header.names)),
        detail={key: header.keys[key] for key in DETAIL_KEYS if header.keys.get(key)},
        warnings=(*survey.warnings(promised), *_warnings(header, survey)),
    )
    ticks = grid_ticks(rate, number - round(time_s * rate)) if rate else file_ticks
    return Take(info, make_frames(file.name, _rows(table, header, METRES_PER_UNIT[units.lower()]), ticks, info))


def _rows(table: ColumnTable, header: TrcHeader, metres_per_unit: float) -> Iterator[Rows]:
    flags = np.full(len(header.names), UNLABELED_FLAGS, np.uint32)
    for block in table.read(list(chain.from_iterable(header.columns))):
        yield make_rows(table, block, header.names, flags, metres_per_unit)


def _read_header(file: TextFile) -> TrcHeader:
    filled = ((line, split_cells(text, TAB)) for line, text in file.lines() if text.strip())
    lines = [(line, [cell.strip() for cell in cells]) for line, cells in islice(filled, HEADER_LINES + 1)]
    if len(lines) < HEADER_LINES:
        raise unreadable(file.name, "it ends within its header", DAMAGED)
    (_, start), (_, keys), (_, values), (_, names), (last, axes) = lines[:HEADER_LINES]
    if min(map(len, (start, keys, names))) < 2:
        raise unreadable(file.name, "its cells are not separated by tabs", "Export it again as TRC.")
    if not (names[0].lower().startswith("frame") and names[1].lower().startswith("time")):
        raise unreadable(file.name, "its rows do not begin with frame number and time", DAMAGED)
    columns = _columns(file, last, axes)
    labels = [*(names[i] if i < len(names) else "" for i in range(2)), *axes[2:]]
    return TrcHeader(
        keys=dict(zip(keys, values, strict=False)),
        names=tuple(_name(names, group) for group in columns),
        columns=columns,
        labels=tuple(_label(columns, names, i, label) for i, label in enumerate(labels)),
        first_row=lines[HEADER_LINES][0] if len(lines) > HEADER_LINES else last + 1,  # often after a blank line
    )


def _columns(file: TextFile, line: int, axes: list[str]) -> tuple[tuple[int, int, int], ...]:
    """Return the columns of X, Y and Z of each marker, by the markers' numbers."""
    found: dict[int, dict[str, int]] = {}
    for column, cell in enumerate(axes):
        match = AXIS.fullmatch(cell.upper())
        if match is None and cell:
            raise file.at(line, f"'{cell}' in column {column + 1} is no axis of a marker such as X1")
        if match is not None:
            marker = found.setdefault(int(match.group(2)), {})
            if match.group(1) in marker:
                raise file.at(line, f"'{cell}' in column {column + 1} is there for the second time")
            marker[match.group(1)] = column
    for number, marker in found.items():
        if len(marker) < 3:
            raise file.at(line, f"marker {number} has not all of X, Y and Z")
    if not found:
        raise unreadable(file.name, "it was exported without markers", "Export it again with markers.")
    return tuple((found[number]["X"], found[number]["Y"], found[number]["Z"]) for number in sorted(found))


def _name(names: list[str], group: tuple[int, int, int]) -> str:
    """Return the marker's name: it stands above the first of its columns."""
    return names[min(group)] if min(group) < len(names) else ""


def _label(columns: tuple[tuple[int, int, int], ...], names: list[str], column: int, label: str) -> str:
    name = next((_name(names, group) for group in columns if column in group), "")
    return f"{name} {label}".strip() or str(column + 1)


def _units(file: TextFile, header: TrcHeader) -> str:
    units = header.keys.get("Units", "")
    if units.lower() not in METRES_PER_UNIT:
        raise unreadable(
            file.name, f"its length unit '{units}' is not known", "Export it again in metres or millimetres."
        )
    return units


def _rates(file: TextFile, header: TrcHeader) -> tuple[Fraction, ...]:
    texts = [header.keys.get(key, "") for key in ("DataRate", "CameraRate")]
    rates = tuple(rate for rate in map(parse_rate, texts) if rate is not None)
    if not rates:
        raise unreadable(file.name, f"the frame rate '{texts[0]}' is no rate", DAMAGED)
    return rates


def _whole_number(text: str) -> int | None:
    return int(text) if text.isascii() and text.isdigit() and len(text) < 12 else None


def _warnings(header: TrcHeader, survey: GridSurvey) -> Iterator[str]:
    promised = _whole_number(header.keys.get("NumMarkers", ""))
    if promised is not None and promised != len(header.names):
        yield f"The header promises {promised} markers, {len(header.names)} were found."
    if survey.grid_rate_hz is None:
        said = " or ".join(f"{float(each):g}" for each in survey.rates_hz)
        yield f"The times in the file follow no grid of {said} frames a second: they are used as they are written."
