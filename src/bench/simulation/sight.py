"""Which markers are hidden in a frame: for a moment, for a while, or behind the robot's own arm."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.config import SimulationConfig
from bench.simulation.cable import PlaceTable
from bench.simulation.kinematics import joint_frames
from bench.simulation.layout import Layout
from bench.simulation.path import JointPath

__all__ = ["Occlusion", "SelfOcclusion"]

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

SHORTEST_BURST, LONGEST_BURST = 5, 50
"""Frames for which a marker stays hidden once something stands before it: as in real takes."""
FEWEST_CAMERAS = 2
"""Two lines of sight are needed for a point in space."""
N_STEPS = 512
"""Places along the path at which the arm's shadow is looked up: a step of 2.6 mm at most."""
CAMERAS_AT_M = 3.0
CAMERA_ARC_RAD = np.pi / 2
HEIGHTS_M = (0.3, 1.4)
"""The cameras stand on an arc about the cable's middle, behind the robot as seen from the pole, in turn so much below
and above it. From there the arm hides up to 40 % of the views of single markers with three cameras, none with six."""
LINK_RADII_M = (0.075, 0.06, 0.06, 0.05, 0.05, 0.0375)
"""Half the thickness of a UR5e's links, roughly; the last is its tool flange of 75 mm."""


class Occlusion:
    """Hides markers at random: single frames, and bursts of 5 to 50 frames.

    Parameters
    ----------
    simulation : SimulationConfig
        How often.
    n_markers : int
        How many there are.
    rng : numpy.random.Generator
    """

    def __init__(self, simulation: SimulationConfig, n_markers: int, rng: np.random.Generator) -> None:
        self._miss_probability = simulation.miss_probability
        self._burst_probability = simulation.burst_probability
        self._rng = rng
        self._left = np.zeros(n_markers, dtype=np.int64)
        self._nothing = np.zeros(n_markers, dtype=np.bool_)

    def step(self) -> Bools:
        """Go on by one frame and return (n_markers,) who is hidden."""
        hidden = self._nothing
        if self._miss_probability:
            hidden = self._rng.random(len(self._left)) < self._miss_probability
        if self._burst_probability:
            self._step_bursts()
            hidden = hidden | (self._left > 0)
        return hidden

    def _step_bursts(self) -> None:
        self._left -= self._left > 0
        begins = (self._left == 0) & (self._rng.random(len(self._left)) < self._burst_probability)
        n = np.count_nonzero(begins)
        if n:
            self._left[begins] = self._rng.integers(SHORTEST_BURST, LONGEST_BURST + 1, n)


class SelfOcclusion:
    """Tells which markers the robot's arm hides, at any place of the path.

    Cameras stand on a quarter of a circle behind the robot; the arm is a chain of capsules from joint to joint. A
    marker that fewer than two cameras see past them is hidden.

    Parameters
    ----------
    n_cameras : int
    layout : Layout
    path : JointPath
        Where the arm is.
    markers : PlaceTable
        (m, 3): where the markers are, lab frame.
    """

    def __init__(self, n_cameras: int, layout: Layout, path: JointPath, markers: PlaceTable) -> None:
        cameras_m = _place_cameras(n_cameras, layout)
        places = np.linspace(0.0, 1.0, N_STEPS + 1)
        joints = np.array([path.at(place).q_rad for place in places])
        bones = _bones(layout.base_to_lab(joint_frames(joints)[..., :3, 3]))
        rows = zip(bones, markers.at_many(places), strict=True)
        self._hidden = np.array([_count_views(cameras_m, seen_m, arm) < FEWEST_CAMERAS for arm, seen_m in rows])

    def at(self, place: float) -> Bools:
        """Return (m,) who is hidden at one place, 0 to 1."""
        return np.asarray(self._hidden[round(min(max(place, 0.0), 1.0) * N_STEPS)])


def _place_cameras(n_cameras: int, layout: Layout) -> Floats:
    """Return (n, 3) lab frame positions, evenly along the arc."""
    ahead, up = layout.ahead, layout.up
    angle = CAMERA_ARC_RAD * ((np.arange(n_cameras) + 0.5) / n_cameras - 0.5)
    height = np.where(np.arange(n_cameras) % 2, HEIGHTS_M[1], -HEIGHTS_M[0])
    arc = np.cos(angle)[:, None] * ahead + np.sin(angle)[:, None] * np.cross(up, ahead)
    return np.asarray(layout.middle_m + CAMERAS_AT_M * arc + height[:, None] * up)


def _bones(joints_m: Floats) -> Floats:
    """Return (n, 6, 2, 3): both ends of each link's axis; the last ends where its cap touches the flange."""
    bones = np.stack([joints_m[:, :-1], joints_m[:, 1:]], axis=2)
    last = bones[:, -1, 1] - bones[:, -1, 0]
    bones[:, -1, 1] -= LINK_RADII_M[-1] * last / np.linalg.norm(last, axis=1, keepdims=True)
    return bones


def _count_views(cameras_m: Floats, markers_m: Floats, bones: Floats) -> npt.NDArray[np.intp]:
    """Return (m,) how many cameras see each marker past an arm (6, 2, 3)."""
    sights = markers_m[None, :, None] - cameras_m[:, None, None]
    distance = _distance_of_segments(cameras_m[:, None, None], sights, bones[:, 0], bones[:, 1] - bones[:, 0])
    return np.asarray((distance > np.array(LINK_RADII_M)).all(axis=2).sum(axis=0))


def _distance_of_segments(p: Floats, u: Floats, q: Floats, v: Floats) -> Floats:
    """Return the smallest distance between segments p + s u and q + t v, s and t from 0 to 1 (Ericson 2005, 5.1.9)."""
    w = p - q
    a, b, c = (u * u).sum(-1), (u * v).sum(-1), np.maximum((v * v).sum(-1), 1e-12)
    d, e = (u * w).sum(-1), (v * w).sum(-1)
    flat = np.maximum(a * c - b * b, 1e-12)
    s = np.clip((b * e - c * d) / flat, 0.0, 1.0)
    t = np.clip((b * s + e) / c, 0.0, 1.0)
    s = np.clip((b * t - d) / a, 0.0, 1.0)
    gap = w + s[..., None] * u - t[..., None] * v
    return np.asarray(np.sqrt((gap * gap).sum(-1)))
