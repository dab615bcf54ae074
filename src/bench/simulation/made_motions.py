"""Motions of a cable as formulas: where it is at any moment, for takes that are made without a robot or a tracker.

A cable that does not stretch is known by its directions: pitch and tilt along it, each a mean shape and a few modes
whose coefficients are functions of time. The directions are integrated from the anchor, so every distance along the
cable is right to rounding, in space and at any bend.

`DEVELOPMENT` is for finding out how a method should be built; `HELD_OUT`, with other seeds, lengths, turns, tilts and
cycle times, is for the figures that are told. Nothing may be chosen by what it does on `HELD_OUT`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

__all__ = ["DEVELOPMENT", "HELD_OUT", "Motion"]

Floats = npt.NDArray[np.float64]

ANCHOR_M = (0.31, -0.12, 0.94)
"""Where every made cable starts; not the origin, so that no code works by accident."""
N_CELLS = 200
"""Pieces in which the directions are integrated: 5 mm for a cable of 1 m."""
N_SHAPES = 4
HARMONICS = (1.0, 2.0, 3.0)
NEVER_TWICE = (0.6180339887, 1.4142135624, 2.7182818285)
"""Per cycle time: frequencies without a common measure, so that the motion does not come back."""
CHUNK = 4_000


@dataclass(frozen=True)
class Motion:
    """How a cable moves, and where its markers are on it."""

    name: str
    arc_length_m: tuple[float, ...]
    """(k,): of the markers, from the anchor."""
    length_m: float
    """Arc length of the cable's other end."""
    start_rad: float
    """Mean pitch at the anchor, 0 is level and pi / 2 up."""
    turn_rad: float
    """By how much the pitch grows along the cable: beyond 3/2 pi it crosses itself."""
    tightness: float
    """0 spreads the turn evenly, towards 1 it gathers in the middle."""
    tilt_rad: float
    """Mean direction out of the plane, which parts the strands of a loop."""
    swing_rad: float
    """Standard deviation of the modes' coefficients over motions."""
    cycle_s: float
    """Time of a cycle; no multiple of usual frame times, so that no two cycles are seen at the same phases."""
    seed: int
    """Of the modes' coefficients."""
    repeats: bool = True
    """Whether the motion is the same in every cycle."""

    def points_at(self, cycles: Floats, arc_length_m: Floats, shift_rad: Floats | None = None) -> Floats:
        """Return points of the cable, lab frame.

        Parameters
        ----------
        cycles : (F,)
            Moments, in cycles since the beginning.
        arc_length_m : (F, m)
            Places on the cable, for each moment its own.
        shift_rad : (F, 8), optional
            Added to the modes' coefficients: how this moment differs from the motion as planned.

        Returns
        -------
        (F, m, 3) float64
        """
        found = np.empty((*arc_length_m.shape, 3))
        for start in range(0, len(cycles), CHUNK):
            part = slice(start, start + CHUNK)
            angles = self.coefficients_at(cycles[part]) + (0.0 if shift_rad is None else shift_rad[part])
            found[part] = self._integrate(angles, arc_length_m[part])
        return found

    def coefficients_at(self, cycles: Floats) -> Floats:
        """Return the coefficients of pitch and tilt modes (F, 8), radians."""
        rng = np.random.default_rng(self.seed)
        frequency = np.array(HARMONICS if self.repeats else NEVER_TWICE)
        fading = 1.0 / (np.arange(1, len(frequency) + 1)[:, None] * np.sqrt(np.arange(N_SHAPES) + 1.0))
        amplitude = self.swing_rad * fading[:, None] * rng.normal(size=(len(frequency), 2, N_SHAPES))
        phase = rng.uniform(0, 2 * np.pi, size=amplitude.shape)
        turns = 2 * np.pi * np.multiply.outer(cycles, frequency)[:, :, None, None]
        wave: Floats = (amplitude * np.sin(turns + phase)).sum(axis=1)
        wave[:, 1] *= 0.25  # cables hang: they swing less out of their plane than in it
        return wave.reshape(len(cycles), 2 * N_SHAPES)

    def _integrate(self, coefficients: Floats, arc_length_m: Floats) -> Floats:
        place = (np.arange(N_CELLS) + 0.5) / N_CELLS
        shapes = np.stack([place, *(np.sin(n * np.pi * place) for n in range(1, N_SHAPES))])
        turned = place - self.tightness * np.sin(2 * np.pi * place) / (2 * np.pi)
        pitch = self.start_rad + self.turn_rad * turned + coefficients[:, :N_SHAPES] @ shapes
        tilt = self.tilt_rad + coefficients[:, N_SHAPES:] @ shapes
        level = np.cos(tilt)
        direction = np.stack([np.cos(pitch) * level, np.sin(tilt), np.sin(pitch) * level], axis=2)
        cell_m = self.length_m / N_CELLS
        node = np.zeros((len(coefficients), N_CELLS + 1, 3))
        np.cumsum(direction * cell_m, axis=1, out=node[:, 1:])
        cell = np.clip((arc_length_m / cell_m).astype(np.int64), 0, N_CELLS - 1)
        row = np.arange(len(coefficients))[:, None]
        rest_m = (arc_length_m - cell * cell_m)[..., None]
        return np.asarray(np.array(ANCHOR_M) + node[row, cell] + rest_m * direction[row, cell])


