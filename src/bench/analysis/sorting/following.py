"""One marker followed from frame to frame, from where it was at the beginning."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Floats, Floats32, Ints

__all__ = ["follow_marker"]

START_RADIUS_M = 0.03
"""How far off a place that was read from the tracker's screen may be."""
GATE_M = 0.01
"""Between two frames a marker at 1 m/s that stops at once is 10 mm from where it was expected, at 100 Hz."""
FASTEST_M_PER_S = 2.0
"""How fast the place where it may come back grows while it is hidden: a cobot's flange goes no faster."""
LARGEST_GATE_M = 0.1
"""Beyond that another marker is as likely."""


def follow_marker(points_m: Floats32, offsets: Ints, time_s: Floats, start_m: Floats) -> Floats:
    """Follow a marker by nearest neighbour to where its last speed takes it.

    A ghost that is taken for the marker in some frames is left to the fit that uses the result.

    Parameters
    ----------
    points_m, offsets
        The point lists of F frames.
    time_s : (F,)
        Capture times; frames may be in any order.
    start_m : (3,)
        Where the marker is in the first frames, lab frame, to 30 mm.

    Returns
    -------
    (F, 3) float64
        NaN where it was not seen.
    """
    found = np.full((len(time_s), 3), np.nan)
    place, speed, seen_s = np.asarray(start_m, dtype=np.float64), np.zeros(3), np.nan
    for frame in np.argsort(time_s, kind="stable"):
        points = points_m[offsets[frame] : offsets[frame + 1]]
        hidden_s = time_s[frame] - seen_s
        gate = START_RADIUS_M if np.isnan(seen_s) else min(GATE_M + FASTEST_M_PER_S * hidden_s, LARGEST_GATE_M)
        expected = place if np.isnan(seen_s) else place + speed * hidden_s
        distance = np.sqrt(np.square(points - expected).sum(axis=1))
        if not len(distance) or not distance.min() <= gate:
            continue
        point = points[distance.argmin()].astype(np.float64)
        speed = (point - place) / hidden_s if hidden_s > 0 else np.zeros(3)
        found[frame], place, seen_s = point, point, time_s[frame]
    return found
