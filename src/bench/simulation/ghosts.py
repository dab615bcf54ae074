"""Ghost markers: points with no physical marker, which live for a few frames."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["Ghosts"]

Floats = npt.NDArray[np.float64]

# Measured on three real recordings: half of the ghosts live 4 frames, a quarter more than 10.
USUAL_LIFE_FRAMES = 4
LONG_LIFE_FRAMES = 12
LONG_LIFE_SHARE = 0.25
NEAR_SHARE = 0.5
NEAR_M = 0.25
FAR_M = 2.0


class Ghosts:
    """A constant number of ghost markers; each one stays where it was born and another follows when it dies.

    Half of them are born within 0.25 m of a marker of the cable, the others anywhere within 2 m of its middle.

    Parameters
    ----------
    n_ghosts : int
        Ghosts in each frame.
    rng : numpy.random.Generator
    """

    def __init__(self, n_ghosts: int, rng: np.random.Generator) -> None:
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
        direction = self._rng.normal(size=3)
        direction /= np.sqrt(direction @ direction)
        near, share, nearest = self._rng.random(3)
        distance = (NEAR_M if near < NEAR_SHARE else FAR_M) * share ** (1.0 / 3.0)  # uniform in the ball
        if near < NEAR_SHARE:
            return np.asarray(cable_m[int(nearest * len(cable_m))] + distance * direction)
        return np.asarray(cable_m.mean(axis=0) + distance * direction)
