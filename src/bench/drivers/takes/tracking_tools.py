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

import numpy as np

from bench.drivers.takes.grid import MAX_FRAME_NUMBER, Survey, file_ticks
from bench.drivers.takes.rows import Stamps, make_frames
from bench.drivers.takes.take import Take, TakeInfo, unreadable
from bench.drivers.takes.text import Block, Progress, TextFile, int_cell, split_cells
from bench.drivers.takes.tracking_rows import (
    FRAME,
    MAX_COUNT,
    POINT_CELLS,
    Header,
    find_names,
    number_cell,
    read_rows,
    read_stamp,
)
from bench.model import StampKind

__all__ = ["KEYWORDS", "read_tracking_tools"]

KEYWORDS = frozenset({"comment", "righthanded", "lefthanded", "info", "trackable", "rigidbody", "frame"})


def read_tracking_tools(file: TextFile, progress: Progress | None = None) -> Take:
    """Read a Tracking Tools export. Raises as `bench.drivers.takes.read_take` does."""
    header = _read_header(file)
    survey = Survey()
    unknown: dict[str, int] = {}
    for block in file.blocks(survey.cut, progress):
        survey.add(_read_stamps(file, block, unknown))
    info = _describe(file, header, survey, unknown)
    return Take(info, make_frames(file.name, read_rows(file, header), file_ticks, info))


def _describe(file: TextFile, header: Header, survey: Survey, unknown: dict[str, int]) -> TakeInfo:
    if survey.n_frames == 0:
        raise unreadable(file.name, "it holds no frames", "Export it again with 'Frames' included.")
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
        bodies=header.bodies,
        body_markers=header.body_markers,
        marker_names=find_names(file, header),
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
        [number_cell(file, line, cells[4 + size * i + axis], f"{'xyz'[axis]} of marker {i + 1}") for axis in range(3)]
        for i in range(n)
    ]


def _read_stamps(file: TextFile, block: Block, unknown: dict[str, int]) -> Stamps:
    """Return the block's frames; lines with an unknown first word are counted in `unknown`."""
    stamps: list[tuple[int, int, float]] = []
    for line, text in block.lines():
        if text.startswith(FRAME):
            cells = split_cells(text) if '"' in text else text.split(",", 4)
            stamps.append((line, *read_stamp(file, line, cells)))
        elif text.strip(" ,"):
            word = split_cells(text)[0].strip()
            if word.lower() == "frame" or word.lower() not in KEYWORDS:
                unknown[word[:30]] = unknown.get(word[:30], 0) + 1
    lines, numbers, times_s = zip(*stamps, strict=True) if stamps else ((), (), ())
    return Stamps(np.array(lines, np.int64), np.array(numbers, np.int64), np.array(times_s, np.float64))
