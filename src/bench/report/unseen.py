"""Where in the cycle no cycle shows the cable: what was bent there is in no figure."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.report.wording import say_percent

__all__ = ["describe_unseen", "find_unseen_share"]

MOST_STRETCHES = 3
SMALL_SHARE = 0.02
"""Of the cycle, or of its places and moments: less is a few frames of a short recording."""


def find_unseen_share(bend_map_per_m: npt.NDArray[np.float64]) -> float:
    """Return the share of the cycle's phases at which most of the cable was seen in no cycle.

    Parameters
    ----------
    bend_map_per_m : ndarray, shape (P, G)
        Mean curvature by phase and arc length; NaN where nothing was seen.
    """
    return float(_find_gone(bend_map_per_m).mean())


def describe_unseen(bend_map_per_m: npt.NDArray[np.float64]) -> str:
    """Return a sentence that says what was not seen; empty where that is little."""
    gone, unseen = _find_gone(bend_map_per_m), ~np.isfinite(bend_map_per_m)
    if gone.mean() >= SMALL_SHARE:
        share = say_percent(float(gone.mean()))
        return (
            f"At phase {_list_stretches(gone)} of the cycle ({share} of it) the cable was not seen well enough in any "
            "cycle: a tighter bend there would not show."
        )
    if unseen.mean() >= SMALL_SHARE:
        share = say_percent(float(unseen.mean()))
        return f"{share} of the Bend-radius map is empty in all cycles: a tighter bend there would not show."
    return ""


def _find_gone(bend_map_per_m: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    return np.asarray((~np.isfinite(bend_map_per_m)).mean(axis=1) > 0.5)


def _list_stretches(gone: npt.NDArray[np.bool_]) -> str:
    """Return the phases between which `gone` (P,) is true, the longest ones where there are many."""
    starts, stops = (np.flatnonzero(np.diff(gone.astype(int), prepend=0, append=0) == step) for step in (1, -1))
    longest = np.sort(np.argsort(starts - stops, kind="stable")[:MOST_STRETCHES])
    told = [f"{starts[i] / gone.size:.2f} to {stops[i] / gone.size:.2f}" for i in longest]
    return ", ".join(told) + (" and others" if len(starts) > MOST_STRETCHES else "")
