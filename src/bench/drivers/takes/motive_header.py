"""The header of a Motive CSV export: which column holds which quantity of which marker or rigid body.

Layout of 1.2 to 1.25: a line of key, value pairs; a blank line; rows that say for every column its type, name, id,
(from 1.25) parent and component; then the row ``Frame, Time (Seconds), [TimeCode,] X, Y, Z, …``. In 1.2 and 1.21
the rows do not say which of these they are, later ones do in their second cell. Columns are found by what they are,
never by where they are: exports differ in what is ticked.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction

from bench.drivers.takes.grid import METRES_PER_UNIT, parse_rate
from bench.drivers.takes.take import unreadable
from bench.drivers.takes.text import TextFile, split_cells

__all__ = ["BodyColumns", "MotiveHeader", "PointColumns", "read_header"]

KNOWN_VERSIONS = ("1.2", "1.20", "1.21", "1.22", "1.23", "1.24", "1.25")
SAME_FAMILY = re.compile(r"1\.2\d?")
MAX_HEADER_ROWS = 20
HOW_TO_EXPORT = "Export it again from Motive with 'Markers' and 'Unlabeled Markers' ticked."


@dataclass(frozen=True, slots=True)
class PointColumns:
    """The three columns of one marker."""

    name: str
    xyz: tuple[int, int, int]
    parent: str = ""

    @property
    def is_named(self) -> bool:
        return bool(self.name) and not self.name.lower().startswith("unlabeled")


@dataclass(slots=True)
class BodyColumns:
    """The columns of one rigid body: by component (lower case) and axis, such as ("position", "X")."""

    name: str
    file_id: str = ""
    columns: dict[tuple[str, str], int] = field(default_factory=dict)

    @property
    def error(self) -> int | None:
        """The column of the mean marker error: "Error Per Marker" in 1.21, "Mean Marker Error" later."""
        found = (index for (component, axis), index in self.columns.items() if "error" in f"{component} {axis}".lower())
        return next(found, None)

    def all_of(self, component: str, axes: str) -> tuple[int, ...]:
        """Return the columns of a component's axes; empty unless all of them are there."""
        found = [self.columns.get((component, axis), -1) for axis in axes]
        return () if -1 in found else tuple(found)

    def owns(self, point: PointColumns) -> bool:
        """Whether the point is this body's: by its parent where the file names one, else by its own name.

        ``Body:Marker1`` is a measured marker of ``Body``; 1.21 calls its solved markers ``Body_1``.
        """
        if point.parent:
            return point.parent in (self.name, self.file_id)
        asset, colon, _ = point.name.rpartition(":")
        if colon:
            return asset == self.name
        return re.fullmatch(re.escape(self.name) + r"[_ ](Marker ?)?\d+", point.name) is not None


@dataclass(frozen=True)
class MotiveHeader:
    """Everything the header says that is needed to read the rows."""

    version: str
    keys: dict[str, str]
    """The first line, such as ``Take Name``."""
    units: str
    metres_per_unit: float
    rates_hz: tuple[Fraction, ...]
    """Export frame rate, then capture frame rate: those of the two that are given."""
    promised: int | None
    first_row: int
    """Line number of the first row of data."""
    labels: tuple[str, ...]
    """For messages: what each column is, as many as the table has."""
    time_column: int | None
    markers: tuple[PointColumns, ...]
    """Measured markers: columns of type ``Marker``."""
    solved: tuple[PointColumns, ...]
    """Where the rigid-body solver puts a body's markers: type ``Rigid Body Marker``. No measurements."""
    bodies: tuple[BodyColumns, ...]
    warnings: tuple[str, ...]

    def body_of(self, point: PointColumns) -> BodyColumns | None:
        """Return the rigid body that owns the point, if one does."""
        return next((body for body in self.bodies if body.owns(point)), None)


@dataclass(frozen=True, slots=True)
class Column:
    """One column, as the header rows describe it."""

    index: int
    type: str
    name: str
    component: str
    axis: str
    file_id: str
    parent: str


