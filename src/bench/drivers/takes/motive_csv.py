"""Motive CSV exports, 1.2 to 1.25: one row a frame, one group of columns for each marker and rigid body.

A blank cell is a marker that was not seen. The measured points are the ``Marker`` columns; each row gives those that
are filled, in the order of the columns. Capture times are put on the grid of the frame rate, because those in the
file are rounded.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain

import numpy as np

from bench.drivers.takes.columns import ColumnTable, NumberBlock, make_rows
from bench.drivers.takes.grid import GridSurvey, file_ticks, grid_ticks, parse_start
from bench.drivers.takes.motive_bodies import find_body_markers
from bench.drivers.takes.motive_header import BodyColumns, MotiveHeader, read_header
from bench.drivers.takes.rows import Rows, Ticks, make_frames
from bench.drivers.takes.take import (
    LABELED_FLAGS,
    MAX_POSITION_M,
    UNLABELED_FLAGS,
    Take,
    TakeInfo,
    unreadable,
)
from bench.drivers.takes.text import Progress, TextFile
from bench.model import RigidBody, StampKind

__all__ = ["read_motive"]

TAKE_KEYS = (
    "Take Name",
    "Take Notes",
    "Capture Frame Rate",
    "Capture Start Frame",
    "Coordinate Space",
    "Rotation Type",
)
NAN = float("nan")


@dataclass(frozen=True, slots=True)
class BodyLayout:
    """Where one rigid body's values stand among the picked cells; -1 where the export does not give them."""

    body_id: int
    position: int
    rotation: int
    error: int


class RowReader:
    """Turns the table into rows: picks the cells that are needed, in a fixed order, and makes points of them."""

    def __init__(self, table: ColumnTable, header: MotiveHeader) -> None:
        self._table = table
        self._scale = header.metres_per_unit
        self._names = [point.name for point in header.markers]
        self._layouts, body_columns = _lay_out(header.bodies, 3 * len(header.markers))
        self._columns = [*chain.from_iterable(point.xyz for point in header.markers), *body_columns]
        owned = [header.body_of(point) is not None for point in header.markers]
        self._flags = np.where(owned, LABELED_FLAGS, UNLABELED_FLAGS).astype(np.uint32)

    def rows(self) -> Iterator[Rows]:
        """Yield the file's rows, block by block."""
        for block in self._table.read(self._columns):
            rows = make_rows(self._table, block, self._names, self._flags, self._scale)
            yield replace(rows, bodies=self._bodies(block)) if self._layouts else rows

    def _bodies(self, block: NumberBlock) -> list[tuple[RigidBody, ...]]:
        poses = [self._poses(block, layout) for layout in self._layouts]
        return [tuple(pose for pose in row if pose is not None) for row in zip(*poses, strict=True)]

    def _poses(self, block: NumberBlock, layout: BodyLayout) -> list[RigidBody | None]:
        """Return the body's pose in each row, None where it was not tracked."""
        lines, values = block.stamps.line.tolist(), block.values
        position_m = (values[:, layout.position : layout.position + 3] * self._scale).tolist()
        rotation = values[:, layout.rotation : layout.rotation + 4].tolist() if layout.rotation >= 0 else None
        error_m = (values[:, layout.error] * self._scale).tolist() if layout.error >= 0 else None
        poses: list[RigidBody | None] = []
        for i, (x, y, z) in enumerate(position_m):
            if math.isnan(x + y + z):
                poses.append(None)
                continue
            if max(abs(x), abs(y), abs(z)) >= MAX_POSITION_M:
                what = f"the rigid body {layout.body_id} is more than {MAX_POSITION_M:g} m away"
                raise self._table.file.at(lines[i], what)
            qx, qy, qz, qw = rotation[i] if rotation else (NAN, NAN, NAN, NAN)
            poses.append(RigidBody(layout.body_id, (x, y, z), (qx, qy, qz, qw), error_m[i] if error_m else NAN))
        return poses


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


def read_motive(file: TextFile, progress: Progress | None = None) -> Take:
    """Read a Motive export. Raises as `bench.drivers.takes.read_take` does."""
    header = read_header(file)
    table = ColumnTable(file, ",", header.first_row, header.labels, header.time_column)
    survey = GridSurvey(rates_hz=header.rates_hz)
    for block in table.read(cut=survey.cut, progress=progress):
        survey.add(block.stamps)
    if survey.n_frames == 0:
        raise unreadable(file.name, "it holds no frames")
    info, ticks = _describe(table, header, survey)
    return Take(info, make_frames(file.name, RowReader(table, header).rows(), ticks, info))


def _describe(table: ColumnTable, header: MotiveHeader, survey: GridSurvey) -> tuple[TakeInfo, Ticks]:
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
        bodies={body_id: body.name for body_id, body in enumerate(header.bodies, start=1)},
        body_markers=find_body_markers(table, header),
        marker_names={i: point.name for i, point in enumerate(header.markers)},
        capture_start=start_text,
        start_ns=start_ns,
        time_origin=time_origin,
        detail={key: header.keys[key] for key in TAKE_KEYS if header.keys.get(key)} | _up_axis(header),
        warnings=(*header.warnings, *survey.warnings(header.promised), *_warnings(header, rate)),
    )
    return info, grid_ticks(rate) if rate else file_ticks


def _up_axis(header: MotiveHeader) -> dict[str, str]:
    """Return which axis is up: Motive's own exports do not say it, those of bench do."""
    axis = header.keys.get("Up Axis", "").lower()
    return {"up_axis": axis} if axis in ("x", "y", "z") else {}


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
