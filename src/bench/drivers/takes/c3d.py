"""C3D files, read with ezc3d: named points, their unit and rate, and which of them were seen in each frame.

ezc3d believes what the file says of its own size, so the sizes are checked against the file before it is called, and
it is called in a process of its own (`bench.drivers.takes.c3d_worker`).
"""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from bench.drivers.takes.grid import METRES_PER_UNIT, Survey, grid_ticks, parse_rate
from bench.drivers.takes.rows import Floats, Mask, Rows, Stamps, make_frames
from bench.drivers.takes.take import MAX_POSITION_M, Take, TakeInfo, unreadable
from bench.errors import RecordingError
from bench.model import UNLABELED, StampKind

__all__ = ["is_c3d", "read_c3d"]

WORKER = "bench.drivers.takes.c3d_worker"
BLOCK_BYTES = 512
KEY = 0x50
"""Second byte of every C3D file."""
INTEL, DEC, MIPS = 84, 85, 86
"""Processor types: little endian, VAX floats, big endian."""
LEAST_TIME_S = 60.0
"""To start a Python process on a machine that is busy with other things."""
SLOWEST_BYTES_PER_S = 1e6
"""ezc3d reads about 15 MB/s (2026-11, 29 MB); a slow machine is not to be taken for a damaged file."""
LEAST_MEMORY_BYTES = 2 << 30
MEMORY_PER_BYTE = 40
"""ezc3d and its arrays take 16 times the file (2026-11, 29 MB); room for fewer points a frame."""
FRAMES_AT_ONCE = 1000
MAX_FRAMES = 0xFFFF
"""The header counts in 16 bits, and ezc3d reads no more (1.7.2), whatever the file holds."""
DAMAGED = "The file may be cut off or damaged: export it again."


@dataclass(frozen=True, slots=True)
class C3dHeader:
    """The first 512 bytes, as far as they are needed."""

    first_frame: int
    last_frame: int
    needed_bytes: int
    """Size that a file with this header has at least."""
    held_frames: int
    """Whole frames behind the header, at least: the last block may be full or not."""


def is_c3d(start: bytes) -> bool:
    """Whether a file that begins with `start` is a C3D file; no text has a first byte below a space."""
    return len(start) > 1 and start[1] == KEY and 0 < start[0] < 0x20 and start[0] not in b"\t\n\r"


def read_c3d(path: Path) -> Take:
    """Read a C3D file. Raises as `bench.drivers.takes.read_take` does.

    A point is missing where its residual is -1 or a coordinate is NaN. All points are unlabeled, since it is the
    cable's own markers that are named; a point's id is its place in the file's list of names.
    """
    header = _verify_sizes(path)
    content = _load(path)
    warnings: list[str] = []
    rate = _rate(path.name, content)
    units, metres_per_unit = _units(path.name, content, warnings)
    frames = _frames(path.name, content, metres_per_unit)
    survey = Survey()
    survey.add(frames.stamps(0, frames.seen.shape[1]))
    promised = _promised(header, content, survey.n_frames)
    if promised is not None and promised > MAX_FRAMES:
        more = promised - MAX_FRAMES
        warnings.append(f"C3D counts {MAX_FRAMES} frames at most: some {more} more are in the file and are not read.")
    info = TakeInfo(
        format="C3D",
        version="",
        rate_hz=float(rate),
        stamp=StampKind.FRAME_GRID,
        units=units,
        frames_promised=promised,
        frames_found=survey.n_frames,
        marker_names=_names(content),
        detail=_up_axis(content),
        warnings=(*warnings, *survey.warnings(None if survey.n_frames == MAX_FRAMES else promised)),
    )
    return Take(info, make_frames(path.name, frames.rows(), grid_ticks(rate), info))


@dataclass(frozen=True, slots=True, eq=False)
class C3dContent:
    """What ezc3d found."""

    points: Floats
    """(3, n, F), in the file's unit."""
    residuals: Floats
    """(n, F): -1 where the point is missing."""
    parameters: dict[str, list[Any]]
    """The group POINT."""
    has_trial: bool
    frame_rate_hz: float


def _load(path: Path) -> C3dContent:
    """Let ezc3d read the file, in a child process that has neither all the time nor all the memory."""
    size = path.stat().st_size
    with TemporaryDirectory(prefix="bench-c3d-") as folder:
        target = Path(folder) / "content.npz"
        memory_bytes = max(LEAST_MEMORY_BYTES, MEMORY_PER_BYTE * size)
        command = [sys.executable, "-P", "-m", WORKER, str(path), str(target), str(memory_bytes)]
        try:
            done = subprocess.run(
                command,
                check=False,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=LEAST_TIME_S + size / SLOWEST_BYTES_PER_S,
            )
        except subprocess.TimeoutExpired as error:
            raise unreadable(path.name, f"ezc3d did not end within {error.timeout:.0f} s", DAMAGED) from error
        if done.returncode != 0:
            said = done.stderr.strip().splitlines()
            why = f"ezc3d says '{said[-1]}'" if said else f"ezc3d ended with code {done.returncode}"
            raise unreadable(path.name, why, DAMAGED)
        with np.load(target) as content:
            about = json.loads(str(content["about"]))
            points, residuals = content["points"], content["residuals"]
    return C3dContent(points, residuals, about["point"], about["has_trial"], about["frame_rate"])