def read_header(file: TextFile) -> MotiveHeader:
    """Read the header. Raises as `bench.drivers.takes.read_take` does."""
    lines = ((line, [cell.strip() for cell in split_cells(text)]) for line, text in file.lines())
    top_line, top = next((line, cells) for line, cells in lines if any(cells))
    keys = _pairs(top)
    version, warnings = _version(file, keys)
    _verify_one_unit(file, top_line, top)
    units, metres_per_unit = _units(file, keys, warnings)
    rows, axes, first_row = _rows(file, lines)
    columns = list(_columns(rows, axes))
    markers = _points(file, columns, "marker")
    solved = _points(file, columns, "rigid body marker")
    if not markers:
        raise unreadable(file.name, "it was exported without markers", HOW_TO_EXPORT)
    return MotiveHeader(
        version=version,
        keys=keys,
        units=units,
        metres_per_unit=metres_per_unit,
        rates_hz=_rates(file, keys),
        promised=_promised(keys),
        first_row=first_row,
        labels=tuple(_labels(columns, axes)),
        time_column=_time_column(file, first_row - 1, axes),
        markers=markers,
        solved=solved,
        bodies=_bodies(columns, solved),
        warnings=tuple(warnings),
    )


def _pairs(cells: list[str]) -> dict[str, str]:
    """Return the first line's keys and values.

    A comma inside an unquoted take name shifts what follows by one cell, so every cell is taken as the key of its
    right neighbour; the first mention counts.
    """
    pairs: dict[str, str] = {}
    for key, value in zip(cells, [*cells[1:], ""], strict=True):
        pairs.setdefault(key, value)
    return pairs


def _version(file: TextFile, keys: dict[str, str]) -> tuple[str, list[str]]:
    version = keys.get("Format Version", "")
    if version in KNOWN_VERSIONS:
        return version, []
    if SAME_FAMILY.fullmatch(version):
        return version, [f"Format version {version} is newer than those bench was tested with (1.2 to 1.25)."]
    what = f"its format version is '{version}', and of Motive exports 1.2 to 1.25 are known"
    raise unreadable(file.name, what, "Export it again in one of these versions.")


def _units(file: TextFile, keys: dict[str, str], warnings: list[str]) -> tuple[str, float]:
    units = keys.get("Length Units", "")
    if not units:
        warnings.append("The header names no length unit: metres are assumed.")
        return "Meters", 1.0
    if units.lower() not in METRES_PER_UNIT:
        raise unreadable(file.name, f"its length unit '{units}' is not known", "Export it again in meters.")
    return units, METRES_PER_UNIT[units.lower()]


def _verify_one_unit(file: TextFile, line: int, cells: list[str]) -> None:
    """Refuse a header that names two length units: whoever pasted two exports together knows which rows are which."""
    at = [column for column, cell in enumerate(cells[:-1], start=1) if cell == "Length Units" and cells[column]]
    if len({cells[column].lower() for column in at}) > 1:
        named = " and ".join(f"'{cells[column]}' in column {column + 1}" for column in at)
        raise file.at(line, f"its length unit is {named}")


def _time_column(file: TextFile, line: int, axes: list[str]) -> int | None:
    for column, axis in enumerate(axes):
        if axis.lower().startswith("time (") and axis.lower() != "time (seconds)":
            raise file.at(line, f"'{axis}' in column {column + 1} is no time in seconds")
        if axis.lower() in ("time", "time (seconds)"):
            return column
    return None


def _rates(file: TextFile, keys: dict[str, str]) -> tuple[Fraction, ...]:
    texts = [keys[key] for key in ("Export Frame Rate", "Capture Frame Rate") if keys.get(key)]
    rates = tuple(rate for rate in map(parse_rate, texts) if rate is not None)
    if not rates:
        said = f"the frame rate '{texts[0]}' is no rate" if texts else "its header gives no frame rate"
        raise unreadable(file.name, said, "Export it again from Motive with its header.")
    return rates


