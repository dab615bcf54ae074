"""From what the scene shows to what Motive would send of it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench.drivers.tracker.natnet.frame import BODY, HAS_MODEL, LABELED, Frame
from bench.drivers.tracker.natnet.models import MarkerSetModel, Model, RigidBodyModel
from bench.drivers.tracker.natnet.wire import Version
from bench.model import RigidBody
from bench.simulation.natnet.timing import Stamps
from bench.simulation.scene import Exposure, Scene

__all__ = ["APP_VERSIONS", "choose_version", "make_frame", "make_models"]

APP_VERSIONS: dict[Version, Version] = {
    (3, 0): (2, 0, 0, 0),
    (3, 1): (2, 1, 0, 0),
    (4, 0): (3, 0, 0, 0),
    (4, 1): (3, 1, 0, 0),
    (4, 2): (3, 2, 0, 0),
    (4, 3): (3, 3, 0, 0),
}
"""NatNet versions we simulate, and the Motive that has each of them."""
CHOOSING_SINCE: Version = (4, 0)
"""From here a unicast client may ask for an older bitstream."""

UNSEEN_MARKERS_M = np.array([[0.04, 0.0, 0.0], [-0.02, 0.035, 0.0], [-0.02, -0.035, 0.0]])
"""(3, 3): markers of a body that is defined and not seen."""
PTP_FRACTIONS = 1 << 32
"""Parts of a second in the fraction of a PTP time."""


def choose_version(own: Version, wanted: Version | None) -> Version:
    """Return the bitstream version a client gets that wants `wanted` from a server of version `own`."""
    if wanted is None or own < CHOOSING_SINCE or wanted[:2] not in APP_VERSIONS:
        return own
    return min(own, wanted[:2])


def make_frame(
    exposure: Exposure,
    frame_number: int,
    timestamp_s: float,
    stamps: Stamps,
    *,
    params: int = 0,
    ptp_ns: int | None = None,
    unseen: Mapping[int, str] | None = None,
) -> Frame:
    """Fill a frame as Motive does: every point among the labeled ones, and the bodies' markers in the others again.

    Parameters
    ----------
    exposure : Exposure
    frame_number, timestamp_s : int, float
        Since Motive's start.
    stamps : Stamps
    params : int
        Bits of the frame.
    ptp_ns : int, optional
        Time of a PTP clock, if there is one.
    unseen : mapping, optional
        Ids of bodies that no camera sees.
    """
    labeled = np.empty(len(exposure.ids), dtype=LABELED)
    labeled["id"] = exposure.ids
    labeled["position_m"] = exposure.points_m
    labeled["size_m"] = exposure.size_m
    labeled["params"] = exposure.flags
    labeled["residual_m"] = exposure.residual_m
    return Frame(
        frame_number=frame_number,
        labeled=labeled,
        bodies=np.array([*map(_body_row, exposure.bodies), *map(_unseen_row, unseen or ())], dtype=BODY),
        other_m=exposure.points_m[(exposure.flags & HAS_MODEL) != 0],
        timestamp_s=timestamp_s,
        mid_exposure=stamps[0],
        data_received=stamps[1],
        transmit=stamps[2],
        ptp=(0, 0) if ptp_ns is None else _ptp_time(ptp_ns),
        params=params,
    )


def make_models(scene: Scene, unseen: Mapping[int, str] | None = None) -> tuple[Model, ...]:
    """Describe the scene's rigid bodies and those that no camera sees, each also as a set of markers."""
    models: list[Model] = []
    bodies = scene.bodies | {body_id: (name, UNSEEN_MARKERS_M) for body_id, name in (unseen or {}).items()}
    for body_id, (name, offsets_m) in bodies.items():
        names = tuple(f"Marker{i + 1}" for i in range(len(offsets_m)))
        models.append(RigidBodyModel(name, body_id, np.asarray(offsets_m, dtype=np.float32), marker_names=names))
        models.append(MarkerSetModel(name, names))
    everything = tuple(f"{name}_{i + 1}" for name, offsets_m in bodies.values() for i in range(len(offsets_m)))
    return (*models, MarkerSetModel("all", everything))


def _ptp_time(ptp_ns: int) -> tuple[int, int]:
    seconds, ns = divmod(ptp_ns, 1_000_000_000)
    return seconds, ns * PTP_FRACTIONS // 1_000_000_000


def _unseen_row(body_id: int) -> tuple[object, ...]:
    # Motive sends bodies that it does not track too, at the origin, without the bit that says that it does.
    return body_id, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 0.0, 0


def _body_row(body: RigidBody) -> tuple[object, ...]:
    return body.body_id, body.position_m, body.quaternion_xyzw, body.mean_error_m, int(body.tracking_valid)
