"""The sharpest turn of each chain of markers."""

from __future__ import annotations

import math

from bench.analysis.arrays import Floats, Floats32
from bench.analysis.kernels.compiling import compiled

__all__ = ["find_sharpest_turns"]


@compiled
def find_sharpest_turns(position_m: Floats32, turn_rad: Floats) -> None:
    """Write the largest angle between neighbouring chords of the seen markers (F, k, 3) as (F,), 0 without any."""
    for f in range(len(position_m)):
        first, second, largest = -1, -1, 0.0
        for i in range(position_m.shape[1]):
            if math.isnan(position_m[f, i, 0]):
                continue
            if first >= 0:
                dot, before, after = 0.0, 0.0, 0.0
                for axis in range(3):
                    u = float(position_m[f, second, axis]) - position_m[f, first, axis]
                    v = float(position_m[f, i, axis]) - position_m[f, second, axis]
                    dot, before, after = dot + u * v, before + u * u, after + v * v
                if before > 0.0 and after > 0.0:
                    cosine = dot / math.sqrt(before * after)
                    largest = max(largest, math.acos(min(max(cosine, -1.0), 1.0)))
            first, second = second, i
        turn_rad[f] = largest
