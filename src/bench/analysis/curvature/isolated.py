"""Bends that come and go within a moment: a cable cannot, a wrong label can."""

from __future__ import annotations

import numpy as np
import scipy

from bench.analysis.arrays import Bools, Floats32, Ints
from bench.analysis.curvature.bends import find_peaks

__all__ = ["find_isolated_bends"]

SPAN_S = 0.11
"""Length of the moment: ghost markers live 4 frames (median of three real recordings), 0.04 s at 100 Hz, and the median
of a stretch is theirs only when they fill half of it."""
FEWEST_FRAMES = 5
"""Of slow trackers: a median of fewer tells nothing."""
RATIO = 1.5
"""Within 0.05 s no bend of the real cables in motion grows by half and falls back again."""
NOISE_SPANS = 6.0
"""Standard deviations by which the bend must stand out as well, so that a straight cable's noise is no bend."""


def find_isolated_bends(curvature_per_m: Floats32, sigma_per_m: Floats32, usable: Bools, time_ns: Ints) -> Bools:
    """Find frames whose tightest bend stands far above that of the frames just before and after.

    Parameters
    ----------
    curvature_per_m, sigma_per_m : (F, G)
        NaN where there is no curve.
    usable : (F,)
        Frames to compare with each other; the others are neither asked nor judged.
    time_ns : (F,)
        Capture times, ascending.

    Returns
    -------
    (F,) bool
        A real bend that lasts less than half of `SPAN_S` is among them: whoever leaves these frames out must say so.
    """
    peak, place = find_peaks(curvature_per_m)
    sigma = sigma_per_m[np.arange(len(peak)), place]
    frames = np.flatnonzero(usable & np.isfinite(peak))
    isolated = np.zeros(len(peak), dtype=bool)
    if len(frames) < FEWEST_FRAMES:
        return isolated
    around = scipy.ndimage.median_filter(peak[frames], size=_span_in_frames(time_ns), mode="nearest")
    stands_out = peak[frames] - around > NOISE_SPANS * np.nan_to_num(sigma[frames])
    isolated[frames] = stands_out & (peak[frames] > RATIO * around)
    return isolated


def _span_in_frames(time_ns: Ints) -> int:
    """Return `SPAN_S` as an odd number of frames."""
    step_s = float(np.median(np.diff(time_ns))) * 1e-9
    n_frames = round(SPAN_S / step_s) if step_s > 0 else FEWEST_FRAMES
    return max(FEWEST_FRAMES, n_frames | 1)
