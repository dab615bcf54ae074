"""Tracking Tools CSV, 1.0 and 1.1: rows that begin with a word; every frame lists the bodies and points it saw.

Layout, as seen in real exports of 2009 to 2024 (lengths are metres; the header names no unit and no rate)::

    comment,…                                free text
    righthanded                              or lefthanded
    info,version,1.1                         left out in 1.0
    info,framecount,N
    info,trackablecount,M                    1.1: rigidbodycount
    trackable,"name",id,m,{x,y,z}*m          1.1: rigidbody; the body's markers in its own frame
    frame,number,time,n,{id,x,y,z,qx,qy,qz,qw,yaw,pitch,roll}*n,k,{x,y,z,id[,name]}*k
    trackable,number,…                       extended rows after each frame: nothing in them is needed

The points are all that were seen, rigid bodies' markers too, with nothing to tell them apart: ids are 0 in 1.0.
Flags are 0 and ids `NO_ID`; who sorts the cable excludes the bodies' markers by `TakeInfo.body_markers`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NoReturn

import numpy as np

from bench.drivers.takes.grid import MAX_FRAME_NUMBER, MAX_TIME_S, Survey, ascending, file_ticks
from bench.drivers.takes.take import MAX_POSITION_M, Points, Row, Take, TakeInfo, Words, make_frame, unreadable
from bench.drivers.takes.text import TextFile, float_cell, int_cell, split_cells
from bench.model import NO_ID, RigidBody, StampKind

__all__ = ["KEYWORDS", "read_tracking_tools"]

KEYWORDS = frozenset({"comment", "righthanded", "lefthanded", "info", "trackable", "rigidbody", "frame"})
BODY_CELLS = 11
"""id, position, quaternion, and the three angles that say the same again."""
POINT_CELLS = {"1.0": 4, "1.1": 5}
"""Cells of one point by version: x, y, z, id and in 1.1 the name."""
MAX_COUNT = 100_000


@dataclass
class Header:
    version: str = "1.0"
    promised: int | None = None
    bodies: dict[int, str] = field(default_factory=dict)
    body_markers: dict[str, list[list[float]]] = field(default_factory=dict)
    detail: dict[str, str] = field(default_factory=dict)


def read_tracking_tools(file: TextFile) -> Take:
    """Read a Tracking Tools export. Raises as `bench.drivers.takes.read_take` does."""
    header = _read_header(file)
    survey = Survey()
    unknown: dict[str, int] = {}
    names: dict[int, str] = {}
    for row in ascending(_rows(file, header, survey.cut, unknown, names), survey):
        survey.add(row)
    info = _describe(file, header, survey, unknown, names)
    return Take(info, (make_frame(row, file_ticks(row), info) for row in ascending(_rows(file, header))))


def _describe(
    file: TextFile, header: Header, survey: Survey, unknown: dict[str, int], names: dict[int, str]
) -> TakeInfo:
    if survey.n_frames == 0:
        raise unreadable(file.name, "it holds no frames", "Export it again with 'Frames' included.")
    if survey.n_points == 0:
        raise unreadable(file.name, f"no marker is seen in any of its {survey.n_frames} frames")
    warnings = survey.warnings(header.promised)
    warnings += [f"{n} lines that begin with '{word}' are not known and were skipped." for word, n in unknown.items()]
    if header.detail.get("handedness") == "lefthanded":
        warnings.append("The take is left-handed: its curves are mirrored, their curvature is not changed by that.")
    if not survey.median_rate_hz:
        warnings.append("The take's rate is unknown: it has one frame, or its time stands still.")
    return TakeInfo(
        format="Tracking Tools CSV",
        version=header.version,
        rate_hz=survey.median_rate_hz or float("nan"),
        stamp=StampKind.FILE_TIME,
        units="meters",
        frames_promised=header.promised,
        frames_found=survey.n_frames,
        points_min=survey.points_min,
        points_max=survey.points_max,
        bodies=header.bodies,
        body_markers=header.body_markers,
        marker_names=names,
        detail=header.detail,
        warnings=tuple(warnings),
    )


def _read_header(file: TextFile) -> Header:
    header = Header()
    for line, text in file.lines():
        cells = split_cells(text)
        word = cells[0].strip().lower()
        if word == "frame":
            break
        if word == "info":
            _read_info(file, line, cells, header)
        elif word in ("trackable", "rigidbody"):
            _read_body(file, line, cells, header)
        elif word.endswith("handed"):
            header.detail["handedness"] = word
    return header


def _read_info(file: TextFile, line: int, cells: list[str], header: Header) -> None:
    key = cells[1].strip().lower() if len(cells) > 1 else ""
    if key == "framecount":
        header.promised = int_cell(file, line, cells, 2, "framecount", most=MAX_FRAME_NUMBER)
    elif key == "version":
        header.version = cells[2].strip() if len(cells) > 2 else ""
        if header.version not in POINT_CELLS:
            raise unreadable(
                file.name,
                f"its version is '{header.version}', and of Tracking Tools files {' and '.join(POINT_CELLS)} are known",
                "Export it again from Motive, as CSV.",
            )


def _read_body(file: TextFile, line: int, cells: list[str], header: Header) -> None:
    name = cells[1].strip() if len(cells) > 1 else ""
    body_id = int_cell(file, line, cells, 2, "body id", most=MAX_FRAME_NUMBER)
    n = int_cell(file, line, cells, 3, "marker count", most=MAX_COUNT)
    given = len(cells) - 4
    size = 4 if n and given >= 4 * n and any(cell.strip() for cell in cells[4 + 3 * n :]) else 3
    if given < size * n:
        raise file.at(line, f"rigid body '{name}' promises {n} markers and gives {given} cells")
    header.bodies[body_id] = name
    header.body_markers[name] = [
        [_number(file, line, cells[4 + size * i + axis], f"{'xyz'[axis]} of marker {i + 1}") for axis in range(3)]
        for i in range(n)
    ]


def _rows(
    file: TextFile,
    header: Header,
    cut: list[int] | None = None,
    unknown: dict[str, int] | None = None,
    names: dict[int, str] | None = None,
) -> Iterator[Row]:
    """Yield the frame rows; lines with an unknown first word are counted in `unknown`, named points in `names`."""
    for line, text in file.lines(cut):
        if text.startswith("frame,"):
            yield _read_frame(file, line, split_cells(text), header, names)
        elif unknown is not None and text.strip(" ,"):
            word = split_cells(text)[0].strip()
            if word.lower() == "frame" or word.lower() not in KEYWORDS:
                unknown[word[:30]] = unknown.get(word[:30], 0) + 1


def _read_frame(file: TextFile, line: int, cells: list[str], header: Header, names: dict[int, str] | None) -> Row:
    number = int_cell(file, line, cells, 1, "frame number", most=MAX_FRAME_NUMBER)
    n_bodies = int_cell(file, line, cells, 3, "body count", most=MAX_COUNT)
    time_s = _number(file, line, cells[2], "time")
    if not 0 <= time_s < MAX_TIME_S:
        raise file.at(line, f"{time_s:g} s is no time of a take")
    at = 4 + BODY_CELLS * n_bodies
    n = int_cell(file, line, cells, at, "marker count", most=MAX_COUNT)
    size = _point_cells(len(cells) - at - 1, n, header)
    rest = cells[at + 1 : at + 1 + size * n]
    if len(rest) < size * n:
        raise file.at(line, f"{n} markers are promised, and it ends after {len(cells)} cells")
    bodies = tuple(_read_pose(file, line, cells, 4 + BODY_CELLS * i) for i in range(n_bodies))
    ids = _read_ids(rest, size, names)
    return Row(line, number, time_s, _read_points(file, line, rest, size), ids, np.zeros(n, np.uint32), bodies)


def _point_cells(given: int, n: int, header: Header) -> int:
    """Return the cells of one point: the version's, unless the row was written without the names of 1.1."""
    size = POINT_CELLS[header.version]
    return 4 if given == 4 * n else size


