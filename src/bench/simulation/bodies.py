"""Rigid bodies: markers that move as one solid, at the pole, at the cable's end and on the robot's flange."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from bench.config import Config
from bench.errors import ConfigError
from bench.model import RigidBody
from bench.simulation.cable import Cable, PlaceTable

__all__ = ["BODY_SIZE", "FLANGE_MOUNT_M", "FLANGE_MOUNT_XYZW", "Body", "BodyTable", "make_bodies"]

Floats = npt.NDArray[np.float64]
Quaternion = tuple[float, float, float, float]

BODY_SIZE = 4
"""Markers of every body here."""
ALL = 3 * BODY_SIZE
"""Coordinates of a body's markers."""
# Each (4, 3): markers about their centre of gravity, in the body's own coordinates. No two of the 18 distances are
# nearer than 2 mm, as a tracker that has to tell the bodies apart asks for.
POLE_MARKERS_M = np.array([[0.06, 0.01, -0.02], [-0.05, 0.03, -0.02], [0.01, -0.07, -0.01], [-0.02, 0.03, 0.05]])
END_MARKERS_M = np.array([[-0.05, 0.04, -0.04], [-0.04, -0.05, 0.03], [0.02, -0.03, -0.05], [0.07, 0.04, 0.06]])
FLANGE_MARKERS_M = np.array([[-0.06, -0.07, -0.07], [0.07, 0.04, -0.02], [-0.06, 0.05, 0.05], [0.05, -0.02, 0.04]])
POLE_TURN_RAD = (0.3, -0.8, 0.2)
"""Rotation vector of the pole's body in the lab frame."""
FLANGE_MOUNT_M = (0.034, -0.041, 0.052)
FLANGE_MOUNT_XYZW = (0.2, -0.4, 0.4, 0.8)
"""Pose of the flange's body in the tool's frame, as a bracket might hold it: what a calibration has to find."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A rigid body along the robot's path; n is the number of places, or 1 where it stands still."""

    body_id: int
    name: str
    markers_m: Floats
    """(BODY_SIZE, 3): its markers about its centre in its own coordinates."""
    centres_m: Floats
    """(n, 3): lab frame."""
    quaternions: Floats
    """(n, 4): x, y, z, w in the lab frame, without jumps of sign."""
    mount_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    """Of a body on the flange: its pose in the tool's frame."""

    def facts(self) -> dict[str, object]:
        """Return its name and its pose in the tool's frame, as JSON has it."""
        return {"name": self.name, "shift_m": list(self.mount_m), "quaternion_xyzw": list(self.mount_xyzw)}

    def marker_positions(self) -> Floats:
        """Return (n, BODY_SIZE, 3): where its markers are in the lab frame."""
        turns = Rotation.from_quat(self.quaternions).as_matrix()
        return np.asarray(self.centres_m[:, None] + np.einsum("nij,mj->nmi", turns, self.markers_m))


def make_bodies(config: Config, cable: Cable) -> tuple[Body, ...]:
    """Return the bodies a configuration names: of the cable's anchor, of its end, and on the robot's flange.

    Raises
    ------
    ConfigError
        Two of them have one name where they are not the same body, or a static marker is to move.
    """
    anchor, end, flange_name = config.cable.anchor, config.cable.end, config.calibration.flange_body
    if end is not None and end.kind == "static_marker":
        raise ConfigError(
            "The simulated cable's end moves with the robot: [cable.end] kind = 'static_marker' cannot be simulated.",
            hint="Use kind = 'rigid_body', or leave [cable.end] out.",
        )
    ends = cable.points_along_path((0.0, cable.length_m))
    turns = cable.flange_quaternions()
    bodies: list[Body] = []
    if anchor.kind == "rigid_body":
        at_pole = Rotation.from_rotvec([POLE_TURN_RAD]).as_quat()
        bodies.append(Body(1, anchor.name, POLE_MARKERS_M, ends[:1, 0], at_pole))
    if end is not None and end.kind == "rigid_body":
        bodies.append(Body(len(bodies) + 1, end.name, END_MARKERS_M, ends[:, 1], turns))
    # A body that holds the cable's end is on the flange already.
    if flange_name and not (end is not None and end.name == flange_name):
        bodies.append(_mount(len(bodies) + 1, flange_name, ends[:, 1], turns))
    _verify_names(bodies)
    return tuple(bodies)


