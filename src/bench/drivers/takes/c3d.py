"""C3D files, read with ezc3d: named points, their unit and rate, and which of them were seen in each frame.

ezc3d believes what the file says of its own size, so the sizes are checked against the file before it is called.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
import numpy.typing as npt

from bench.drivers.takes.grid import METRES_PER_UNIT, Survey, grid_ticks, parse_rate
from bench.drivers.takes.take import MAX_POSITION_M, Row, Take, TakeInfo, make_frame, unreadable
from bench.errors import RecordingError
from bench.model import UNLABELED, StampKind

__all__ = ["is_c3d", "read_c3d"]

BLOCK_BYTES = 512
KEY = 0x50
"""Second byte of every C3D file."""
INTEL, DEC, MIPS = 84, 85, 86
"""Processor types: little endian, VAX floats, big endian."""
DAMAGED = "The file may be cut off or damaged: export it again."

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class C3dHeader:
    """The first 512 bytes, as far as they are needed."""

    first_frame: int
    last_frame: int
    needed_bytes: int
    """Size that a file with this header has at least."""


def is_c3d(start: bytes) -> bool:
    """Whether a file that begins with `start` is a C3D file; no text has a first byte below a space."""
    return len(start) > 1 and start[1] == KEY and 0 < start[0] < 0x20 and start[0] not in b"\t\n\r"


def read_c3d(path: Path) -> Take:
    """Read a C3D file. Raises as `bench.drivers.takes.read_take` does.

    A point is missing where its residual is -1 or a coordinate is NaN. All points are unlabeled, since it is the
    cable's own markers that are named; a point's id is its place in the file's list of names.
    """
    header = _verify_sizes(path)
    try:
        content: Any = ezc3d.c3d(str(path))
    except Exception as error:  # ezc3d raises bare RuntimeError, ValueError, IndexError, … from C++
        raise unreadable(path.name, f"ezc3d says {str(error).strip() or type(error).__name__}", DAMAGED) from error
    return _take_of(path.name, header, content)


def _take_of(name: str, header: C3dHeader, content: Any) -> Take:
    parameters: Mapping[str, Any] = content["parameters"].get("POINT", {})
    points = np.asarray(content["data"]["points"], np.float64)[:3]
    residuals = np.asarray(content["data"]["meta_points"]["residuals"], np.float64)[0]
    warnings: list[str] = []
    rate = _rate(name, parameters, content)
    units, metres_per_unit = _units(name, parameters, warnings)
    seen = np.isfinite(points).all(axis=0) & (residuals >= 0)
    points *= metres_per_unit
    if not (np.abs(points[:, seen]) < MAX_POSITION_M).all():
        raise unreadable(name, f"it has points more than {MAX_POSITION_M:g} m away", DAMAGED)
    frames = _Frames(points, seen, np.where(residuals > 0, residuals * metres_per_unit, np.nan))
    survey = Survey()
    for row in frames.rows():
        survey.add(row)
    if survey.n_points == 0:
        raise unreadable(name, f"no point is seen in any of its {survey.n_frames} frames")
    promised = _promised(header, content)
    info = TakeInfo(
        format="C3D",
        version="",
        rate_hz=float(rate),
        stamp=StampKind.FRAME_GRID,
        units=units,
        frames_promised=promised,
        frames_found=survey.n_frames,
        points_min=survey.points_min,
        points_max=survey.points_max,
        marker_names=_names(parameters, len(seen)),
        warnings=(*warnings, *survey.warnings(promised)),
    )
    ticks = grid_ticks(rate)
    return Take(info, (make_frame(row, ticks(row), info) for row in frames.rows()))


@dataclass(frozen=True, slots=True, eq=False)
class _Frames:
    """All frames: positions (3, n, F) and residuals (n, F) in metres, and which points were seen (n, F)."""

    points_m: Floats
    seen: npt.NDArray[np.bool_]
    residual_m: Floats

    def rows(self) -> Iterator[Row]:
        """Yield the frames, numbered from 0."""
        for number in range(self.seen.shape[1]):
            seen = self.seen[:, number]
            ids = np.flatnonzero(seen).astype(np.uint32)
            yield Row(
                line=0,
                number=number,
                time_s=float("nan"),
                points_m=self.points_m[:, seen, number].T.astype(np.float32),
                ids=ids,
                flags=np.full(len(ids), UNLABELED, np.uint32),
                bodies=(),
                residual_m=self.residual_m[seen, number].astype(np.float32),
            )


def _rate(name: str, parameters: Mapping[str, Any], content: Any) -> Fraction:
    said = _value(parameters, "RATE") or content["header"]["points"]["frame_rate"]
    # the file holds a float32: its shortest decimal form is the rate that was meant
    rate = parse_rate(str(np.float32(said)))
    if rate is None:
        raise unreadable(name, f"its frame rate {said} is no rate", DAMAGED)
    return rate


def _units(name: str, parameters: Mapping[str, Any], warnings: list[str]) -> tuple[str, float]:
    units = str(_value(parameters, "UNITS") or "").strip()
    if not units:
        warnings.append("The file names no length unit: millimetres are assumed, as is usual in C3D files.")
        return "mm", METRES_PER_UNIT["mm"]
    if units.lower() not in METRES_PER_UNIT:
        raise unreadable(name, f"its length unit '{units}' is not known", "Export it again in metres or millimetres.")
    return units, METRES_PER_UNIT[units.lower()]


def _names(parameters: Mapping[str, Any], n: int) -> dict[int, str]:
    """Return the names by place; more than 255 of them continue in LABELS2, LABELS3 and so on."""
    labels: list[str] = []
    for key in ("LABELS", *(f"LABELS{i}" for i in range(2, 256))):
        if key not in parameters:
            break
        labels += [str(label).strip() for label in parameters[key]["value"]]
    return {i: label for i, label in enumerate(labels[:n]) if label}


def _promised(header: C3dHeader, content: Any) -> int | None:
    """Return the header's number of frames; its 16 bits cannot say more than 65 535, and then it is not asked."""
    promised = header.last_frame - header.first_frame + 1
    longer = header.last_frame >= 0xFFFF or "TRIAL" in content["parameters"]
    return None if longer or promised <= 0 else promised


