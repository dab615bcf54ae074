"""The frames of a Tracking Tools export: as many points in each as were seen, so that no two lines need be alike.

A block of lines is read as one long column of cells; where one of them is not plain, the block is read line by line:
it may still be whole (quotes, spaces), and if it is not, the cell is named.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import NoReturn

import numpy as np

from bench.drivers.takes.frame_cells import FrameCells
from bench.drivers.takes.grid import MAX_FRAME_NUMBER, MAX_TIME_S
from bench.drivers.takes.rows import Floats, Ints, Rows, Stamps
from bench.drivers.takes.take import MAX_POSITION_M, Points, Words
from bench.drivers.takes.text import Block, TextFile, float_cell, int_cell, split_cells
from bench.model import NO_ID, RigidBody

__all__ = [
    "FRAME",
    "MAX_COUNT",
    "POINT_CELLS",
    "Header",
    "find_names",
    "number_cell",
    "read_rows",
    "read_stamp",
]

FRAME = "frame,"
"""How the line of a frame begins."""
HEAD_CELLS = 4
"""The word, number, time and number of bodies."""
BODY_CELLS = 11
"""id, position, quaternion, and the three angles that say the same again."""
POINT_CELLS = {"1.0": 4, "1.1": 5}
"""Cells of one point by version: x, y, z, id and in 1.1 the name."""
MAX_COUNT = 100_000
MAX_NAMED_FRAMES = 1000
"""Frames in which the points' names are looked for: ten seconds at 100 Hz."""


@dataclass
class Header:
    version: str = "1.0"
    promised: int | None = None
    bodies: dict[int, str] = field(default_factory=dict)
    body_markers: dict[str, list[list[float]]] = field(default_factory=dict)
    detail: dict[str, str] = field(default_factory=dict)


def read_rows(file: TextFile, header: Header) -> Iterator[Rows]:
    """Yield the frames, block by block. `RecordingError` names the first cell that cannot be read."""
    for block in file.blocks():
        frames = [(line, text) for line, text in block.lines() if text.startswith(FRAME)]
        if frames:
            yield _read_plain(block, frames, header) or _read_line_by_line(file, frames, header)


def read_stamp(file: TextFile, line: int, cells: list[str]) -> tuple[int, float]:
    """Return a frame's number and time."""
    number = int_cell(file, line, cells, 1, "frame number", most=MAX_FRAME_NUMBER)
    int_cell(file, line, cells, 3, "body count", most=MAX_COUNT)
    time_s = number_cell(file, line, cells[2], "time")
    if not 0 <= time_s < MAX_TIME_S:
        raise file.at(line, f"{time_s:g} s is no time of a take")
    return number, time_s


def number_cell(file: TextFile, line: int, cell: str, column: str) -> float:
    """Return the number in a cell that must hold one."""
    value = float_cell(file, line, cell, column)
    if value != value:
        raise file.at(line, f"'{cell}' in column {column} is no number")
    return value


def find_names(file: TextFile, header: Header) -> dict[int, str]:
    """Return the points' names by their ids, as far as the first frames have them; only 1.1 has names."""
    names: dict[int, str] = {}
    if POINT_CELLS[header.version] == 4:
        return names
    frames = ((line, text) for line, text in file.lines() if text.startswith(FRAME))
    for line, text in islice(frames, MAX_NAMED_FRAMES):
        frame = _Frame.of(file, line, split_cells(text), header)
        if frame.size > 4:
            named = zip(_ids(frame.points).tolist(), (point[4].strip() for point in frame.points), strict=True)
            names.update({point_id: name for point_id, name in named if point_id != NO_ID and name})
    return names


# a block at once


def _read_plain(block: Block, frames: list[tuple[int, str]], header: Header) -> Rows | None:
    """Read the frames if all their cells are plain; None if not."""
    is_whole = len(frames) == block.n_lines
    data = block.data if is_whole else "".join(f"{text}\n" for _, text in frames).encode()
    if b'"' in data:
        return None
    cells = FrameCells.of(data)
    lines = np.array([line for line, _ in frames], np.int64)
    try:
        return _read_cells(cells, lines, header)
    except ValueError:
        return None


def _read_cells(cells: FrameCells, lines: Ints, header: Header) -> Rows | None:
    if (cells.count <= HEAD_CELLS).any():
        return None
    stamps = Stamps(lines, cells.ints(cells.first + 1), cells.floats(cells.first + 2))
    n_bodies = cells.ints(cells.first + 3)
    at = HEAD_CELLS + BODY_CELLS * n_bodies
    if (at >= cells.count).any():
        return None
    n_points = cells.ints(cells.first + at)
    given = cells.count - at - 1
    size = np.where(given == 4 * n_points, 4, POINT_CELLS[header.version])
    if (given < size * n_points).any():
        return None
    points = _spread(cells.first + at + 1, n_points, size)
    points_m = cells.floats(points[:, None] + np.arange(3))
    ids = cells.ints(points + 3)
    bodies = _plain_bodies(cells, n_bodies)
    if bodies is None or not (_is_sound(stamps) and (np.abs(points_m) < MAX_POSITION_M).all()):
        return None
    usable = np.where((ids > 0) & (ids < NO_ID), ids, NO_ID)
    return _rows(stamps, n_points, points_m.astype(np.float32), usable.astype(np.uint32), bodies)