def _promised(keys: dict[str, str]) -> int | None:
    said = keys.get("Total Exported Frames") or keys.get("Total Frames in Take") or ""
    return int(said) if said.isascii() and said.isdigit() and len(said) < 12 else None


def _rows(file: TextFile, lines: Iterator[tuple[int, list[str]]]) -> tuple[dict[str, list[str]], list[str], int]:
    """Return the header rows by what they say, the row of axes, and the line number of the first row of data."""
    rows: list[list[str]] = []
    for line, cells in lines:
        if cells[0].lower() == "frame":
            return _named_rows(rows), cells + [""] * (max(map(len, rows), default=0) - len(cells)), line + 1
        if any(cells):
            rows.append(cells)
        if len(rows) > MAX_HEADER_ROWS:
            break
    raise unreadable(
        file.name, "its header has no row that begins with 'Frame'", "The file may be cut off: export it again."
    )


def _named_rows(rows: list[list[str]]) -> dict[str, list[str]]:
    named = {row[1].lower(): row for row in rows if len(row) > 1 and row[1].lower() in ("type", "name", "id", "parent")}
    if "type" not in named and len(rows) >= 2:  # 1.2 and 1.21: type, name, id, component, in this order
        named["type"], named["name"] = rows[0], rows[1]
    if rows and rows[-1] not in named.values():
        named["component"] = rows[-1]
    return named


def _columns(rows: dict[str, list[str]], axes: list[str]) -> Iterator[Column]:
    for index, axis in enumerate(axes):
        cell = {what: row[index] if index < len(row) else "" for what, row in rows.items()}
        kind = cell.get("type", "").lower()
        if kind and index > 0 and kind != "type":
            name, component = cell.get("name", ""), cell.get("component", "").lower()
            yield Column(index, kind, name, component, axis.upper(), cell.get("id", ""), cell.get("parent", ""))


def _points(file: TextFile, columns: list[Column], kind: str) -> tuple[PointColumns, ...]:
    points: list[PointColumns] = []
    open_axes: dict[str, Column] = {}
    for column in columns:
        if column.type != kind or column.component != "position":
            continue
        started = next(iter(open_axes.values()), column)
        if column.axis in open_axes or column.name != started.name:
            raise _incomplete(file, started)
        open_axes[column.axis] = column
        if len(open_axes) == 3:
            points.append(_point(file, open_axes))
            open_axes = {}
    if open_axes:
        raise _incomplete(file, next(iter(open_axes.values())))
    return tuple(points)


def _point(file: TextFile, axes: dict[str, Column]) -> PointColumns:
    if set(axes) != set("XYZ"):
        raise _incomplete(file, next(iter(axes.values())))
    first = axes["X"]
    return PointColumns(first.name, (axes["X"].index, axes["Y"].index, axes["Z"].index), first.parent)


def _incomplete(file: TextFile, column: Column) -> Exception:
    what = f"the header does not give X, Y and Z once each for the {column.type} '{column.name}'"
    return unreadable(file.name, what, HOW_TO_EXPORT)


def _bodies(columns: list[Column], solved: tuple[PointColumns, ...]) -> tuple[BodyColumns, ...]:
    bodies: dict[str, BodyColumns] = {}
    for column in columns:
        if column.type == "rigid body":
            body = bodies.setdefault(column.name, BodyColumns(column.name, column.file_id))
            body.columns.setdefault((column.component, column.axis), column.index)
    for point in solved:  # the body itself may not be ticked; its name still tells its markers from the others
        name = point.parent or point.name.rpartition(":")[0]
        if name and not any(body.owns(point) for body in bodies.values()):
            bodies[name] = BodyColumns(name)
    return tuple(bodies.values())


def _labels(columns: list[Column], axes: list[str]) -> Iterator[str]:
    by_index = {column.index: column for column in columns}
    for index, axis in enumerate(axes):
        column = by_index.get(index)
        yield f"{column.name} {column.component} {axis}".strip() if column else axis or str(index + 1)
