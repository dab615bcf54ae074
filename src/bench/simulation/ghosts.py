"""Points with no physical marker: ghost markers, which live for a few frames, and reflections, which stay."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["Ghosts", "draw_reflections"]

Floats = npt.NDArray[np.float64]

# Measured on three real recordings: half of the ghosts live 4 frames, a quarter more than 10; half of them are more
# than 2.0 m from the object.
USUAL_LIFE_FRAMES = 4
LONG_LIFE_FRAMES = 12
LONG_LIFE_SHARE = 0.25
NEAR_M = 0.25
FAR_MEDIAN_M = 2.0
FAR_SPREAD = 0.5
"""Standard deviation of the far ones' distance, of its natural logarithm: nine in ten are 0.9 to 4.6 m away."""


class Ghosts:
    """A constant number of ghost markers; each one stays where it was born and another follows when it dies.

    Some of them are born within 0.25 m of a marker of the cable, the others at a median of 2 m from its middle.

    Parameters
    ----------
    n_ghosts : int
        Ghosts in each frame.
    near_share : float
        Share of them that is born near the cable, 0 to 1.
    rng : numpy.random.Generator
    """

    def __init__(self, n_ghosts: int, near_share: float, rng: np.random.Generator) -> None:
        self._near_share = near_share
        self._rng = rng
        self.positions_m: Floats = np.zeros((n_ghosts, 3))
        """(n_ghosts, 3): lab frame."""
        self._left = np.zeros(n_ghosts, dtype=np.int64)

    def step(self, cable_m: Floats) -> npt.NDArray[np.intp]:
        """Go on by one frame in which the cable's markers are at `cable_m` (k, 3); return who was born."""
        self._left -= 1
        born = np.flatnonzero(self._left < 0)
        for index in born:
            self._left[index] = self._draw_life() - 1
            self.positions_m[index] = self._draw_position(cable_m)
        return born

    def _draw_life(self) -> int:
        return LONG_LIFE_FRAMES if self._rng.random() < LONG_LIFE_SHARE else USUAL_LIFE_FRAMES

    def _draw_position(self, cable_m: Floats) -> Floats:
        near, share, nearest = self._rng.random(3)
        if near < self._near_share:
            distance = NEAR_M * share ** (1.0 / 3.0)  # uniform in the ball
            return np.asarray(cable_m[int(nearest * len(cable_m))] + distance * _draw_direction(self._rng))
        return _draw_far(cable_m, self._rng)


def draw_reflections(n_reflections: int, cable_m: Floats, rng: np.random.Generator) -> Floats:
    """Return the lab frame positions (n, 3) of shiny spots that are seen all the time, as far away as ghosts are."""
    return np.array([_draw_far(cable_m, rng) for _ in range(n_reflections)]).reshape(-1, 3)


def _draw_far(cable_m: Floats, rng: np.random.Generator) -> Floats:
    distance = FAR_MEDIAN_M * np.exp(FAR_SPREAD * rng.normal())
    return np.asarray(cable_m.mean(axis=0) + distance * _draw_direction(rng))


def _draw_direction(rng: np.random.Generator) -> Floats:
    direction = rng.normal(size=3)
    return np.asarray(direction / np.sqrt(direction @ direction))
