"""Chains of markers that go back on themselves: a cable does not, wrongly sorted markers do."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Bools, Floats32

__all__ = ["find_folds"]

SHARPEST_RAD = float(np.deg2rad(150.0))
"""Between neighbouring chords. The markers of a real cable in motion turn by up to 75 degrees, with a tenth of them
hidden by 131, those of simulated ones with a bend radius of a twentieth of their spacing by 123. Where two neighbours
are exchanged it is 160 and more, unless chords turn by 60 anyway (measured 2026-11)."""


def find_folds(position_m: Floats32) -> Bools:
    """Return for each frame (F,) whether its sorted markers (F, k, 3), NaN where not found, fold back anywhere.

    Curvature through markers cannot tell: it is never tighter than half their distance, and a smooth curve averages a
    fold to one side with the next to the other.
    """
    from bench.analysis.kernels.folding import find_sharpest_turns

    turn = np.empty(len(position_m))
    find_sharpest_turns(np.ascontiguousarray(position_m, dtype=np.float32), turn)
    return np.asarray(turn > SHARPEST_RAD)