class BodyTable:
    """Poses of all bodies along the path, and what a tracker makes of them that measures their markers with noise.

    Parameters
    ----------
    bodies : tuple of Body
    n_places : int
        Places along the path.
    """

    def __init__(self, bodies: tuple[Body, ...], n_places: int) -> None:
        self._bodies = bodies
        poses, fits = np.empty((n_places, len(bodies), 7)), np.empty((n_places, len(bodies), 6 + ALL, ALL))
        for index, body in enumerate(bodies):
            poses[:, index, :3] = body.centres_m
            poses[:, index, 3:] = body.quaternions
            fits[:, index] = _fits(body.marker_positions() - body.centres_m[:, None])
        self._poses, self._fits = PlaceTable(poses), PlaceTable(fits)

    def measure(self, place: float, noise_m: Floats) -> tuple[RigidBody, ...]:
        """Return the bodies as fitted by least squares to markers with errors (b * BODY_SIZE, 3)."""
        poses = self._poses.at(place)
        fitted = (self._fits.at(place) @ noise_m.reshape(len(self._bodies), ALL, 1))[..., 0]
        poses[:, :3] += fitted[:, :3]
        left = fitted[:, 6:].reshape(-1, BODY_SIZE, 3)
        errors = np.sqrt((left * left).sum(axis=2)).mean(axis=1)
        rows = zip(self._bodies, poses.tolist(), fitted[:, 3:6].tolist(), errors.tolist(), strict=True)
        return tuple(
            RigidBody(body.body_id, (x, y, z), _turned((qx, qy, qz, qw), turn), error)
            for body, (x, y, z, qx, qy, qz, qw), turn, error in rows
        )


def _fits(arms: Floats) -> Floats:
    """Return what makes shift, turn and remaining errors (6 + ALL) of markers' errors (ALL), for each place.

    `arms` (n, BODY_SIZE, 3) are the markers about their centre. The turn w that fits best is the one whose moments are
    those of the errors e: sum(r x (w x r)) = sum(r x e).
    """
    cross = np.cross(arms[:, :, None, :], np.eye(3)).swapaxes(2, 3)  # r x e = cross @ e
    inertia = -np.einsum("nmij,nmjk->nik", cross, cross)
    moments = cross.swapaxes(1, 2).reshape(len(arms), 3, ALL)
    turn = np.linalg.solve(inertia, moments)
    shift = np.broadcast_to(np.tile(np.eye(3), BODY_SIZE) / BODY_SIZE, turn.shape)
    # What is left of e: e - shift - w x r, and w x r = -cross @ w.
    left = np.eye(ALL) - np.tile(shift, (1, BODY_SIZE, 1)) + cross.reshape(len(arms), ALL, 3) @ turn
    return np.concatenate([shift, turn, left], axis=1)


def _turned(xyzw: Quaternion, turn_rad: list[float]) -> Quaternion:
    """Turn an orientation by a small rotation vector of the lab frame."""
    x, y, z, w = xyzw
    a, b, c = (0.5 * angle for angle in turn_rad)
    turned = (
        x + w * a + b * z - c * y,
        y + w * b + c * x - a * z,
        z + w * c + a * y - b * x,
        w - a * x - b * y - c * z,
    )
    size = math.hypot(*turned)
    return turned[0] / size, turned[1] / size, turned[2] / size, turned[3] / size


def _mount(body_id: int, name: str, flange_m: Floats, turns: Floats) -> Body:
    flange = Rotation.from_quat(turns)
    quaternions = (flange * Rotation.from_quat(FLANGE_MOUNT_XYZW)).as_quat()
    centres_m = flange_m + flange.apply(FLANGE_MOUNT_M)
    return Body(body_id, name, FLANGE_MARKERS_M, centres_m, quaternions, FLANGE_MOUNT_M, FLANGE_MOUNT_XYZW)


def _verify_names(bodies: list[Body]) -> None:
    names = [body.name for body in bodies]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ConfigError(
            f"Two places have the rigid body '{twice[0]}': [cable.anchor], [cable.end] and [calibration] flange_body "
            "name one each.",
            hint="Give them different names; only flange_body may be the body of [cable.end].",
        )