def _even(n_markers: int, spacing_m: float) -> tuple[float, ...]:
    return tuple(spacing_m * (i + 1) for i in range(n_markers))


def _uneven(n_markers: int, spacing_m: float, seed: int) -> tuple[float, ...]:
    """Return arc lengths whose spacings differ by up to 30 % from the mean."""
    share = np.random.default_rng(seed).uniform(-0.3, 0.3, n_markers)
    return tuple(np.cumsum(spacing_m * (1.0 + share - share.mean())).tolist())


def _with_seeds(motion: Motion, *seeds: int) -> tuple[Motion, ...]:
    return tuple(replace(motion, seed=seed, name=f"{motion.name} {seed}") for seed in seeds)


_SWING = Motion("swing", _even(10, 0.10), 1.06, -1.2, 2.3, 0.3, 0.15, 0.30, 4.0037, 0)
_LOOP = Motion("loop", _even(10, 0.10), 1.06, -0.9, 7.6, 0.7, 0.15, 0.25, 4.0037, 0)
DEVELOPMENT: Mapping[str, tuple[Motion, ...]] = MappingProxyType(
    {
        "swing": _with_seeds(_SWING, 11, 12, 13),
        "loop": _with_seeds(_LOOP, 21, 22, 23),
        "uneven loop": _with_seeds(replace(_LOOP, name="uneven loop", arc_length_m=_uneven(10, 0.10, 5)), 31, 32, 33),
        "dense": _with_seeds(replace(_LOOP, name="dense", arc_length_m=_even(25, 0.04), length_m=1.03), 41, 42, 43, 44),
        "not repeating": _with_seeds(replace(_LOOP, name="not repeating", turn_rad=4.0, repeats=False), 51, 52, 53),
    }
)
"""Motions by kind, to build methods with."""

_OTHER_SWING = Motion("swing", _even(10, 0.11), 1.17, -1.4, 2.7, 0.0, -0.1, 0.33, 3.4119, 0)
_OTHER_LOOP = Motion("loop", _even(10, 0.11), 1.15, -0.6, 7.2, 0.6, -0.13, 0.28, 3.4119, 0)
HELD_OUT: Mapping[str, tuple[Motion, ...]] = MappingProxyType(
    {
        "swing": _with_seeds(_OTHER_SWING, 111, 112, 113),
        "loop": _with_seeds(_OTHER_LOOP, 121, 122, 123),
        "uneven loop": _with_seeds(
            replace(_OTHER_LOOP, name="uneven loop", arc_length_m=_uneven(10, 0.11, 105)), 131, 132, 133
        ),
        "dense": _with_seeds(
            replace(_OTHER_LOOP, name="dense", arc_length_m=_even(25, 0.04), length_m=1.04), 141, 142, 143, 144
        ),
        "not repeating": _with_seeds(
            replace(_OTHER_LOOP, name="not repeating", turn_rad=4.4, repeats=False), 151, 152, 153
        ),
    }
)
"""Motions by kind, to judge methods by."""