def _read_points(file: TextFile, line: int, rest: list[str], size: int) -> Points:
    points = np.empty((len(rest) // size, 3))
    try:
        for axis in range(3):
            points[:, axis] = [float(cell) for cell in rest[axis::size]]
    except ValueError:
        _refuse_points(file, line, rest, size)
    if not (np.abs(points) < MAX_POSITION_M).all():
        _refuse_points(file, line, rest, size)
    return points.astype(np.float32)


def _refuse_points(file: TextFile, line: int, rest: list[str], size: int) -> NoReturn:
    """Raise the error of the first cell that is no coordinate."""
    for i, cell in enumerate(rest):
        column = f"{'xyz'[i % size]} of marker {i // size + 1}" if i % size < 3 else ""
        if column and not abs(_number(file, line, cell, column)) < MAX_POSITION_M:
            raise file.at(line, f"{cell} m in column {column} is no position")
    raise file.at(line, "its positions are no numbers")


def _read_ids(rest: list[str], size: int, names: dict[int, str] | None) -> Words:
    """Return the points' ids: `NO_ID` for 0, as 1.0 writes for every point, and for what is no number."""
    words = [int(cell) if cell.isascii() and cell.isdigit() and len(cell) < 11 else 0 for cell in rest[3::size]]
    ids = np.array([word if 0 < word < NO_ID else NO_ID for word in words], np.uint32)
    if names is not None and size > 4:
        named = zip(ids.tolist(), rest[4::size], strict=True)
        names.update({point_id: name.strip() for point_id, name in named if point_id != NO_ID and name.strip()})
    return ids


def _read_pose(file: TextFile, line: int, cells: list[str], at: int) -> RigidBody:
    body_id = int_cell(file, line, cells, at, "body id", most=MAX_FRAME_NUMBER)
    x, y, z, qx, qy, qz, qw = (_number(file, line, cell, f"pose of body {body_id}") for cell in cells[at + 1 : at + 8])
    if max(abs(x), abs(y), abs(z)) >= MAX_POSITION_M:
        raise file.at(line, f"the rigid body {body_id} is more than {MAX_POSITION_M:g} m away")
    return RigidBody(body_id, (x, y, z), (qx, qy, qz, qw))


def _number(file: TextFile, line: int, cell: str, column: str) -> float:
    value = float_cell(file, line, cell, column)
    if value != value:
        raise file.at(line, f"'{cell}' in column {column} is no number")
    return value
