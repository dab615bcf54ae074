"""How many frames a second a motion needs (the paper, section 2), and how fast the motion is."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Floats, Ints
from bench.model import CheckItem

__all__ = ["fastest_speed", "judge_frame_rate"]

CLOSE_ENOUGH = 0.99
"""Of the needed rate: speed and rate are not known better than to a hundredth."""
LEAST_STEP_NS = 10_000_000
"""Over 10 ms, noise of 0.2 mm is a speed of 0.03 m/s; at 500 samples a second it would be 0.14 m/s."""
SPEEDS = 5
"""The median of so many in a row: one wrong point is no speed."""


def judge_frame_rate(rate_hz: float, speed_m_s: float | None, accuracy_mm: float, known_from: str) -> CheckItem:
    """Compare the frame rate with speed / accuracy: so far and no further may a marker go between two frames.

    Parameters
    ----------
    rate_hz : float
        Frames a second.
    speed_m_s : float or None
        Of the fastest marker, when the robot drives at full speed; None where it is not known.
    accuracy_mm : float
        How far a marker may go from one frame to the next.
    known_from : str
        How the speed is known, in a few words.
    """
    name = "frame rate"
    if speed_m_s is None or not np.isfinite(speed_m_s):
        sentence = (
            "The fastest marker's speed is not known, so the frame rate is not checked: give [cable] max_speed_m_s, or "
            "let `bench check --cycle` measure it."
        )
        return CheckItem(name, f">= speed / {accuracy_mm:g} mm", f"{rate_hz:.1f} Hz, not checked", "open", sentence)
    needed_hz = speed_m_s / (accuracy_mm * 1e-3)
    limit = f">= {needed_hz:.0f} Hz: {speed_m_s:.2f} m/s, {known_from}, over {accuracy_mm:g} mm"
    if rate_hz >= CLOSE_ENOUGH * needed_hz:
        return CheckItem(name, limit, f"{rate_hz:.1f} Hz", "ok")
    way = f"{1e3 * speed_m_s / rate_hz:.1f} mm" if rate_hz > 0 else "any way"
    sentence = (
        f"The fastest marker goes {way} between two frames, [tracker] accuracy_mm allows {accuracy_mm:g} mm: raise the "
        "cameras' rate, or drive more slowly."
    )
    return CheckItem(name, limit, f"{rate_hz:.1f} Hz", "warn", sentence)


def fastest_speed(time_ns: Ints, position_m: Floats, share: float = 1.0) -> float:
    """Return the largest speed of m points, in m/s; NaN where none is seen in enough samples in a row.

    The way over at least 10 ms by its time, and of five such speeds in a row the median.

    Parameters
    ----------
    time_ns : (n,)
        Moments, ascending; a clock with coarse steps may show some twice.
    position_m : (n, m, 3)
        Where the points were, NaN where not seen.
    share : float
        Of each point's speeds, the part that is not to exceed the result: below 1 where some points may be wrong.
    """
    if len(time_ns) < 2:
        return float("nan")
    step = int(np.ceil(LEAST_STEP_NS / max(float(np.median(np.diff(time_ns))), 1.0)))
    if len(time_ns) < step + SPEEDS:
        return float("nan")
    way_m = np.linalg.norm(position_m[step:] - position_m[:-step], axis=2)
    took_ns = (time_ns[step:] - time_ns[:-step]).astype(np.float64)
    speed = way_m / (np.where(took_ns > 0, took_ns, np.nan) * 1e-9)[:, None]
    usual = np.median(np.lib.stride_tricks.sliding_window_view(speed, SPEEDS, axis=0), axis=2)
    known = usual[:, np.isfinite(usual).any(axis=0)]
    return float(np.nanquantile(known, share, axis=0).max()) if known.size else float("nan")
