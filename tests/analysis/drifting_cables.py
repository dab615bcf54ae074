"""Cycles of a cable whose markers move along a known path, and that changes as it is told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

N_MARKERS = 6
ALONG = np.linspace(0.1, 0.9, N_MARKERS)
MODE = np.sqrt(2) * np.sin(np.pi * ALONG)
"""Shape of the change: its root mean square over the markers is near 1."""


@dataclass(frozen=True)
class DriftingCable:
    """What `gather_shapes` takes."""

    row: np.ndarray
    phase: np.ndarray
    position_m: np.ndarray


def make_cable(
    change_m: np.ndarray, per_cycle: int = 50, noise_m: float = 2e-4, hidden: float = 0.0, seed: int = 0
) -> DriftingCable:
    """Make one cycle for each change (C,): how far the cable is from its first shape, root mean square."""
    rng = np.random.default_rng(seed)
    n_cycles = len(change_m)
    row = np.repeat(np.arange(n_cycles), per_cycle)
    phase = ((np.arange(per_cycle) + rng.random((n_cycles, 1))) / per_cycle).ravel()
    turn = 2 * np.pi * phase[:, None]
    position = np.empty((len(row), N_MARKERS, 3))
    position[..., 0] = 0.9 * ALONG + 0.1 * np.sin(turn) * ALONG
    position[..., 1] = 0.3 * np.sin(np.pi * ALONG) * (1 + 0.3 * np.cos(turn)) + change_m[row][:, None] * MODE
    position[..., 2] = 0.05 * np.sin(2 * turn)
    position += rng.normal(0, noise_m, position.shape)
    position[rng.random(position.shape[:2]) < hidden] = np.nan
    return DriftingCable(row, phase, position.astype(np.float32))
