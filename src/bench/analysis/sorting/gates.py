"""The paper's gates: how far apart two neighbours on the cable can be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Floats

__all__ = ["SortSettings", "SpacingGates", "make_gates"]


@dataclass(frozen=True)
class SortSettings:
    """What a sorter knows of the cable."""

    arc_length_m: tuple[float, ...]
    """(k,): arc length of each marker from the anchor, ascending."""
    stretch: float = 0.02
    """e1 / D of the paper: growth of a distance by tension."""
    shorten: float = 0.25
    """e2 / D of the paper: shortening of a chord by bending."""
    tolerance_m: float = 0.0
    """Added to both sides of every gate: how well the arc lengths are known."""
    length_m: float = float("nan")
    """Arc length of the cable's other end from the anchor; NaN where unknown."""
    noise_m: float = 2e-4
    """Standard deviation of a marker's position, for each coordinate; 0.12-0.74 mm measured on OptiTrack."""

    @property
    def n_markers(self) -> int:
        """The number k of markers on the cable."""
        return len(self.arc_length_m)


@dataclass(frozen=True, eq=False)
class SpacingGates:
    """For each marker the distances [D - e2, D + e1] from its predecessor, the first one's from the anchor."""

    nominal_m: Floats
    """(k,): D."""
    low_m: Floats
    high_m: Floats


def make_gates(settings: SortSettings) -> SpacingGates:
    """Return the gates [D (1 - shorten) - tolerance, D (1 + stretch) + tolerance] (section 3.2 of the paper)."""
    nominal = np.diff(np.array(settings.arc_length_m), prepend=0.0)
    return SpacingGates(
        nominal_m=nominal,
        low_m=np.maximum(nominal * (1.0 - settings.shorten) - settings.tolerance_m, 0.0),
        high_m=nominal * (1.0 + settings.stretch) + settings.tolerance_m,
    )
