"""Made takes as a sorter is given them."""

from __future__ import annotations

import numpy as np

from bench.analysis import PointFrames, SortSettings
from bench.simulation.made_takes import Conditions, MadeTake

__all__ = ["frames_of", "settings_of"]


def frames_of(take: MadeTake, **known: object) -> PointFrames:
    """Return a take's frames, the end and the phase known unless told otherwise."""
    listed = {
        "usable": np.ones(len(take.points_m), dtype=bool),
        "anchor_m": take.anchor_m,
        "end_m": take.end_m,
        "end_sigma_m": take.end_sigma_m,
        "cycle": take.cycle,
        "phase": take.phase,
        **known,
    }
    return PointFrames(take.points_m, take.offsets, time_ns=take.time_ns, **listed)  # type: ignore[arg-type]


def settings_of(take: MadeTake, conditions: Conditions) -> SortSettings:
    """Return what is known of the take's cable."""
    return SortSettings(take.arc_length_m, tolerance_m=0.004, length_m=take.length_m, noise_m=conditions.noise_m)