def _value(parameters: Mapping[str, Any], key: str) -> Any:
    values: Any = parameters[key]["value"] if key in parameters else ()
    return values[0] if len(values) else None


def _verify_sizes(path: Path) -> C3dHeader:
    """Check that the file is as long as its header says. `RecordingError` if not."""
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            block = file.read(BLOCK_BYTES)
            at = (block[0] - 1) * BLOCK_BYTES if block else 0
            file.seek(at)
            section = file.read(4)
    except OSError as error:
        raise unreadable(path.name, (error.strerror or str(error)).lower()) from error
    if len(block) < BLOCK_BYTES or len(section) < 4:
        raise _cut(path)
    if section[3] not in (INTEL, DEC, MIPS):
        raise unreadable(path.name, f"its processor type {section[3]} is not known", DAMAGED)
    if section[3] == DEC:
        raise unreadable(path.name, "it holds VAX numbers (processor type 85)", "Convert it to the Intel format.")
    header = _parse_header(block, "<" if section[3] == INTEL else ">")
    if size < max(header.needed_bytes, at + section[2] * BLOCK_BYTES):
        raise _cut(path)
    return header


def _parse_header(block: bytes, order: str) -> C3dHeader:
    n_points, n_analog, first, last = struct.unpack_from(order + "4H", block, 2)
    (scale,) = struct.unpack_from(order + "f", block, 12)
    (data_block,) = struct.unpack_from(order + "H", block, 16)
    value_bytes = 4 if scale < 0 else 2
    frame_bytes = (4 * n_points + n_analog) * value_bytes
    return C3dHeader(first, last, max(data_block - 1, 0) * BLOCK_BYTES + frame_bytes * max(last - first + 1, 0))


def _cut(path: Path) -> RecordingError:
    return unreadable(path.name, "the file ends before its header says", DAMAGED)
