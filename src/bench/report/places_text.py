"""Where the markers sit on the cable beside where they should, in words, and the line to paste."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["CLEAR_MM", "describe_places", "find_misplaced"]

Floats = npt.NDArray[np.float64]

CLEAR_SIGMAS = 3.0
CLEAR_MM = 1.0
"""A marker that sits further than this from its place, beyond noise, is worth correcting: tape is good to 2 mm."""


def find_misplaced(measured_m: Floats, sigma_m: Floats, configured_m: Floats) -> npt.NDArray[np.intp]:
    """Return the markers that sit elsewhere than configured, beyond doubt."""
    apart = np.abs(measured_m - configured_m)
    return np.flatnonzero(apart > np.maximum(CLEAR_SIGMAS * sigma_m, CLEAR_MM * 1e-3))


def describe_places(measured_m: Floats, sigma_m: Floats, configured_m: Floats) -> list[str]:
    """Return a table of both, and where they differ the line that [cable] should have."""
    apart = measured_m - configured_m
    lines = [f"{'marker':<8}{'configured':>12}{'measured':>12}{'sd':>9}{'difference':>12}   (mm, from the anchor)"]
    rows = zip(configured_m * 1e3, measured_m * 1e3, sigma_m * 1e3, apart * 1e3, strict=True)
    lines += [f"{i:<8}{was:>12.2f}{now:>12.2f}{sd:>9.3f}{by:>+12.2f}" for i, (was, now, sd, by) in enumerate(rows)]
    wrong = find_misplaced(measured_m, sigma_m, configured_m)
    if len(wrong):
        places = ", ".join(f"{value:.4f}" for value in measured_m)
        lines.append(f"{len(wrong)} of {len(apart)} markers sit elsewhere than configured; in [cable] write instead:")
        lines.append(f"marker_arc_length_m = [{places}]")
    return lines
