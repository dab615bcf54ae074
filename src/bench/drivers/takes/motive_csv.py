"""Motive CSV exports, 1.2 to 1.25: one row a frame, one group of columns for each marker and rigid body.

A blank cell is a marker that was not seen. The measured points are the ``Marker`` columns; each row gives those that
are filled, in the order of the columns. Capture times are put on the grid of the frame rate, because those in the
file are rounded.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import chain
from operator import itemgetter

import numpy as np
import numpy.typing as npt

from bench.drivers.takes.grid import (
    MAX_FRAME_NUMBER,
    MAX_TIME_S,
    Survey,
    Ticks,
    ascending,
    file_ticks,
    grid_ticks,
    parse_start,
)
from bench.drivers.takes.motive_bodies import find_body_markers
from bench.drivers.takes.motive_header import BodyColumns, MotiveHeader, read_header
from bench.drivers.takes.take import (
    LABELED_FLAGS,
    MAX_POSITION_M,
    UNLABELED_FLAGS,
    Row,
    Take,
    TakeInfo,
    make_frame,
    unreadable,
)
from bench.drivers.takes.text import TextFile, float_cell, int_cell, split_cells
from bench.model import RigidBody, StampKind

__all__ = ["read_motive"]

MAX_ROUNDING_S = 1.1e-3
"""Times are written to the millisecond, rounded or cut off: 1 ms, and a tenth for the digits after it."""
TAKE_KEYS = (
    "Take Name",
    "Take Notes",
    "Capture Frame Rate",
    "Capture Start Frame",
    "Coordinate Space",
    "Rotation Type",
)
NAN = float("nan")

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class BodyLayout:
    """Where one rigid body's values stand among the picked cells; -1 where the export does not give them."""

    body_id: int
    position: int
    rotation: int
    error: int


@dataclass
class MotiveSurvey(Survey):
    """And how far the written times are from the grids of the rates that the header gives."""

    rates_hz: tuple[Fraction, ...] = ()
    worst_s: list[float] = field(default_factory=list)

    def add(self, row: Row) -> None:
        super().add(row)
        first = self.first or row
        self.worst_s = self.worst_s or [0.0] * len(self.rates_hz)
        for i, rate_hz in enumerate(self.rates_hz):
            off_s = abs(row.time_s - first.time_s - (row.number - first.number) / float(rate_hz))
            self.worst_s[i] = max(self.worst_s[i], off_s)  # without a time column it is NaN and changes nothing

    @property
    def grid_rate_hz(self) -> Fraction | None:
        """The first rate whose grid the written times follow: exports may number frames of either."""
        pairs = zip(self.rates_hz, self.worst_s, strict=True)
        return next((rate for rate, worst_s in pairs if worst_s <= MAX_ROUNDING_S), None)


class RowReader:
    """Turns lines into rows: picks the cells that are needed, in a fixed order, and makes numbers of them."""

    def __init__(self, file: TextFile, header: MotiveHeader) -> None:
        self._file = file
        self._header = header
        self._scale = header.metres_per_unit
        self._n = len(header.markers)
        self._layouts, body_columns = _lay_out(header.bodies, 3 * self._n)
        self._columns = [*chain.from_iterable(point.xyz for point in header.markers), *body_columns]
        self._pick = itemgetter(*self._columns)
        self._ids = np.arange(self._n, dtype=np.uint32)
        owned = [header.body_of(point) is not None for point in header.markers]
        self._flags = np.where(owned, LABELED_FLAGS, UNLABELED_FLAGS).astype(np.uint32)

    def rows(self, cut: list[int] | None = None) -> Iterator[Row]:
        """Yield the file's rows; `cut` receives the number of a last line without an end."""
        for line, text in self._file.lines(cut):
            if line >= self._header.first_row and text.strip(" ,"):
                yield self._read(line, self.cells(line, text))

    def cells(self, line: int, text: str) -> list[str]:
        """Split a row and check that it has as many cells as the header."""
        cells = split_cells(text)
        width = self._header.n_columns
        if len(cells) < width or (len(cells) > width and any(cell.strip() for cell in cells[width:])):
            raise self._file.at(line, f"it has {len(cells)} cells where the header has {width}")
        return cells

    def _read(self, line: int, cells: list[str]) -> Row:
        number = int_cell(self._file, line, cells, 0, "Frame", most=MAX_FRAME_NUMBER)
        time_s = self._time(line, cells)
        values = self._numbers(line, self._pick(cells))
        points = values[: 3 * self._n].reshape(self._n, 3) * self._scale
        seen: Mask = np.asarray(~np.isnan(points).any(axis=1))
        self._verify_points(line, points, seen)
        bodies = tuple(body for layout in self._layouts if (body := self._body(line, layout, values)) is not None)
        return Row(line, number, time_s, points[seen].astype(np.float32), self._ids[seen], self._flags[seen], bodies)

    def _time(self, line: int, cells: list[str]) -> float:
        at = self._header.time_column
        if at is None:
            return NAN
        time_s = float_cell(self._file, line, cells[at], "Time")
        if not 0 <= time_s < MAX_TIME_S:
            raise self._file.at(line, f"'{cells[at]}' in column Time is no time of a take")
        return time_s

    def _numbers(self, line: int, cells: Sequence[str]) -> Floats:
        try:
            values = np.array([float(cell) if cell else NAN for cell in cells])
        except ValueError:
            pass
        else:
            if not np.isinf(values).any():
                return values
        labels = (self._header.labels[column] for column in self._columns)
        pairs = zip(cells, labels, strict=True)
        return np.array([float_cell(self._file, line, cell, f"'{label}'") for cell, label in pairs])

    def _verify_points(self, line: int, points: Floats, seen: Mask) -> None:
        """Refuse a marker that has only some of its coordinates, or is nowhere in this world."""
        partly = ~seen & ~np.isnan(points).all(axis=1)
        far = seen & (np.abs(points) >= MAX_POSITION_M).any(axis=1)
        if partly.any():
            name = self._header.markers[int(np.flatnonzero(partly)[0])].name
            raise self._file.at(line, f"the marker '{name}' has not all of X, Y and Z")
        if far.any():
            name = self._header.markers[int(np.flatnonzero(far)[0])].name
            raise self._file.at(line, f"the marker '{name}' is more than {MAX_POSITION_M:g} m away")

    def _body(self, line: int, layout: BodyLayout, values: Floats) -> RigidBody | None:
        """Return the body's pose, None where it was not tracked."""
        x, y, z = (float(value) * self._scale for value in values[layout.position : layout.position + 3])
        if math.isnan(x + y + z):
            return None
        if max(abs(x), abs(y), abs(z)) >= MAX_POSITION_M:
            raise self._file.at(line, f"the rigid body {layout.body_id} is more than {MAX_POSITION_M:g} m away")
        quaternion = (NAN, NAN, NAN, NAN)
        if layout.rotation >= 0:
            qx, qy, qz, qw = (float(value) for value in values[layout.rotation : layout.rotation + 4])
            quaternion = (qx, qy, qz, qw)
        error_m = float(values[layout.error]) * self._scale if layout.error >= 0 else NAN
        return RigidBody(layout.body_id, (x, y, z), quaternion, error_m)


