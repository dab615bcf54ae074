"""From the components of one QTM data packet to a frame's points and rigid bodies.

Layouts from Qualisys' documentation of the real-time protocol: every component begins with its number of items and two
16-bit rates; lengths are millimetres; what is not seen has NaN for coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from struct import Struct

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from bench.errors import ProtocolError
from bench.model import UNLABELED, RigidBody

__all__ = [
    "BODIES",
    "BODY",
    "FREE",
    "FREE_MARKERS",
    "LABELED",
    "LABELED_MARKERS",
    "Points",
    "read_bodies",
    "read_points",
]

LABELED_MARKERS, FREE_MARKERS, BODIES = 9, 10, 11
"""Component types: 3D with residuals, 3D no labels with residuals, 6D with residuals."""
LABELED = np.dtype([("position_mm", "<f4", 3), ("residual_mm", "<f4")])
FREE = np.dtype([("position_mm", "<f4", 3), ("id", "<u4"), ("residual_mm", "<f4")])
BODY = np.dtype([("position_mm", "<f4", 3), ("rotation", "<f4", (3, 3)), ("residual_mm", "<f4")])
"""The rotation matrix comes column by column."""
COUNT = Struct("<Ihh")
METRES = np.float32(1e-3)
SMALLEST_DETERMINANT = 0.5
"""A rotation has 1; what is far from it is none, and no pose can be made of it."""
NO_QUATERNION = (float("nan"),) * 4


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Identified points first, then the others; see `bench.model.TrackerFrame`."""

    points_m: npt.NDArray[np.float32]
    ids: npt.NDArray[np.uint32]
    flags: npt.NDArray[np.uint32]
    residual_m: npt.NDArray[np.float32]


def read_points(data: bytes, places: Mapping[int, int]) -> Points:
    """Return every point that was seen.

    Parameters
    ----------
    data : bytes
        A data packet after its header.
    places : mapping of int to int
        Where the content of each component begins, by its type.

    Raises
    ------
    ProtocolError
        A component is shorter than it says.
    """
    labeled, free = _read(data, places, LABELED_MARKERS, LABELED), _read(data, places, FREE_MARKERS, FREE)
    seen = np.flatnonzero(np.isfinite(labeled["position_mm"]).all(axis=1))
    position = np.concatenate([labeled["position_mm"][seen], free["position_mm"]])
    residual = np.concatenate([labeled["residual_mm"][seen], free["residual_mm"]])
    flags = np.zeros(len(position), dtype=np.uint32)
    flags[len(seen) :] = UNLABELED
    ids = np.concatenate([seen + 1, free["id"]]).astype(np.uint32)
    return Points(position * METRES, ids, flags, residual * METRES)


def read_bodies(data: bytes, places: Mapping[int, int]) -> tuple[RigidBody, ...]:
    """Return all rigid bodies, numbered from 1 in QTM's order; those not seen are marked as such. Raises as above."""
    rows = _read(data, places, BODIES, BODY)
    return tuple(_make_body(index + 1, row) for index, row in enumerate(rows))


def _make_body(body_id: int, row: np.void) -> RigidBody:
    position, columns = row["position_mm"].astype(np.float64) * 1e-3, row["rotation"].astype(np.float64)
    x, y, z = position.tolist()
    is_seen = bool(np.isfinite(position).all() and np.isfinite(columns).all())
    if not is_seen or np.linalg.det(columns) < SMALLEST_DETERMINANT:
        return RigidBody(body_id, (x, y, z), NO_QUATERNION, tracking_valid=False)
    qx, qy, qz, qw = Rotation.from_matrix(columns.T).as_quat().tolist()
    return RigidBody(body_id, (x, y, z), (qx, qy, qz, qw), float(row["residual_mm"]) * 1e-3)


def _read(data: bytes, places: Mapping[int, int], kind: int, layout: np.dtype[np.void]) -> npt.NDArray[np.void]:
    start = places.get(kind)
    if start is None:
        return np.zeros(0, dtype=layout)
    if start + COUNT.size > len(data):
        raise ProtocolError(f"A QTM packet of {len(data)} bytes ends before its component {kind} begins.")
    n_items = COUNT.unpack_from(data, start)[0]
    needed = start + COUNT.size + n_items * layout.itemsize
    if needed > len(data):
        raise ProtocolError(
            f"A QTM packet of {len(data)} bytes claims {n_items} items in component {kind}, which end at byte {needed}."
        )
    return np.frombuffer(data, dtype=layout, count=n_items, offset=start + COUNT.size)
