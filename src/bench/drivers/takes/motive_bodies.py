"""Where the markers of a Motive export's rigid bodies sit on them: the export says it only through the motion."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from bench.drivers.takes.columns import ColumnTable
from bench.drivers.takes.motive_header import BodyColumns, MotiveHeader, PointColumns

__all__ = ["find_body_markers"]

MAX_ROWS = 10_000
"""Rows searched for one where the body and all its markers are seen: a minute and a half at 120 Hz."""

Floats = npt.NDArray[np.float64]


def find_body_markers(table: ColumnTable, header: MotiveHeader) -> dict[str, list[list[float]]]:
    """Return each rigid body's markers in its own frame, in metres, from the first row that shows them all.

    The solved markers are taken where they were exported (the body's definition, moved with it), else the measured
    ones. A body without a rotation, or never seen whole, is left out.
    """
    wanted = {body.name: (body, points) for body in header.bodies if (points := _points_of(body, header))}
    found: dict[str, list[list[float]]] = {}
    lines = table.file.lines() if wanted else iter(())
    rows = ((line, text) for line, text in lines if line >= table.first_row and text.strip(" ,"))
    for line, text in islice(rows, MAX_ROWS):
        cells = table.cells(line, text)
        for name, (body, points) in list(wanted.items()):
            local = _local_points(table, line, cells, body, points, header)
            if local is not None:
                found[name] = local.round(6).tolist()  # a micrometre: the export has no more
                del wanted[name]
        if not wanted:
            break
    return found


def _points_of(body: BodyColumns, header: MotiveHeader) -> list[PointColumns]:
    if not (body.all_of("position", "XYZ") and body.all_of("rotation", "XYZW")):
        return []
    solved = [point for point in header.solved if header.body_of(point) is body]
    return solved or [point for point in header.markers if header.body_of(point) is body]


def _local_points(
    table: ColumnTable,
    line: int,
    cells: Sequence[str],
    body: BodyColumns,
    points: Sequence[PointColumns],
    header: MotiveHeader,
) -> Floats | None:
    """Return the points in the body's frame, None where the row does not show all of them."""

    def numbers(columns: Sequence[int]) -> Floats:
        return np.array([table.value(line, cells, column) for column in columns])

    position, rotation = numbers(body.all_of("position", "XYZ")), numbers(body.all_of("rotation", "XYZW"))
    seen = np.array([numbers(point.xyz) for point in points])
    if not (np.isfinite(position).all() and np.isfinite(seen).all() and np.linalg.norm(rotation) > 0.5):
        return None
    local: Floats = Rotation.from_quat(rotation).inv().apply((seen - position) * header.metres_per_unit)
    return local