def _lay_out(bodies: Sequence[BodyColumns], start: int) -> tuple[list[BodyLayout], list[int]]:
    """Return where each body's values will stand, and the columns to pick for them. Ids count from 1."""
    layouts: list[BodyLayout] = []
    columns: list[int] = []
    for body_id, body in enumerate(bodies, start=1):
        position, rotation = body.all_of("position", "XYZ"), body.all_of("rotation", "XYZW")
        error = () if body.error is None else (body.error,)
        if not position:
            continue
        at = start + len(columns)
        at_error = at + 3 + len(rotation)
        columns += [*position, *rotation, *error]
        layouts.append(BodyLayout(body_id, at, at + 3 if rotation else -1, at_error if error else -1))
    return layouts, columns


def read_motive(file: TextFile) -> Take:
    """Read a Motive export. Raises as `bench.drivers.takes.read_take` does."""
    header = read_header(file)
    reader = RowReader(file, header)
    survey = MotiveSurvey(rates_hz=header.rates_hz)
    for row in ascending(reader.rows(survey.cut), survey):
        survey.add(row)
    if survey.n_frames == 0:
        raise unreadable(file.name, "it holds no frames")
    if survey.n_points == 0:
        raise unreadable(file.name, f"no marker is seen in any of its {survey.n_frames} frames")
    info, ticks = _describe(file, header, survey)
    return Take(info, (make_frame(row, ticks(row), info) for row in ascending(reader.rows())))


def _describe(file: TextFile, header: MotiveHeader, survey: MotiveSurvey) -> tuple[TakeInfo, Ticks]:
    rate = survey.grid_rate_hz
    start_text = header.keys.get("Capture Start Time", "")
    start_ns, time_origin = parse_start(start_text)
    info = TakeInfo(
        format="Motive CSV",
        version=header.version,
        rate_hz=float(rate or header.rates_hz[0]),
        stamp=StampKind.FRAME_GRID if rate else StampKind.FILE_TIME,
        units=header.units,
        frames_promised=header.promised,
        frames_found=survey.n_frames,
        points_min=survey.points_min,
        points_max=survey.points_max,
        bodies={body_id: body.name for body_id, body in enumerate(header.bodies, start=1)},
        body_markers=find_body_markers(file, header),
        marker_names={i: point.name for i, point in enumerate(header.markers)},
        capture_start=start_text,
        start_ns=start_ns,
        time_origin=time_origin,
        detail={key: header.keys[key] for key in TAKE_KEYS if header.keys.get(key)},
        warnings=(*header.warnings, *survey.warnings(header.promised), *_warnings(header, rate)),
    )
    return info, grid_ticks(rate) if rate else file_ticks


def _warnings(header: MotiveHeader, rate: Fraction | None) -> Iterator[str]:
    if rate is None:
        said = " or ".join(f"{float(each):g}" for each in header.rates_hz)
        yield f"The times in the file follow no grid of {said} frames a second: they are used as they are written."
    space, rotation = header.keys.get("Coordinate Space", ""), header.keys.get("Rotation Type", "")
    if space and space != "Global":
        yield f"The take was exported in '{space}' coordinates: rigid bodies may not stand where the markers do."
    if header.bodies and rotation != "Quaternion":
        yield f"Rigid bodies' rotations are exported as '{rotation}' and left out; only 'Quaternion' is read."
    loose = [point.name for point in header.markers if point.is_named and header.body_of(point) is None]
    if loose:
        some = ", ".join(loose[:5]) + (", …" if len(loose) > 5 else "")
        yield f"{len(loose)} named markers belong to no rigid body of this file and count as the cable's: {some}."
