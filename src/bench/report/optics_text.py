"""The optics of a cycle judged: four items with limit, value and verdict, and what stands behind them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.analysis import HiddenStretch, judge_frame_rate
from bench.config import Config, TrackerConfig
from bench.model import CheckItem
from bench.recording import Run
from bench.report.optics import SeenCycle, see_first_cycle
from bench.report.places_text import CLEAR_MM, describe_places, find_misplaced

__all__ = ["OpticsFindings", "judge_optics"]

COMPLETE_FRACTION = 0.95
"""Of a cycle's frames with every marker: fewer, and the tightest bend may be among the others."""
OUTSIDE_MM = 15.0
"""A marker that goes so far out of what is seen has left the view. Where it is then was told to 10-30 mm on the
simulated bench, and markers hidden by its arm seemed to be outside by 7 mm at most (measured 2026-11)."""
MOST_LINES = 20


@dataclass(frozen=True)
class OpticsFindings:
    """What `bench check --cycle` says."""

    items: list[CheckItem]
    """Frame rate, markers seen, common view, marker places."""
    lines: list[str]
    """Where markers are missing, where they sit, and what to paste into the configuration."""


def judge_optics(run: Run, config: Config) -> OpticsFindings:
    """Judge the first completed cycle of a recording.

    Raises
    ------
    AnalysisError
        There is none, it has no frames, or the anchor is not found.
    """
    cycle = see_first_cycle(run, config)
    places_m = np.array(config.cable.arc_length_m)
    items = [
        _judge_rate(cycle, config),
        _judge_seen(cycle, places_m),
        _judge_view(cycle, places_m),
        _judge_places(cycle, places_m),
    ]
    lines = _describe_stretches(cycle, places_m)
    if cycle.places is not None:
        lines += describe_places(cycle.places.arc_length_m, cycle.places.sigma_m, places_m)
    return OpticsFindings(items, [*lines, *_suggest_speed(cycle, config)])


def _judge_rate(cycle: SeenCycle, config: Config) -> CheckItem:
    configured = config.cable.max_speed_m_s
    measured = cycle.full_speed_m_s if np.isfinite(cycle.full_speed_m_s) else None
    accuracy_mm = (config.tracker or TrackerConfig(host="none")).accuracy_mm
    if measured is None or (configured is not None and configured > measured):
        return judge_frame_rate(cycle.rate_hz, configured, accuracy_mm, "as configured")
    slowly = f"measured at {cycle.speed_fraction:.0%} and scaled to full speed"
    known_from = slowly if cycle.speed_fraction < 1 else "measured"
    return judge_frame_rate(cycle.rate_hz, measured, accuracy_mm, known_from)


def _suggest_speed(cycle: SeenCycle, config: Config) -> list[str]:
    speed = cycle.full_speed_m_s
    if config.cable.max_speed_m_s is not None or not np.isfinite(speed):
        return []
    return ["For a check of the frame rate before each run, in [cable] write:", f"max_speed_m_s = {speed:.2f}"]


def _judge_seen(cycle: SeenCycle, places_m: npt.NDArray[np.float64]) -> CheckItem:
    seen = cycle.seen
    fraction, share = float(seen.all(axis=1).mean()), seen.mean(axis=0)
    name, limit = "markers seen", f"all {len(places_m)} in >= {COMPLETE_FRACTION:.0%} of the frames"
    value = f"{fraction:.1%} of {len(seen)} frames"
    if fraction >= COMPLETE_FRACTION:
        return CheckItem(name, limit, value, "ok")
    worst = int(share.argmin())
    where = f"the marker at {places_m[worst]:g} m is seen in {share[worst]:.1%} of them"
    if fraction > 0:
        sentence = (
            f"Some frames lack a marker: {where}. Move a camera or add one, turn the marker towards the cameras, or "
            "look at exposure and threshold."
        )
        return CheckItem(name, limit, value, "warn", sentence)
    sentence = (
        f"In no frame of the cycle are all markers found: {where}. Check marker_arc_length_m, the anchor, and what the "
        "cameras see."
    )
    return CheckItem(name, limit, value, "fail", sentence, exit_code=4)


