"""What the reader must know before believing the numbers of the first screen."""

from __future__ import annotations

from bench.report.drift_text import warn_about_drift
from bench.report.ends import END_BEND
from bench.report.headline import Headline, find_unjudged_bend
from bench.report.methods import warn_about_clamps
from bench.report.results import Results
from bench.report.unseen import describe_unseen
from bench.report.wording import say_radius

__all__ = ["list_cautions"]


def list_cautions(results: Results, headline: Headline) -> list[str]:
    """Return one sentence each: what is particular to this run first, what holds for the method last."""
    named = any(text.startswith(END_BEND) for text in results.warnings)
    clamps = warn_about_clamps(results) if headline.tightest and not named else ""
    unseen = describe_unseen(results.bend_map_per_m) if headline.tightest else ""
    texts = [_warn_about_unjudged(results), unseen, *warn_about_drift(results), *results.warnings, clamps]
    return [text for text in texts if text and text not in results.outcome_reasons]


def _warn_about_unjudged(results: Results) -> str:
    bend = find_unjudged_bend(results)
    if bend is None:
        return ""
    return (
        f"Cycle {bend.cycle_index} shows a tighter bend, {say_radius(bend.radius_mm, bend.low_mm)} mm, but was not "
        "recorded whole: it counts neither for the outcome nor here."
    )
