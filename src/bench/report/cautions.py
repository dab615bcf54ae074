"""What the reader must know before believing the numbers of the first screen."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.report.drift_text import warn_about_drift
from bench.report.ends import END_BEND
from bench.report.headline import Headline, find_unjudged_bend
from bench.report.methods import warn_about_clamps
from bench.report.results import Results
from bench.report.wording import say_percent, say_radius

__all__ = ["list_cautions"]

MOST_STRETCHES = 3
SMALL_SHARE = 0.02
"""Of the cycle, or of its places and moments: less is a few frames of a short recording."""


def list_cautions(results: Results, headline: Headline) -> list[str]:
    """Return one sentence each: what is particular to this run first, what holds for the method last."""
    named = any(text.startswith(END_BEND) for text in results.warnings)
    clamps = warn_about_clamps(results) if headline.tightest and not named else ""
    unseen = _warn_about_unseen(results) if headline.tightest else ""
    texts = [_warn_about_unjudged(results), unseen, *warn_about_drift(results), *results.warnings, clamps]
    return [text for text in texts if text]


def _warn_about_unjudged(results: Results) -> str:
    bend = find_unjudged_bend(results)
    if bend is None:
        return ""
    return (
        f"Cycle {bend.cycle_index} shows a tighter bend, {say_radius(bend.radius_mm, bend.low_mm)} mm, but was not "
        "recorded whole: it counts neither for the outcome nor here."
    )


def _warn_about_unseen(results: Results) -> str:
    """Say where in the cycle no cycle shows the cable: what was bent there is in no figure."""
    unseen = ~np.isfinite(results.bend_map_per_m)
    gone = unseen.mean(axis=1) > 0.5
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


def _list_stretches(gone: npt.NDArray[np.bool_]) -> str:
    """Return the phases between which `gone` (P,) is true, the longest ones where there are many."""
    starts, stops = (np.flatnonzero(np.diff(gone.astype(int), prepend=0, append=0) == step) for step in (1, -1))
    longest = np.sort(np.argsort(starts - stops, kind="stable")[:MOST_STRETCHES])
    told = [f"{starts[i] / gone.size:.2f} to {stops[i] / gone.size:.2f}" for i in longest]
    return ", ".join(told) + (" and others" if len(starts) > MOST_STRETCHES else "")