def _judge_view(cycle: SeenCycle, places_m: npt.NDArray[np.float64]) -> CheckItem:
    name, limit = "common view", "no marker leaves it"
    leaving = [stretch for stretch in cycle.stretches if _leaves(cycle, stretch)]
    if not leaving:
        return CheckItem(name, limit, "none leaves it" if cycle.seen.any() else "nothing is seen", "ok")
    markers = {stretch.marker_index for stretch in leaving}
    worst = max(leaving, key=_outside_mm)
    sentence = (
        f"The marker at {places_m[worst.marker_index]:g} m goes out of the space in which markers are seen: at phase "
        f"{_phases(cycle, worst)}, {_last_seen(worst)}, {_fate(cycle, worst)}. Aim the cameras there, or move the path."
    )
    return CheckItem(name, limit, f"{len(markers)} of {len(places_m)} leave it", "warn", sentence)


def _judge_places(cycle: SeenCycle, places_m: npt.NDArray[np.float64]) -> CheckItem:
    name, limit = "marker places", f"within {CLEAR_MM:g} mm of [cable]"
    if cycle.places is None:
        return CheckItem(name, limit, "not measured", "open", cycle.places_problem)
    apart_mm = 1e3 * np.abs(cycle.places.arc_length_m - places_m)
    worst = int(apart_mm.argmax())
    value = f"up to {apart_mm[worst]:.1f} mm off, sd {1e3 * cycle.places.sigma_m[worst]:.1f} mm"
    wrong = find_misplaced(cycle.places.arc_length_m, cycle.places.sigma_m, places_m)
    if not len(wrong):
        return CheckItem(name, limit, value, "ok")
    sentence = (
        f"{len(wrong)} of {len(places_m)} markers sit elsewhere than configured, the one at {places_m[worst]:g} m by "
        f"{apart_mm[worst]:.1f} mm: paste the line below into [cable]."
    )
    return CheckItem(name, limit, value, "warn", sentence)


def _leaves(cycle: SeenCycle, stretch: HiddenStretch) -> bool:
    """Return whether a marker has left the view; nothing goes further than the time allows, a wrong point does."""
    reach_mm = 1e3 * cycle.speed_m_s * stretch.n_frames / cycle.rate_hz / 2
    outside_mm = _outside_mm(stretch)
    return outside_mm > OUTSIDE_MM and not outside_mm > reach_mm


def _outside_mm(stretch: HiddenStretch) -> float:
    return 1e3 * float(np.linalg.norm(stretch.outside_m))


def _describe_stretches(cycle: SeenCycle, places_m: npt.NDArray[np.float64]) -> list[str]:
    """Return one line for each stretch without a marker, the longest first."""
    longest = sorted(cycle.stretches, key=lambda stretch: -stretch.n_frames)
    lines = [
        f"missing: the marker at {places_m[stretch.marker_index]:g} m, phase {_phases(cycle, stretch)} "
        f"({stretch.n_frames} frames), {_last_seen(stretch)}: {_fate(cycle, stretch)}"
        for stretch in longest[:MOST_LINES]
    ]
    rest = len(longest) - MOST_LINES
    return [*lines, f"… and {rest} shorter ones"] if rest > 0 else lines


def _phases(cycle: SeenCycle, stretch: HiddenStretch) -> str:
    return f"{cycle.phase[stretch.start]:.3f}-{cycle.phase[stretch.stop - 1]:.3f}"


def _last_seen(stretch: HiddenStretch) -> str:
    if np.isnan(stretch.edge_m).any():
        return "never seen"
    place = ", ".join(f"{value:.3f}" for value in stretch.edge_m)
    return f"{'last' if stretch.start > 0 else 'first'} seen at ({place}) m"


def _fate(cycle: SeenCycle, stretch: HiddenStretch) -> str:
    if np.isnan(stretch.outside_m).any():
        return "nothing tells where it was"
    if not _leaves(cycle, stretch):
        return "hidden, amid what is seen"
    axis = int(np.abs(stretch.outside_m).argmax())
    sign = "+" if stretch.outside_m[axis] > 0 else "-"
    return f"gone out of view towards {sign}{'xyz'[axis]}, by about {_outside_mm(stretch):.0f} mm"
