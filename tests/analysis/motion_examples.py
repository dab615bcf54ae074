"""A cable whose motion does not come back, with what goes wrong on real recordings: for sorters that use time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from cable_examples import Floats, Scene

from bench.analysis import PointFrames, SortSettings

PLACES_M = (0.03, 0.10, 0.21, 0.30, 0.42, 0.50, 0.61, 0.70)
RATES_RAD_S = (2.1, 3.4, 5.2)
"""Without a common measure, so that the motion does not repeat."""
CABLE = SortSettings(PLACES_M, stretch=0.02, shorten=0.25, tolerance_m=0.004, length_m=0.75)
GHOST_LIFE = 4.0
NEAR_M = 0.05


@dataclass(frozen=True, eq=False)
class Recording:
    """F frames of the cable, and which point is which marker."""

    frames: PointFrames
    source: npt.NDArray[np.int16]
    """(F, k): the truth."""

    def wrong(self, found: npt.NDArray[np.int16]) -> npt.NDArray[np.bool_]:
        """Return the frames (F,) with a wrong label."""
        return np.asarray(((found >= 0) & (found != self.source)).any(axis=1))

    def exact(self, found: npt.NDArray[np.int16]) -> npt.NDArray[np.bool_]:
        """Return the frames (F,) in which every visible marker has its point and nothing else is labeled."""
        return np.asarray((found == self.source).all(axis=1))


def move_cable(time_s: Floats) -> Floats:
    """Return a cable that swings in space, anchored in the origin, (F, k, 3)."""
    s = np.linspace(0, 0.75, 151)
    wave = [np.sin(rate * time_s + i)[:, None] for i, rate in enumerate(RATES_RAD_S)]
    pitch = 0.5 * wave[0] + s * (1.5 + 1.2 * wave[1]) + 0.5 * wave[2] * np.sin(4 * s)
    tilt = 0.3 * wave[1] + s * wave[2]
    way = np.stack([np.cos(pitch) * np.cos(tilt), np.sin(tilt), np.sin(pitch) * np.cos(tilt)], axis=2)
    nodes = np.concatenate([np.zeros((len(time_s), 1, 3)), np.cumsum(way[:, 1:] * s[1], axis=1)], axis=1)
    return nodes[:, np.rint(np.array(PLACES_M) / s[1]).astype(int)]


def record(
    seed: int, time_s: Floats, *, miss: float = 0.05, bursts: float = 0.002, ghosts: float = 1.0, noise_m: float = 2e-4
) -> Recording:
    """Return a recording with single misses, bursts of 0.05 to 0.5 s, and ghosts, a quarter of them riding along."""
    rng, markers = np.random.default_rng(seed), move_cable(time_s)
    hidden = rng.random(markers.shape[:2]) < miss
    for frame, marker in np.argwhere(rng.random(hidden.shape) < bursts):
        hidden[(time_s >= time_s[frame]) & (time_s < time_s[frame] + rng.uniform(0.05, 0.5)), marker] = True
    return list_frames(rng, time_s, markers, hidden, _draw_ghosts(rng, markers, ghosts), noise_m)


def list_frames(
    rng: np.random.Generator,
    time_s: Floats,
    markers_m: Floats,
    hidden: npt.NDArray[np.bool_],
    further_m: list[list[Floats]],
    noise_m: float = 0.0,
) -> Recording:
    """Shuffle the markers (F, k, 3) that are not hidden and the further points of each frame."""
    points, counts, source = [], [], np.full(hidden.shape, -1, dtype=np.int16)
    for frame, others in enumerate(further_m):
        seen = np.flatnonzero(~hidden[frame])
        listed = np.concatenate([markers_m[frame, seen], np.reshape(others, (-1, 3))])
        listed += rng.normal(size=listed.shape) * noise_m
        order = rng.permutation(len(listed))
        source[frame, seen] = np.argsort(order)[: len(seen)]
        points.append(listed[order])
        counts.append(len(listed))
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    scene = Scene(np.concatenate(points).astype(np.float32), offsets, source, source[:, :0])
    time_ns = np.rint(time_s * 1e9).astype(np.int64)
    return Recording(scene.frames(np.zeros((len(time_s), 3)), time_ns=time_ns), source)


def _draw_ghosts(rng: np.random.Generator, markers_m: Floats, n_usual: float) -> list[list[Floats]]:
    further: list[list[Floats]] = [[] for _ in markers_m]
    for born in range(len(markers_m)):
        for _ in range(rng.poisson(n_usual / GHOST_LIFE)):
            life, marker, kind = rng.geometric(1 / GHOST_LIFE), rng.integers(len(PLACES_M)), rng.random()
            apart = rng.normal(size=3)
            apart *= (NEAR_M if kind < 0.5 else 1.0) * np.cbrt(rng.random()) / np.linalg.norm(apart)
            for frame in range(born, min(born + life, len(markers_m))):
                further[frame].append(markers_m[frame if kind < 0.25 else born, marker] + apart)
    return further
