"""The simulated cable: its shape for every place of the robot's path, in the lab frame."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from bench.errors import ConfigError
from bench.simulation.elastica import Clamps, Elastica, Shape
from bench.simulation.layout import POLE_CLAMP_RAD, Layout
from bench.simulation.path import JointPath

__all__ = ["Cable", "PlaceTable"]

Floats = npt.NDArray[np.float64]
_Slope = tuple[Literal[1], Floats]

N_PLACES = 192
"""Shapes solved along the path; splines between them agree with a solved shape to well below 0.01 mm."""
FEWEST_SEGMENTS, MOST_SEGMENTS = 150, 1500
SEGMENTS_PER_DECAY = 15
"""Bending at a clamp decays over sqrt(EI / tension); so many segments within that give its peak to 0.1 %."""
TANGENT_STEP_M = 1e-4
"""Differences over twice this length give a tangent to 1e-6."""
CLOSURE_RAD = 1e-6
"""The shape after a whole path must be the one before it; another branch differs by tenths of a radian."""


class PlaceTable:
    """Quantities that change along the path, as periodic cubic splines: cheap to evaluate at any place.

    Parameters
    ----------
    values : (n + 1, ...) float
        At n + 1 equally spaced places from 0 to 1; the last row is the first one again.
    """

    def __init__(self, values: Floats) -> None:
        closed = np.array(values, dtype=np.float64)
        closed[-1] = closed[0]
        self._n_steps = len(closed) - 1
        spline = CubicSpline(np.arange(len(closed), dtype=np.float64), closed, bc_type="periodic")
        self._coefficients = np.ascontiguousarray(np.moveaxis(spline.c, 0, 1))

    def at(self, place: float) -> Floats:
        """Return the quantities at one place, 0 to 1."""
        scaled = min(max(place, 0.0), 1.0) * self._n_steps
        step = min(int(scaled), self._n_steps - 1)
        t = scaled - step
        c3, c2, c1, c0 = self._coefficients[step]
        return np.asarray(((c3 * t + c2) * t + c1) * t + c0)

    def at_many(self, places: Floats) -> Floats:
        """Return the quantities (m, ...) at m places, each 0 to 1."""
        scaled = np.clip(places, 0.0, 1.0) * self._n_steps
        steps = np.minimum(scaled.astype(np.intp), self._n_steps - 1)
        chosen = self._coefficients[steps]
        t = (scaled - steps).reshape(-1, *(1,) * (chosen.ndim - 2))
        return np.asarray(((chosen[:, 0] * t + chosen[:, 1]) * t + chosen[:, 2]) * t + chosen[:, 3])


class Cable:
    """A heavy, flexible cable clamped at the pole and at the robot's flange, always at rest (quasi-static).

    It hangs in the vertical plane in which the flange moves, so it neither twists nor leaves that plane; where that
    plane swings, the pole's clamp swivels with it and the flange's lets the cable turn. Measured on real flange motions
    up to 0.5 m/s, leaving out its inertia is worth 1 to 3 mm.

    Parameters
    ----------
    layout : Layout
        Where pole and robot stand, and how long the cable is.
    path : JointPath
        Where the flange goes.
    weight_n_per_m, stiffness_nm2 : float
        Weight per metre and bending stiffness EI.

    Raises
    ------
    ConfigError
        The cable cannot reach, or no stable shape is found that returns to itself after one cycle.
    """

    def __init__(self, layout: Layout, path: JointPath, *, weight_n_per_m: float, stiffness_nm2: float) -> None:
        self.layout = layout
        self.path = path
        n_segments = _n_segments(layout.length_m, weight_n_per_m, stiffness_nm2)
        self._rod = Elastica(layout.length_m, weight_n_per_m, stiffness_nm2, n_segments)
        self._shapes = self._solve()
        self._arc_length_m = np.linspace(0.0, layout.length_m, n_segments + 1)

    @property
    def length_m(self) -> float:
        return self.layout.length_m

    @property
    def n_places(self) -> int:
        """Places of the path at which the shape is solved, both ends counted."""
        return len(self._shapes)

    def points(self, arc_length_m: npt.ArrayLike) -> PlaceTable:
        """Return the lab frame positions (k, 3) of k places on the cable, for any place of the path.

        Parameters
        ----------
        arc_length_m : (k,) float
            From the pole's clamp.
        """
        return PlaceTable(self.points_along_path(arc_length_m))

    def points_along_path(self, arc_length_m: npt.ArrayLike) -> Floats:
        """Return the lab frame positions (n_places, k, 3) of k places on the cable, where they are solved."""
        ends = np.array([[s.clamps.start_rad, s.clamps.end_rad] for s in self._shapes])
        steps = np.array([[np.cos(s.angle_rad), np.sin(s.angle_rad)] for s in self._shapes]) * self._rod.segment_m
        nodes = np.concatenate([np.zeros((len(steps), 2, 1)), np.cumsum(steps, axis=2)], axis=2)
        tangents = np.stack([np.cos(ends), np.sin(ends)], axis=1)
        held: tuple[_Slope, _Slope] = ((1, tangents[:, :, 0]), (1, tangents[:, :, 1]))
        spline = CubicSpline(self._arc_length_m, nodes, axis=2, bc_type=held)
        in_plane = np.moveaxis(spline(np.asarray(arc_length_m, dtype=np.float64)), 1, 2)
        return self._swing(self.layout.plane_to_lab(in_plane + np.array(self.layout.pole_in_plane_m)))

    def axes_along_path(self, arc_length_m: npt.ArrayLike) -> tuple[Floats, Floats]:
        """Return two unit vectors across the cable, each (n_places, k, 3): normal to its plane, and up in its plane."""
        places = np.asarray(arc_length_m, dtype=np.float64)
        before = self.points_along_path(np.maximum(places - TANGENT_STEP_M, 0.0))
        after = self.points_along_path(np.minimum(places + TANGENT_STEP_M, self.length_m))
        tangent = (after - before) / np.linalg.norm(after - before, axis=2, keepdims=True)
        ends = self.points_along_path((0.0, self.length_m))
        side = np.cross(ends[:, 1] - ends[:, 0], self.layout.up)
        side = np.broadcast_to((side / np.linalg.norm(side, axis=1, keepdims=True))[:, None], tangent.shape)
        return side, np.cross(side, tangent)

    def flange_quaternions(self) -> Floats:
        """Return the flange's turn (n_places, 4), x, y, z, w in the lab frame, without jumps of sign."""
        poses = np.array([self.path.at(place).pose for place in np.linspace(0.0, 1.0, self.n_places)])
        to_lab = Rotation.from_matrix(self.layout.lab_rotation)
        q = (to_lab * Rotation.from_rotvec(poses[:, 3:])).as_quat()
        turned = np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0)
        q[1:] *= np.cumprod(turned)[:, None]
        return np.asarray(q)

    def curvature(self, arc_length_m: npt.ArrayLike) -> PlaceTable:
        """Return the signed curvature (G,), 1/m, at G arc lengths, for any place of the path; positive turns up."""
        nodal = np.array([self._rod.curvature(shape) for shape in self._shapes])
        spline = CubicSpline(self._arc_length_m, nodal, axis=1)
        return PlaceTable(spline(np.asarray(arc_length_m, dtype=np.float64)))

    def _swing(self, points_m: Floats) -> Floats:
        """Turn the plane of each place (n_places, k, 3) about the vertical through the pole, as the path has it."""
        pole = self.layout.plane_to_lab(np.array(self.layout.pole_in_plane_m))
        swing_rad = self.path.swing_rad(np.linspace(0.0, 1.0, self.n_places))
        turns = Rotation.from_rotvec(swing_rad[:, None] * self.layout.up).as_matrix()
        return np.asarray((points_m - pole) @ np.swapaxes(turns, 1, 2) + pole)

    def _solve(self) -> list[Shape]:
        pole = self.layout.pole_in_plane_m
        flange = self.path.flange_in_plane(np.linspace(0.0, 1.0, N_PLACES + 1))
        # The cable enters the flange against the tool axis, which is tool_rad.
        clamps = [
            Clamps(x - pole[0], y - pole[1], POLE_CLAMP_RAD, tool_rad - np.pi) for x, y, tool_rad in flange.tolist()
        ]
        shapes = [self._rod.hang(clamps[0])]
        for held in clamps[1:]:
            shapes.append(self._rod.follow(shapes[-1], held))
        self._verify(shapes)
        return shapes

    def _verify(self, shapes: list[Shape]) -> None:
        closure = float(np.abs(shapes[-1].angle_rad - shapes[0].angle_rad).max())
        if closure > CLOSURE_RAD or not all(self._rod.is_stable(shape) for shape in shapes):
            raise ConfigError(
                f"The simulated cable of {self.length_m:g} m snaps into another shape during the robot's path.",
                hint="Give a lower [simulation] bending_stiffness_nm2 or a longer cable.",
            )


def _n_segments(length_m: float, weight_n_per_m: float, stiffness_nm2: float) -> int:
    tension = 0.6 * weight_n_per_m * length_m  # at the ends of a cable that hangs as the layout has it
    decay_m = math.sqrt(stiffness_nm2 / tension)
    return min(max(FEWEST_SEGMENTS, math.ceil(SEGMENTS_PER_DECAY * length_m / decay_m)), MOST_SEGMENTS)
