"""The bytes QTM sends: strings, XML, events and frames, little endian, each with its size and type before it."""

from __future__ import annotations

from collections.abc import Mapping
from struct import Struct
from xml.sax.saxutils import escape

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from bench.drivers.tracker.qualisys.frames import (
    BODIES,
    BODY,
    FREE,
    FREE_MARKERS,
    LABELED,
    LABELED_MARKERS,
)
from bench.model import UNLABELED, RigidBody
from bench.simulation.scene import Exposure

__all__ = ["COMPONENTS", "HEADER", "PacketType", "encode", "encode_components", "encode_frame", "encode_settings"]

Bodies = Mapping[int, tuple[str, npt.NDArray[np.float64]]]

HEADER = Struct("<II")
FRAME = Struct("<QII")
COUNT = Struct("<Ihh")
COMPONENTS = {"3dres": LABELED_MARKERS, "3dnolabelsres": FREE_MARKERS, "6dres": BODIES}
"""What can be streamed, by the protocol's own names."""
MILLIMETRES = np.float32(1e3)


class PacketType:
    """Types of packets."""

    ERROR, COMMAND, XML, DATA, NO_MORE_DATA, EVENT = 0, 1, 2, 3, 4, 6


def encode(kind: int, content: bytes) -> bytes:
    """Return a packet of any type."""
    return HEADER.pack(HEADER.size + len(content), kind) + content


def encode_settings(version: str, rate_hz: float, bodies: Bodies) -> bytes:
    """Return the answer to ``GetParameters``, whichever blocks were asked for: clients pick what they want."""
    labels = "".join(f"<Label><Name>{escape(name)}</Name></Label>" for name in _labels(bodies))
    listed = "".join(f"<Body><Name>{escape(name)}</Name>{_points(at)}</Body>" for name, at in bodies.values())
    text = (
        f"<QTM_Parameters_Ver_{version}><General><Frequency>{rate_hz:g}</Frequency></General>"
        f"<The_3D><AxisUpwards>+Y</AxisUpwards><Labels>{len(_labels(bodies))}</Labels>{labels}</The_3D>"
        f"<The_6D><Bodies>{len(bodies)}</Bodies>{listed}</The_6D></QTM_Parameters_Ver_{version}>"
    )
    return encode(PacketType.XML, text.encode() + b"\0")


def encode_components(exposure: Exposure, bodies: Bodies) -> dict[int, bytes]:
    """Return every component of one exposure, with its header, by its type."""
    is_free = (exposure.flags & UNLABELED) != 0
    free = np.empty(int(is_free.sum()), dtype=FREE)
    free["position_mm"] = exposure.points_m[is_free] * MILLIMETRES
    free["id"] = exposure.ids[is_free]
    free["residual_mm"] = exposure.residual_m[is_free] * MILLIMETRES
    rows = {
        LABELED_MARKERS: _label(exposure, ~is_free, bodies),
        FREE_MARKERS: free,
        BODIES: _pose(exposure.bodies, bodies),
    }
    return {kind: _component(kind, items) for kind, items in rows.items()}


def encode_frame(ticks: int, number: int, components: Mapping[int, bytes], wanted: tuple[int, ...]) -> bytes:
    """Return the data packet of one frame with the components a client asked for."""
    content = b"".join(components[kind] for kind in wanted)
    return encode(PacketType.DATA, FRAME.pack(ticks, number, len(wanted)) + content)


def _component(kind: int, items: npt.NDArray[np.void]) -> bytes:
    content = COUNT.pack(len(items), 0, 0) + items.tobytes()
    return HEADER.pack(HEADER.size + len(content), kind) + content


def _label(exposure: Exposure, is_labeled: npt.NDArray[np.bool_], bodies: Bodies) -> npt.NDArray[np.void]:
    """Every label has its place in every frame, with NaN while it is not seen."""
    places = {(body_id << 16) | (i + 1): None for body_id, (_, at) in bodies.items() for i in range(len(at))}
    place_of = {marker_id: place for place, marker_id in enumerate(places)}
    items = np.full(len(places), np.nan, dtype=LABELED)
    for row in np.flatnonzero(is_labeled):
        place = place_of[int(exposure.ids[row])]
        items[place] = (exposure.points_m[row] * MILLIMETRES, exposure.residual_m[row] * MILLIMETRES)
    return items


def _pose(seen: tuple[RigidBody, ...], bodies: Bodies) -> npt.NDArray[np.void]:
    items = np.full(len(bodies), np.nan, dtype=BODY)
    place_of = {body_id: place for place, body_id in enumerate(bodies)}
    for body in seen:
        if body.tracking_valid:
            columns = Rotation.from_quat(body.quaternion_xyzw).as_matrix().T
            position = np.array(body.position_m) * 1e3
            items[place_of[body.body_id]] = (position, columns, body.mean_error_m * 1e3)
    return items


def _labels(bodies: Bodies) -> list[str]:
    return [f"{name} - {i + 1}" for name, at in bodies.values() for i in range(len(at))]


def _points(offsets_m: npt.NDArray[np.float64]) -> str:
    return "".join(f"<Point><X>{x:g}</X><Y>{y:g}</Y><Z>{z:g}</Z></Point>" for x, y, z in (offsets_m * 1e3).tolist())
