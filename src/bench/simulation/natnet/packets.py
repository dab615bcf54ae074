"""From what the scene shows to what Motive would send of it."""

from __future__ import annotations

import numpy as np

from bench.drivers.tracker.natnet.frame import BODY, HAS_MODEL, LABELED, RECORDING, Frame
from bench.drivers.tracker.natnet.models import MarkerSetModel, Model, RigidBodyModel
from bench.drivers.tracker.natnet.wire import Version
from bench.model import RigidBody
from bench.simulation.scene import Exposure, Scene

__all__ = ["APP_VERSIONS", "NEWEST_VERSION", "Stamps", "choose_version", "make_frame", "make_models"]

APP_VERSIONS: dict[Version, Version] = {
    (3, 0): (2, 0, 0, 0),
    (3, 1): (2, 1, 0, 0),
    (4, 0): (3, 0, 0, 0),
    (4, 1): (3, 1, 0, 0),
}
"""NatNet versions we simulate, and the Motive that has each of them."""
NEWEST_VERSION: Version = (4, 1)
CHOOSING_SINCE: Version = (4, 0)
"""From here a unicast client may ask for an older bitstream."""

Stamps = tuple[int, int, int]
"""Ticks of mid-exposure, camera data received, transmit."""


def choose_version(own: Version, wanted: Version | None) -> Version:
    """Return the bitstream version a client gets that wants `wanted` from a server of version `own`."""
    if wanted is None or own < CHOOSING_SINCE or wanted[:2] not in APP_VERSIONS:
        return own
    return min(own, wanted[:2])


def make_frame(exposure: Exposure, frame_number: int, timestamp_s: float, stamps: Stamps, *, recording: bool) -> Frame:
    """Fill a frame as Motive does: every point among the labeled ones, and the bodies' markers in the others again."""
    labeled = np.empty(len(exposure.ids), dtype=LABELED)
    labeled["id"] = exposure.ids
    labeled["position_m"] = exposure.points_m
    labeled["size_m"] = exposure.size_m
    labeled["params"] = exposure.flags
    labeled["residual_m"] = exposure.residual_m
    return Frame(
        frame_number=frame_number,
        labeled=labeled,
        bodies=np.array([_body_row(body) for body in exposure.bodies], dtype=BODY),
        other_m=exposure.points_m[(exposure.flags & HAS_MODEL) != 0],
        timestamp_s=timestamp_s,
        mid_exposure=stamps[0],
        data_received=stamps[1],
        transmit=stamps[2],
        params=RECORDING if recording else 0,
    )


def make_models(scene: Scene) -> tuple[Model, ...]:
    """Describe the scene's rigid bodies, each also as a set of markers."""
    models: list[Model] = []
    for body_id, (name, offsets_m) in scene.bodies.items():
        names = tuple(f"Marker{i + 1}" for i in range(len(offsets_m)))
        models.append(RigidBodyModel(name, body_id, np.asarray(offsets_m, dtype=np.float32), marker_names=names))
        models.append(MarkerSetModel(name, names))
    everything = tuple(f"{name}_{i + 1}" for name, offsets_m in scene.bodies.values() for i in range(len(offsets_m)))
    return (*models, MarkerSetModel("all", everything))


def _body_row(body: RigidBody) -> tuple[object, ...]:
    return body.body_id, body.position_m, body.quaternion_xyzw, body.mean_error_m, int(body.tracking_valid)
