"""What is there to be seen: the markers on the cable, at its pole and on its rigid bodies, place by place."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.config import Config, SimulationConfig
from bench.errors import ConfigError
from bench.model import RigidBody
from bench.simulation.bodies import BODY_SIZE, BodyTable, make_bodies
from bench.simulation.cable import Cable, PlaceTable

__all__ = ["Markers"]

Floats = npt.NDArray[np.float64]

CLOSEST_M = 0.01
"""Size of a marker."""
MOST_OF_GAP = 0.4
"""A marker is placed wrongly by at most this share of the distance to the next one: their order is known."""
MOUNTING_STREAM = 1
"""Of the seed: what is drawn here is the same whatever else is."""


class Markers:
    """Every physical marker: the cable's k, then the static one and the sync lamp if there are, the bodies' four each.

    Parameters
    ----------
    config : Config
        The cable's markers, its anchor and its end, the flange's body.
    cable : Cable
        Whose shape carries them.
    """

    def __init__(self, config: Config, cable: Cable) -> None:
        self.n_cable = len(config.cable.arc_length_m)
        self.has_static = config.cable.anchor.kind == "static_marker"
        self.lamp_m = config.calibration.sync_marker_m
        """Place of the lamp that a digital output switches; None without one. It is the last of the loose markers."""
        if self.has_static and config.cable.arc_length_m[0] < CLOSEST_M:
            raise ConfigError(
                f"The first marker, at {config.cable.arc_length_m[0]:g} m, lies on the pole's static marker.",
                hint=f"Put it at {CLOSEST_M:g} m or beyond: markers closer than their own size are seen as one.",
            )
        self.bodies = make_bodies(config, cable)
        self._mount(config)
        self.table = PlaceTable(self._positions(cable))
        """(n_markers, 3): lab frame positions of all of them."""
        self._body_table = BodyTable(self.bodies, cable.n_places)

    def _mount(self, config: Config) -> None:
        simulation = config.simulation or SimulationConfig()
        rng = np.random.default_rng((simulation.seed, MOUNTING_STREAM))
        wanted_m = np.array(config.cable.arc_length_m)
        gaps_m = np.diff(wanted_m, prepend=0.0, append=config.cable.length_m)
        error_m = rng.normal(scale=simulation.placement_sd_mm * 1e-3, size=self.n_cable)
        self.arc_length_m = wanted_m + np.clip(error_m, -MOST_OF_GAP * gaps_m[:-1], MOST_OF_GAP * gaps_m[1:])
        """(k,): where each of the cable's markers really is."""
        self.offsets_m = rng.normal(scale=simulation.mounting_sd_mm * 1e-3, size=(2, self.n_cable))
        """(2, k): how far each of them is to the side of the centreline, and above it."""

    @property
    def n_loose(self) -> int:
        """Markers that belong to no rigid body."""
        return self.n_cable + self.has_static + (self.lamp_m is not None)

    def measure_bodies(self, place: float, noise_m: Floats) -> tuple[RigidBody, ...]:
        """Return the bodies as the tracker fits them to their markers, which it measures with `noise_m`."""
        return self._body_table.measure(place, noise_m) if self.bodies else ()

    def _positions(self, cable: Cable) -> Floats:
        side, above = cable.axes_along_path(self.arc_length_m)
        off_m = self.offsets_m[0, :, None] * side + self.offsets_m[1, :, None] * above
        parts = [cable.points_along_path(self.arc_length_m) + off_m]
        if self.has_static:
            parts.append(cable.points_along_path((0.0,)))
        if self.lamp_m is not None:
            parts.append(np.broadcast_to(self.lamp_m, (cable.n_places, 1, 3)))
        parts += [np.broadcast_to(body.marker_positions(), (cable.n_places, BODY_SIZE, 3)) for body in self.bodies]
        return np.concatenate(parts, axis=1)
