"""The robot's cycle learnt from a recording: which cycles to learn from, and the template that comes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.analysis.arrays import Floats32, Ints
from bench.analysis.sorting.chain import sort_by_chain
from bench.analysis.sorting.gates import SortSettings
from bench.analysis.sorting.markers import MarkerReason, PointFrames
from bench.analysis.sorting.phase_following import follow_frames
from bench.analysis.sorting.phase_template import (
    PhaseTemplate,
    half_way_to_next,
    lay_over_cycles,
    learn_template,
    median_over_cycles,
)

__all__ = ["FEWEST_CYCLES", "LEARNT_CYCLES", "count_usable", "learn_cycle", "rows_in_cycles"]

FEWEST_CYCLES = 5
"""Of four cycles, two wrong ones move the median."""
LEARNT_CYCLES = 10
"""Twenty would make 0.01 % more of the frames exact, at twice the time for the chain search."""
SCANNED_CYCLES = 40
"""Among the first of them the best are chosen to learn from."""
LEARNT_FRAMES = 600
"""Of each cycle, evenly: the chain search is tens of times slower than following."""
MOST_BINS = 2_000
LEAST_BIN_S = 1e-6
"""A tracker whose clock stands still gives no time to divide by."""
USUAL_LENGTH = (0.8, 1.25)
"""Times the median number of frames: a cycle outside of that was interrupted, or has lost frames."""
FREE_ENDS = 0.05
"""Of the phase, that a whole cycle's first and last frames may leave open."""
KNOWN_SHARE = 0.5
"""Of the markers along the path: a template that knows less of them was learnt from cycles that are not sorted."""


def learn_cycle(frames: PointFrames, settings: SortSettings) -> PhaseTemplate | None:
    """Learn the template of a cycle from the best of a recording's first cycles; None where there are too few.

    The chain search sorts frames of those cycles, the median over them gives a template, all of their frames are
    sorted by that, and the median over these gives the template that is returned.
    """
    cycles = _choose_cycles(frames, settings)
    if len(cycles) < FEWEST_CYCLES:
        return None
    every = frames.take(rows_in_cycles(frames, cycles))
    thinned = every.take(_thin_out(every))
    chained = sort_by_chain(thinned, settings)
    sure = np.where((chained.reason == MarkerReason.FOUND)[..., None], chained.position_m, np.float32(np.nan))
    cycles = _drop_unsorted(thinned, sure, cycles)
    if len(cycles) < FEWEST_CYCLES:
        return None
    template = _lay_and_learn(thinned, sure, cycles, settings, chained.position_m)
    if np.isfinite(template.position_m[..., 0]).mean() < KNOWN_SHARE:
        return None
    followed = follow_frames(every, np.arange(len(every)), template)
    learnt = _lay_and_learn(every, followed.sure_positions(every), cycles, settings)
    return replace(learnt, warnings=tuple(chained.warnings))


def _find_whole_cycles(frames: PointFrames) -> Ints:
    """Return the cycles that were recorded from end to end, in order of time."""
    if frames.cycle is None or frames.phase is None:
        return np.zeros(0, dtype=np.int64)
    inside = rows_in_cycles(frames)
    if not len(inside):
        return inside
    cycle, phase = frames.cycle[inside], frames.phase[inside]
    begin = np.flatnonzero(np.diff(cycle, prepend=cycle[0] - 1))
    count = np.diff(np.append(begin, len(inside)))
    lowest, highest = np.minimum.reduceat(phase, begin), np.maximum.reduceat(phase, begin)
    low, high = USUAL_LENGTH[0] * np.median(count), USUAL_LENGTH[1] * np.median(count)
    whole = (lowest < FREE_ENDS) & (highest > 1 - FREE_ENDS) & (count >= low) & (count <= high)
    return np.asarray(cycle[begin[whole]])


def rows_in_cycles(frames: PointFrames, cycles: Ints | None = None) -> Ints:
    """Return the frames of some cycles, or of all, in order of time."""
    if frames.cycle is None or frames.phase is None:
        return np.zeros(0, dtype=np.int64)
    wanted = frames.cycle >= 0 if cycles is None else np.isin(frames.cycle, cycles)
    rows = np.flatnonzero(wanted & np.isfinite(frames.phase))
    return rows[np.argsort(frames.time_ns[rows], kind="stable")]


def count_usable(frames: PointFrames) -> Ints:
    """Return (F,) how many points of each frame may be the cable's."""
    before = np.concatenate([[0], np.cumsum(frames.usable)])
    return np.asarray(before[frames.offsets[1:]] - before[frames.offsets[:-1]])


def _choose_cycles(frames: PointFrames, settings: SortSettings) -> Ints:
    """Return the whole cycles in which most markers are in sight, in order of time."""
    scanned = _find_whole_cycles(frames)[:SCANNED_CYCLES]
    if frames.cycle is None or len(scanned) == 0:
        return scanned
    in_sight = np.minimum(count_usable(frames), settings.n_markers)
    quality = np.array([in_sight[frames.cycle == index].mean() for index in scanned])
    return scanned[np.sort(np.argsort(-quality, kind="stable")[:LEARNT_CYCLES])]


def _thin_out(frames: PointFrames) -> Ints:
    """Return at most `LEARNT_FRAMES` frames of each cycle."""
    _, count = np.unique(np.asarray(frames.cycle), return_counts=True)
    return np.arange(0, len(frames), max(1, int(np.ceil(np.median(count) / LEARNT_FRAMES))))


def _drop_unsorted(frames: PointFrames, sure_m: Floats32, cycles: Ints) -> Ints:
    """Return the cycles in which at least half as much is sorted as in the best."""
    found = np.isfinite(sure_m[..., 0]).mean(axis=1)
    share = np.array([found[frames.cycle == index].mean() for index in cycles])
    return np.asarray(cycles[(share > 0) & (share >= share.max() / 2)])


def _lay_and_learn(
    frames: PointFrames, sure_m: Floats32, cycles: Ints, settings: SortSettings, likely_m: Floats32 | None = None
) -> PhaseTemplate:
    """Learn from what is sure, and where too few cycles show that, from what is likely: its median mostly is right."""
    cycle, phase = np.asarray(frames.cycle), np.asarray(frames.phase)
    n_frames = int(np.median([(cycle == index).sum() for index in cycles]))
    n_bins = min(max(n_frames, 2), MOST_BINS)
    took_s = np.median([np.ptp(frames.time_ns[cycle == index]) for index in cycles]) * 1e-9
    laid = lay_over_cycles(sure_m, cycle, phase, cycles.tolist(), n_bins)
    if likely_m is not None:
        is_known = np.isfinite(median_over_cycles(laid, half_way_to_next(np.array(settings.arc_length_m))))
        laid = np.where(is_known, laid, lay_over_cycles(likely_m, cycle, phase, cycles.tolist(), n_bins))
    return learn_template(
        laid,
        settings.arc_length_m,
        bin_s=max(float(took_s) / n_bins, LEAST_BIN_S),
        least_sigma_m=np.sqrt(2.0) * settings.noise_m,
        is_anchored=frames.anchor_m is not None,
        share=0.95 if likely_m is None else 0.75,
    )