def _frames(name: str, content: C3dContent, metres_per_unit: float) -> _Frames:
    points, residuals = content.points * metres_per_unit, content.residuals * metres_per_unit
    seen = np.isfinite(points).all(axis=0) & (residuals >= 0)
    if not (np.abs(points[:, seen]) < MAX_POSITION_M).all():
        raise unreadable(name, f"it has points more than {MAX_POSITION_M:g} m away", DAMAGED)
    measured = (residuals > 0) & (residuals < MAX_POSITION_M)  # 0 is a point that was filled in, not a perfect one
    return _Frames(points, seen, np.where(measured, residuals, np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class _Frames:
    """All frames: positions (3, n, F) and residuals (n, F) in metres, and which points were seen (n, F)."""

    points_m: Floats
    seen: Mask
    residual_m: Floats

    def stamps(self, start: int, stop: int) -> Stamps:
        """Return what is known of when the frames were captured: their numbers, from 0."""
        number = np.arange(start, stop)
        return Stamps(np.zeros(len(number), np.int64), number, np.full(len(number), np.nan))

    def rows(self) -> Iterator[Rows]:
        """Yield the frames, some at a time."""
        for start in range(0, self.seen.shape[1], FRAMES_AT_ONCE):
            part = slice(start, start + FRAMES_AT_ONCE)
            seen = self.seen[:, part].T
            ids = np.nonzero(seen)[1].astype(np.uint32)
            yield Rows(
                self.stamps(start, start + len(seen)),
                seen.sum(axis=1),
                self.points_m[:, :, part].transpose(2, 1, 0)[seen].astype(np.float32),
                ids,
                np.full(len(ids), UNLABELED, np.uint32),
                self.residual_m[:, part].T[seen].astype(np.float32),
            )


def _rate(name: str, content: C3dContent) -> Fraction:
    said = next(iter(content.parameters.get("RATE", [])), 0.0) or content.frame_rate_hz
    # the file holds a float32: its shortest decimal form is the rate that was meant
    rate = parse_rate(str(np.float32(said))) if isinstance(said, int | float) else None
    if rate is None:
        raise unreadable(name, f"its frame rate {said} is no rate", DAMAGED)
    return rate


def _units(name: str, content: C3dContent, warnings: list[str]) -> tuple[str, float]:
    named = {str(units).strip().lower(): str(units).strip() for units in content.parameters.get("UNITS", [])}
    if len(named) > 1:
        raise unreadable(
            name, f"its length unit is {' and '.join(map(repr, named.values()))}", "Export it in one unit."
        )
    units = next(iter(named.values()), "")
    if not units:
        warnings.append("The file names no length unit: millimetres are assumed, as is usual in C3D files.")
        return "mm", METRES_PER_UNIT["mm"]
    if units.lower() not in METRES_PER_UNIT:
        raise unreadable(name, f"its length unit '{units}' is not known", "Export it again in metres or millimetres.")
    return units, METRES_PER_UNIT[units.lower()]


def _names(content: C3dContent) -> dict[int, str]:
    """Return the names by place; more than 255 of them continue in LABELS2, LABELS3 and so on."""
    keys = ("LABELS", *(f"LABELS{i}" for i in range(2, 256)))
    labels = [str(label).strip() for key in keys for label in content.parameters.get(key, [])]
    return {i: label for i, label in enumerate(labels[: content.points.shape[1]]) if label}


def _promised(header: C3dHeader, content: C3dContent, found: int) -> int | None:
    """Return the number of frames by the header, or by the file's size where the header's 16 bits are exhausted."""
    if found >= MAX_FRAMES:
        return max(header.held_frames, found)
    promised = header.last_frame - header.first_frame + 1
    longer = header.last_frame >= MAX_FRAMES or content.has_trial or found > promised
    return None if longer else promised


def _up_axis(content: C3dContent) -> dict[str, str]:
    """Return which axis a viewer is to draw upwards, where the file says it."""
    said = str(next(iter(content.parameters.get("Y_SCREEN", [])), "")).strip().lower().removeprefix("+")
    return {"up_axis": said} if said in ("x", "y", "z") else {}


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
    header = _parse_header(block, "<" if section[3] == INTEL else ">", size)
    if size < max(header.needed_bytes, at + section[2] * BLOCK_BYTES):
        raise _cut(path)
    return header


def _parse_header(block: bytes, order: str, size: int) -> C3dHeader:
    n_points, n_analog, first, last = struct.unpack_from(order + "4H", block, 2)
    (scale,) = struct.unpack_from(order + "f", block, 12)
    (data_block,) = struct.unpack_from(order + "H", block, 16)
    value_bytes = 4 if scale < 0 else 2
    frame_bytes = (4 * n_points + n_analog) * value_bytes
    start = max(data_block - 1, 0) * BLOCK_BYTES
    held = max(size - start - BLOCK_BYTES + 1, 0) // max(frame_bytes, 1)
    return C3dHeader(first, last, start + frame_bytes * max(last - first + 1, 0), held)


def _cut(path: Path) -> RecordingError:
    return unreadable(path.name, "the file ends before its header says", DAMAGED)
