"""MODELDEF: what the tracker's software knows by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from struct import Struct

import numpy as np
import numpy.typing as npt

from bench.drivers.tracker.natnet.frame import NEWEST_KNOWN
from bench.drivers.tracker.natnet.wire import Message, Reader, Version, encode_packet, pack_text
from bench.errors import ProtocolError

__all__ = ["MarkerSetModel", "Model", "OtherModel", "RigidBodyModel", "decode_models", "encode_models"]

MARKER_SET, RIGID_BODY, SKELETON, FORCE_PLATE, DEVICE, CAMERA = range(6)
COUNT = Struct("<i")
ITEM_SIZE_SINCE = (4, 1)
ROTATION_SINCE = (4, 2)
MARKER_NAMES_SINCE = (4, 0)
MARKERS_SINCE = (3, 0)
POSE = Struct("<ii3f")
QUATERNION = Struct("<4f")
FORCE_PLATE_BYTES = 4 * (2 + 3 + 12 * 12 + 4 * 3 + 2)
"""Width, length, origin, calibration matrix, corners, two types."""
NO_MARKERS = np.zeros((0, 3), dtype=np.float32)
SMALLEST_BODY = 1 + POSE.size
"""Bytes of a rigid body without a name, before NatNet 3."""


@dataclass(frozen=True, slots=True)
class MarkerSetModel:
    """A named list of markers."""

    name: str
    marker_names: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class RigidBodyModel:
    """A rigid body as it was defined: its name, and where its markers are in its own frame."""

    name: str
    body_id: int
    markers_m: npt.NDArray[np.float32]
    """Shape (m, 3), in the body's frame; empty before NatNet 3, which does not tell them."""
    parent_id: int = -1
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    """Since NatNet 4.2."""
    labels: tuple[int, ...] = ()
    """Active labels; 0 for passive markers."""
    marker_names: tuple[str, ...] = ()
    """Since NatNet 4.0."""


@dataclass(frozen=True, slots=True)
class OtherModel:
    """A skeleton, force plate, device, camera or asset: kept as it came."""

    kind: int
    body: bytes


Model = MarkerSetModel | RigidBodyModel | OtherModel


def decode_models(payload: bytes, version: Version) -> tuple[Model, ...]:
    """Decode a MODELDEF.

    Raises
    ------
    ProtocolError
        Cut short, of another version, or (before NatNet 4.1, where items tell no size) with an item of unknown kind.
    """
    reader = Reader(payload, "MODELDEF")
    return tuple(_decode_item(reader, version) for _ in range(reader.count(4)))


def encode_models(models: tuple[Model, ...], version: Version) -> bytes:
    """Encode a MODELDEF."""
    parts = [COUNT.pack(len(models))]
    for model in models:
        kind, body = _encode_item(model, version)
        size = COUNT.pack(len(body)) if version >= ITEM_SIZE_SINCE else b""
        parts += [COUNT.pack(kind), size, body]
    return encode_packet(Message.MODELDEF, b"".join(parts))


def _decode_item(reader: Reader, version: Version) -> Model:
    kind = reader.integer()
    if version < ITEM_SIZE_SINCE:
        return _decode_body(reader, kind, version)
    start = reader.advance(reader.count(1))
    item = Reader(reader.data, reader.what, start, reader.offset)
    model = _decode_body(item, kind, version) if kind in (MARKER_SET, RIGID_BODY) else _keep(item, kind)
    if item.remaining and version[:2] <= NEWEST_KNOWN:
        raise ProtocolError(f"An item of a NatNet MODELDEF has {item.remaining} bytes more than version {version} has.")
    return model


def _keep(item: Reader, kind: int) -> OtherModel:
    return OtherModel(kind, item.take(item.remaining))


def _decode_body(reader: Reader, kind: int, version: Version) -> Model:
    if kind == MARKER_SET:
        return MarkerSetModel(reader.text(), _texts(reader))
    if kind == RIGID_BODY:
        return _decode_rigid_body(reader, version)
    skip = SKIP.get(kind)
    if skip is None:
        raise ProtocolError(f"A NatNet MODELDEF of version {version} holds an item of unknown kind {kind}.")
    start = reader.offset
    skip(reader, version)
    return OtherModel(kind, reader.data[start : reader.offset])


def _texts(reader: Reader) -> tuple[str, ...]:
    return tuple(reader.text() for _ in range(reader.count(1)))


def _decode_rigid_body(reader: Reader, version: Version) -> RigidBodyModel:
    name = reader.text()
    body_id, parent_id, x, y, z = reader.unpack(POSE)
    qx, qy, qz, qw = reader.unpack(QUATERNION) if version >= ROTATION_SINCE else (0.0, 0.0, 0.0, 1.0)
    if version < MARKERS_SINCE:
        return RigidBodyModel(name, body_id, NO_MARKERS, parent_id, (x, y, z))
    n = reader.count(16)
    markers = np.frombuffer(reader.take(12 * n), dtype="<f4").reshape(n, 3)
    labels = np.frombuffer(reader.take(4 * n), dtype="<i4")
    names = tuple(reader.text() for _ in range(n)) if version >= MARKER_NAMES_SINCE else ()
    return RigidBodyModel(name, body_id, markers, parent_id, (x, y, z), (qx, qy, qz, qw), tuple(labels.tolist()), names)


def _skip_skeleton(reader: Reader, version: Version) -> None:
    reader.text()
    reader.advance(4)
    for _ in range(reader.count(SMALLEST_BODY)):
        _decode_rigid_body(reader, version)


def _skip_force_plate(reader: Reader, version: Version) -> None:  # noqa: ARG001 - one signature for all kinds
    reader.advance(4)
    reader.text()
    reader.advance(FORCE_PLATE_BYTES)
    _texts(reader)


def _skip_device(reader: Reader, version: Version) -> None:  # noqa: ARG001
    reader.advance(4)
    reader.text()
    reader.text()
    reader.advance(8)
    _texts(reader)


def _skip_camera(reader: Reader, version: Version) -> None:  # noqa: ARG001
    reader.text()
    reader.advance(28)


SKIP: dict[int, Callable[[Reader, Version], None]] = {
    SKELETON: _skip_skeleton,
    FORCE_PLATE: _skip_force_plate,
    DEVICE: _skip_device,
    CAMERA: _skip_camera,
}


def _encode_item(model: Model, version: Version) -> tuple[int, bytes]:
    if isinstance(model, OtherModel):
        return model.kind, model.body
    if isinstance(model, MarkerSetModel):
        names = b"".join(pack_text(name) for name in model.marker_names)
        return MARKER_SET, pack_text(model.name) + COUNT.pack(len(model.marker_names)) + names
    return RIGID_BODY, _encode_rigid_body(model, version)


def _encode_rigid_body(model: RigidBodyModel, version: Version) -> bytes:
    n = len(model.markers_m)
    labels = model.labels or (0,) * n
    parts = [pack_text(model.name), POSE.pack(model.body_id, model.parent_id, *model.offset_m)]
    if version < MARKERS_SINCE:
        return b"".join(parts)
    if version >= ROTATION_SINCE:
        parts.append(QUATERNION.pack(*model.quaternion_xyzw))
    parts += [COUNT.pack(n), model.markers_m.astype("<f4").tobytes(), np.array(labels, dtype="<i4").tobytes()]
    if version >= MARKER_NAMES_SINCE:
        names = model.marker_names or tuple(f"Marker{i + 1}" for i in range(n))
        parts += [pack_text(name) for name in names]
    return b"".join(parts)
