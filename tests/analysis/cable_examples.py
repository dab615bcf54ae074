"""Cables whose markers are known: positions, shuffled points, and which point is which marker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.analysis import PointFrames

Floats = npt.NDArray[np.float64]

SPACING_M = 0.12
N_MARKERS = 8
ARC_LENGTH_M = tuple(SPACING_M * (i + 1) for i in range(N_MARKERS))


@dataclass(frozen=True, eq=False)
class Scene:
    """F frames as a tracker lists them."""

    points_m: npt.NDArray[np.float32]
    offsets: npt.NDArray[np.int64]
    source: npt.NDArray[np.int16]
    """(F, k): the truth."""
    extra_source: npt.NDArray[np.int16]
    """(F, m): the same for the further points."""

    @property
    def usable(self) -> npt.NDArray[np.bool_]:
        return np.ones(len(self.points_m), dtype=bool)

    def frames(self, anchor_m: Floats | None, **known: object) -> PointFrames:
        """Return what a sorter is given, the frames taken at 100 Hz."""
        n_frames = len(self.offsets) - 1
        listed = {"usable": self.usable, "time_ns": np.arange(n_frames) * 10_000_000, **known}
        return PointFrames(self.points_m, self.offsets, anchor_m=anchor_m, **listed)


def bend_cable(radius_m: Floats, arc_length_m: Floats) -> Floats:
    """Return circular cables from the origin along x, (F, k, 3)."""
    angle = arc_length_m / radius_m[:, None]
    radius = radius_m[:, None] * np.ones_like(angle)
    return np.stack([radius * np.sin(angle), radius * (1 - np.cos(angle)), 0 * angle], axis=2)


def swing_cable(n_frames: int) -> Floats:
    """Return a cable that bends and unbends, (F, k, 3); the anchor is the origin."""
    radius = 0.45 + 0.15 * np.cos(np.linspace(0, 7, n_frames))
    return bend_cable(radius, np.array(ARC_LENGTH_M))


def make_scene(
    rng: np.random.Generator,
    markers_m: Floats,
    further_m: Floats | None = None,
    miss_probability: float = 0.0,
    noise_m: float = 0.0,
) -> Scene:
    """Shuffle the markers (F, k, 3) and further points (F, m, 3) of each frame; NaN and missed ones are not listed."""
    further_m = np.zeros((len(markers_m), 0, 3)) if further_m is None else further_m
    every = np.concatenate([markers_m, further_m], axis=1)
    every = every + rng.normal(0.0, 1.0, every.shape) * noise_m
    listed = np.isfinite(every[:, :, 0])
    listed[:, : markers_m.shape[1]] &= rng.random(markers_m.shape[:2]) >= miss_probability
    points, counts, source = [], [], np.full(every.shape[:2], -1, dtype=np.int16)
    for frame in range(len(every)):
        shown = rng.permutation(np.flatnonzero(listed[frame]))
        source[frame, shown] = np.arange(len(shown))
        points.append(every[frame, shown])
        counts.append(len(shown))
    k = markers_m.shape[1]
    offsets = np.concatenate([[0], np.cumsum(counts)])
    return Scene(np.concatenate(points).astype(np.float32), offsets, source[:, :k], source[:, k:])


def make_rotation(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return a random rotation as matrix (3, 3) and as quaternion (4,), x y z w."""
    quaternion = rng.normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    axis, w = quaternion[:3], quaternion[3]
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross, quaternion