def _plain_bodies(cells: FrameCells, n_bodies: Ints) -> list[tuple[RigidBody, ...]] | None:
    first = _spread(cells.first + HEAD_CELLS, n_bodies, np.full(len(n_bodies), BODY_CELLS))
    ids, pose = cells.ints(first), cells.floats(first[:, None] + np.arange(1, 8))
    if not (np.isfinite(pose).all(axis=1) & (np.abs(pose[:, :3]) < MAX_POSITION_M).all(axis=1)).all():
        return None
    all_bodies = iter(
        RigidBody(body_id, (x, y, z), (qx, qy, qz, qw))
        for body_id, (x, y, z, qx, qy, qz, qw) in zip(ids.tolist(), pose.tolist(), strict=True)
    )
    return [tuple(islice(all_bodies, n)) for n in n_bodies.tolist()]


def _spread(start: Ints, count: Ints, size: Ints) -> Ints:
    """Return start, start + size, start + 2 size… of each line, `count` of them."""
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.asarray(np.repeat(start, count) + np.repeat(size, count) * place, np.int64)


def _is_sound(stamps: Stamps) -> bool:
    return bool(((stamps.time_s >= 0) & (stamps.time_s < MAX_TIME_S)).all())


def _rows(stamps: Stamps, n_points: Ints, points_m: Points, ids: Words, bodies: list[tuple[RigidBody, ...]]) -> Rows:
    nothing = np.full(len(ids), np.nan, np.float32)
    return Rows(stamps, n_points, points_m, ids, np.zeros(len(ids), np.uint32), nothing, bodies)


# line by line


@dataclass(frozen=True, slots=True)
class _Frame:
    """One frame, in cells."""

    number: int
    time_s: float
    bodies: tuple[RigidBody, ...]
    points: list[list[str]]
    size: int
    """Cells of one point."""

    @classmethod
    def of(cls, file: TextFile, line: int, cells: list[str], header: Header) -> _Frame:
        number, time_s = read_stamp(file, line, cells)
        n_bodies = int_cell(file, line, cells, 3, "body count", most=MAX_COUNT)
        at = HEAD_CELLS + BODY_CELLS * n_bodies
        n = int_cell(file, line, cells, at, "marker count", most=MAX_COUNT)
        given = len(cells) - at - 1  # the version's, unless the row was written without the names of 1.1
        size = 4 if given == 4 * n else POINT_CELLS[header.version]
        if given < size * n:
            raise file.at(line, f"{n} markers are promised, and it ends after {len(cells)} cells")
        bodies = tuple(_read_pose(file, line, cells, HEAD_CELLS + BODY_CELLS * i) for i in range(n_bodies))
        points = [cells[start : start + size] for start in range(at + 1, at + 1 + size * n, size)]
        return cls(number, time_s, bodies, points, size)


def _read_line_by_line(file: TextFile, frames: list[tuple[int, str]], header: Header) -> Rows:
    read = [(line, _Frame.of(file, line, split_cells(text), header)) for line, text in frames]
    stamps = Stamps(
        np.array([line for line, _ in read], np.int64),
        np.array([frame.number for _, frame in read], np.int64),
        np.array([frame.time_s for _, frame in read], np.float64),
    )
    points_m = [_read_points(file, line, frame.points) for line, frame in read]
    return _rows(
        stamps,
        np.array([len(frame.points) for _, frame in read], np.int64),
        np.concatenate(points_m).astype(np.float32),
        np.concatenate([_ids(frame.points) for _, frame in read]),
        [frame.bodies for _, frame in read],
    )


def _read_points(file: TextFile, line: int, points: list[list[str]]) -> Floats:
    columns = [
        [number_cell(file, line, cell, f"{axis} of marker {i}") for axis, cell in zip("xyz", point, strict=False)]
        for i, point in enumerate(points, start=1)
    ]
    points_m = np.array(columns, np.float64).reshape(-1, 3)
    far = np.argwhere(np.abs(points_m) >= MAX_POSITION_M)
    if len(far):
        _refuse(file, line, points, *far[0])
    return points_m


def _refuse(file: TextFile, line: int, points: list[list[str]], marker: int, axis: int) -> NoReturn:
    raise file.at(line, f"{points[marker][axis]} m in column {'xyz'[axis]} of marker {marker + 1} is no position")


def _ids(points: list[list[str]]) -> Words:
    """Return the points' ids: `NO_ID` for 0, as 1.0 writes for every point, and for what is no number."""
    cells = [point[3] for point in points]
    words = [int(cell) if cell.isascii() and cell.isdigit() and len(cell) < 11 else 0 for cell in cells]
    return np.array([word if 0 < word < NO_ID else NO_ID for word in words], np.uint32)


def _read_pose(file: TextFile, line: int, cells: list[str], at: int) -> RigidBody:
    body_id = int_cell(file, line, cells, at, "body id", most=MAX_FRAME_NUMBER)
    x, y, z, qx, qy, qz, qw = (
        number_cell(file, line, cell, f"pose of body {body_id}") for cell in cells[at + 1 : at + 8]
    )
    if max(abs(x), abs(y), abs(z)) >= MAX_POSITION_M:
        raise file.at(line, f"the rigid body {body_id} is more than {MAX_POSITION_M:g} m away")
    return RigidBody(body_id, (x, y, z), (qx, qy, qz, qw))
