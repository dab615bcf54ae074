"""Markers as a C3D file, written with ezc3d."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import ezc3d
import numpy as np

from bench.errors import RecordingError
from bench.report.export.markers import SortedMarkers

__all__ = ["write_c3d"]

MM_PER_M = 1e3
POINT_BYTES = 16
MAX_FRAMES = 0xFFFF
"""C3D counts frames in 16 bits, and ezc3d neither writes nor reads more."""
SCREEN = {"x": ("+Y", "+X"), "y": ("+X", "+Y"), "z": ("+X", "+Z")}
"""Which axes a viewer draws to the right and upwards, by the one that points up."""


def write_c3d(markers: SortedMarkers, path: Path) -> None:
    """Write a C3D file: named points in millimetres, residual -1 where a marker was not found.

    Raises
    ------
    RecordingError
        There are more frames than a C3D file can count.
    """
    n_rows, n_markers = markers.n_rows, len(markers.names)
    if n_rows > MAX_FRAMES:
        raise RecordingError(
            f"{markers.title} has {n_rows} frames, and a C3D file counts {MAX_FRAMES} at most.",
            hint="Export it as csv, trc or parquet.",
        )
    points_mm = np.full((4, n_markers, n_rows), np.nan)
    for start, position_m in markers.blocks():
        points_mm[:3, :, start : start + len(position_m)] = position_m.transpose(2, 1, 0) * MM_PER_M
    content: Any = ezc3d.c3d()
    point = content["parameters"]["POINT"]
    point["RATE"]["value"] = [markers.rate_hz]
    point["LABELS"]["value"] = list(markers.names)
    point["UNITS"]["value"] = ["mm"]
    for key, axis in zip(("X_SCREEN", "Y_SCREEN"), SCREEN.get(markers.up_axis, ()), strict=False):
        content.add_parameter("POINT", key, [axis])
    points_mm[3] = 1.0
    residuals = np.where(np.isnan(points_mm[0]), -1.0, 0.0)
    content["data"]["points"] = points_mm
    content["data"]["meta_points"]["residuals"] = residuals[None]
    content["data"]["meta_points"]["camera_masks"] = np.zeros((7, n_markers, n_rows), bool)
    _write(content, path, least_bytes=POINT_BYTES * n_markers * n_rows)


def _write(content: Any, path: Path, least_bytes: int) -> None:
    """Write to `path`, whatever its suffix; ezc3d adds its own, and says nothing where the disk is full."""
    named = path.with_name(f"{path.name}.c3d")
    try:
        named.touch()  # what keeps it from being written is told by the system
        content.write(str(named))
        if named.stat().st_size < least_bytes:
            raise RecordingError(f"The file is incomplete: {least_bytes} bytes did not fit.", hint="Is the disk full?")
        named.replace(path)
    finally:
        named.unlink(missing_ok=True)
