"""A comparison in words."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from bench.analysis import RigidTransform
from bench.report.comparison.compare import Comparison
from bench.report.wording import say_mm, say_number, say_percent

__all__ = ["describe_comparison", "find_largest"]


def describe_comparison(found: Comparison) -> dict[str, str]:
    """Return the figures of eq. (6) and of the alignment, by name."""
    difference = found.difference
    axes = ", ".join(
        f"{name} {_mm(value)}" for name, value in zip("xyz", difference.coordinate_m.tolist(), strict=True)
    )
    lines = {
        "e of eq. (6)": f"{_mm(difference.e_m)}; e² = {say_mm(1e6 * difference.e2_m2)} mm²",
        "rms by coordinate": axes,
        "largest distance": _describe_largest(found),
        "compared": f"{say_percent(difference.compared)} of all phases and places",
    }
    if found.late is not None and found.late_s is not None:
        late_ms = say_number(1e3 * found.late_s, 1)
        lines["aligned in time"] = f"the second is {late_ms} ms ({say_number(found.late, 4)} of a cycle) late"
    if found.moved is not None:
        lines["aligned in space"] = _describe_move(found, found.moved)
    return lines


def find_largest(found: Comparison) -> tuple[int, int]:
    """Return the indices of phase and place of the largest distance."""
    phase, place = np.unravel_index(np.nanargmax(found.difference.distance_m), found.difference.distance_m.shape)
    return int(phase), int(place)


def _describe_largest(found: Comparison) -> str:
    phase, place = find_largest(found)
    distance = _mm(float(found.difference.distance_m[phase, place]))
    return f"{distance}, {1e3 * found.arc_length_m[place]:.0f} mm from the anchor, phase {found.cycle_phase[phase]:.3f}"


def _describe_move(found: Comparison, moved: RigidTransform) -> str:
    turned = np.rad2deg(Rotation.from_matrix(moved.rotation).magnitude())
    middle = np.nanmean(found.second_m.reshape(-1, 3), axis=0)
    shift = middle - moved.rotation.T @ (middle - moved.shift_m)
    return f"the second was turned by {turned:.2f} degrees, and its middle moved by {_mm(float(np.linalg.norm(shift)))}"


def _mm(value_m: float) -> str:
    return f"{say_number(1e3 * value_m, 2)} mm"
