"""What is there to be seen: the markers on the cable, at its pole and on its rigid bodies, place by place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from bench.config import AnchorConfig, Config
from bench.errors import ConfigError
from bench.simulation.cable import Cable, PlaceTable

__all__ = ["BODY_OFFSETS_M", "Body", "Markers"]

Floats = npt.NDArray[np.float64]

BODY_OFFSETS_M = np.array([[0.06, 0.01, -0.02], [-0.05, 0.03, -0.02], [0.01, -0.07, -0.01], [-0.02, 0.03, 0.05]])
"""(4, 3): markers of a rigid body about its centre of gravity, no two of them at the same distance from another."""
CLOSEST_M = 0.01
"""Size of a marker."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A rigid body whose centre of gravity is an end of the cable."""

    body_id: int
    name: str
    quaternions: Floats
    """(n, 4): x, y, z, w along the path, or one row where it stands still."""

    def marker_offsets(self) -> Floats:
        """Return (n, 4, 3): its markers about its centre in the lab frame, along the path."""
        turns = Rotation.from_quat(self.quaternions).as_matrix()
        return np.asarray(np.einsum("nij,mj->nmi", turns, BODY_OFFSETS_M))


class Markers:
    """Every physical marker: the cable's k first, then the static one if there is one, then the bodies' four each.

    Parameters
    ----------
    config : Config
        The cable's markers, its anchor and its end.
    cable : Cable
        Whose shape carries them.
    """

    def __init__(self, config: Config, cable: Cable) -> None:
        self.n_cable = len(config.cable.arc_length_m)
        self.has_static = config.cable.anchor.kind == "static_marker"
        if self.has_static and config.cable.arc_length_m[0] < CLOSEST_M:
            raise ConfigError(
                f"The first marker, at {config.cable.arc_length_m[0]:g} m, lies on the pole's static marker.",
                hint=f"Put it at {CLOSEST_M:g} m or beyond: markers closer than their own size are seen as one.",
            )
        self.bodies = _make_bodies(config.cable.anchor, config.cable.end, cable)
        self._table = PlaceTable(self._positions(config, cable))
        self._quaternions = PlaceTable(_stack_quaternions(self.bodies, cable.n_places))

    @property
    def n_loose(self) -> int:
        """Markers that belong to no rigid body."""
        return self.n_cable + self.has_static

    @property
    def n_markers(self) -> int:
        return self.n_loose + len(BODY_OFFSETS_M) * len(self.bodies)

    def positions_at(self, place: float) -> Floats:
        """Return (n_markers, 3) lab frame positions at one place of the path."""
        return self._table.at(place)

    def quaternions_at(self, place: float) -> Floats:
        """Return (n_bodies, 4) unit quaternions x, y, z, w."""
        q = self._quaternions.at(place)
        return np.asarray(q / np.sqrt((q * q).sum(axis=1, keepdims=True)))

    def _positions(self, config: Config, cable: Cable) -> Floats:
        on_cable = cable.points_along_path(config.cable.arc_length_m)
        ends = cable.points_along_path((0.0, cable.length_m))
        parts = [on_cable]
        if self.has_static:
            parts.append(ends[:, :1])
        for body in self.bodies:
            centre = ends[:, :1] if body.name == config.cable.anchor.name else ends[:, 1:]
            parts.append(centre + body.marker_offsets())
        return np.concatenate(parts, axis=1)


def _make_bodies(anchor: AnchorConfig, end: AnchorConfig | None, cable: Cable) -> list[Body]:
    if end is not None and end.kind == "static_marker":
        raise ConfigError(
            "The simulated cable's end moves with the robot: [cable.end] kind = 'static_marker' cannot be simulated.",
            hint="Use kind = 'rigid_body', or leave [cable.end] out.",
        )
    bodies = []
    if anchor.kind == "rigid_body":
        bodies.append(Body(1, anchor.name, Rotation.from_rotvec([[0.3, -0.8, 0.2]]).as_quat()))
    if end is not None and end.kind == "rigid_body":
        if end.name == anchor.name:
            raise ConfigError(f"[cable.anchor] and [cable.end] both name the rigid body '{end.name}'.")
        bodies.append(Body(len(bodies) + 1, end.name, cable.flange_quaternions()))
    return bodies


def _stack_quaternions(bodies: list[Body], n_places: int) -> Floats:
    stacked = np.empty((n_places, len(bodies), 4))
    for index, body in enumerate(bodies):
        stacked[:, index] = body.quaternions
    return stacked
