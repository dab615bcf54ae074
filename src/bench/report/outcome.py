"""The verdict on the run: PASS, FAIL for the cable, ERROR for the bench; and the cycles that need a look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.analysis import CycleVerdicts, bend_radius
from bench.model import ExitStatus, Outcome, Verdict
from bench.report.results import CycleColumns, StreamFinding
from bench.report.streams import find_missing
from bench.report.unseen import describe_unseen, find_unseen_share
from bench.report.wording import say_radius, say_range

__all__ = ["IMPORT", "RunEnd", "find_attention", "judge_run"]

IMPORT = "import"
UNFINISHED = "unfinished"
OUTLIER_RATIO = 1.1
"""A cycle whose largest curvature is this times the median differs by more than noise and drift explain."""
LOW_COMPLETE_FRACTION = 0.5
FEWEST_TRUSTED = 0.5
"""Of the frames of cycles: with fewer, those that are trusted are the exception, and may be so by chance."""

MOST_UNSEEN = 0.1
"""Of the cycle. Bends come and go over about a tenth of it, so one could be tightest where nobody saw it."""


@dataclass(frozen=True)
class RunEnd:
    """How the run ended."""

    exit_status: str
    """success, abort, fail, unfinished; `import` for a take."""
    reason: str


def judge_run(
    cycles: CycleColumns,
    streams: list[StreamFinding],
    end: RunEnd,
    minimum_bend_radius_mm: float,
    trusted_fraction: float,
    bend_map_per_m: npt.NDArray[np.float64],
) -> tuple[Outcome, list[str]]:
    """Judge the run and say why it is not PASS, one sentence for each reason.

    FAIL comes first: what was lost can hide a bend that is too tight, but cannot make one. FAIL rests on cycles with
    verdict ok or slow only. PASS needs a curve in each of these, trust in most frames, and a look at the cable in
    nearly all of the cycle: else little is left of a recording whose markers are hidden, or in no certain order.

    Parameters
    ----------
    cycles, streams, end
        What became of the run.
    minimum_bend_radius_mm : float
        The catalogue's limit.
    trusted_fraction : float
        Part of the frames inside cycles that may enter the figures; 0 without any.
    bend_map_per_m : ndarray, shape (P, G)
        Mean curvature by phase and arc length; NaN where nothing was seen.
    """
    failures = _too_tight(cycles, minimum_bend_radius_mm)
    lost = [*_end_errors(end), *_stream_errors(streams), *_cycle_errors(cycles, end)]
    errors = [*lost, *_curve_errors(cycles, trusted_fraction), *_unseen_errors(bend_map_per_m)]
    outcome = Outcome.FAIL if failures else Outcome.ERROR if errors else Outcome.PASS
    return outcome, [*failures, *errors]


def find_attention(cycles: CycleColumns, verdicts: CycleVerdicts) -> dict[int, list[str]]:
    """Return the cycles that need a look with the reasons in words, by index."""
    attention = {
        index: [f"it {sentence}" if sentence.startswith(("was", "has", "took")) else sentence for sentence in sentences]
        for index, sentences in verdicts.reasons.items()
    }
    peak = cycles.max_curvature_per_m
    usual = float(np.median(peak[np.isfinite(peak)])) if np.isfinite(peak).any() else float("nan")
    for row, index in enumerate(cycles.cycle_index.tolist()):
        found = attention.setdefault(index, [])
        if peak[row] > OUTLIER_RATIO * usual and peak[row] - usual > 4 * cycles.max_curvature_sigma_per_m[row]:
            found.append(f"its largest curvature is {peak[row] / usual:.2f} times the usual one")
        if np.isnan(peak[row]) and cycles.n_frames[row] > 0:
            found.append("no frame of it has a trusted curve")
        elif cycles.complete_fraction[row] < LOW_COMPLETE_FRACTION:
            found.append(f"all markers were found in only {cycles.complete_fraction[row]:.0%} of its frames")
    return {index: sentences for index, sentences in sorted(attention.items()) if sentences}


def _too_tight(cycles: CycleColumns, limit_mm: float) -> list[str]:
    judged = np.isin(cycles.verdict, [Verdict.OK, Verdict.SLOW])
    tight = np.flatnonzero(judged & (cycles.min_bend_radius_mm < limit_mm))
    if not len(tight):
        return []
    row = tight[cycles.min_bend_radius_mm[tight].argmin()]
    bend = bend_radius(cycles.max_curvature_per_m[row], cycles.max_curvature_sigma_per_m[row])
    radius_mm, low_mm, high_mm = (1e3 * float(one) for one in (bend.radius_m, bend.low_m, bend.high_m))
    between = f" ({say_range(radius_mm, low_mm, high_mm)} mm within two standard deviations)"
    within = between if np.isfinite(low_mm) else ""
    sentence = (
        f"The bend radius is below the limit of {limit_mm:g} mm in {len(tight)} of {int(judged.sum())} cycles; the "
        f"smallest is {say_radius(radius_mm, low_mm)} mm{within} in cycle "
        f"{cycles.cycle_index[row]}, {cycles.max_curvature_arc_length_m[row] * 1e3:.0f} mm from the anchor."
    )
    usual = float(np.median(cycles.min_bend_radius_mm[judged & np.isfinite(cycles.min_bend_radius_mm)]))
    if usual < limit_mm:
        return [sentence]
    typical = say_radius(usual, usual * low_mm / radius_mm)
    return [f"{sentence} In the median cycle it is {typical} mm: see whether the markers of the others are sorted."]


def _end_errors(end: RunEnd) -> list[str]:
    if end.exit_status in (ExitStatus.SUCCESS, IMPORT):
        return []
    if end.exit_status == UNFINISHED:
        return ["The recording breaks off: bench was killed, the power failed, or the copy of the file is not whole."]
    because = f": {end.reason.rstrip('.')}" if end.reason else ""
    return [f"The run did not end as meant ({end.exit_status}){because}."]


def _stream_errors(streams: list[StreamFinding]) -> list[str]:
    dropped = [f"{s.dropped} of {s.topic}" for s in streams if s.dropped]
    sentences = [f"Records were dropped by the recorder: {', '.join(dropped)}."] if dropped else []
    return sentences + [_say_missing(device, stream) for device, stream in find_missing(streams).items()]


def _say_missing(device: str, stream: StreamFinding) -> str:
    sent = stream.received + stream.missed
    return f"{stream.missed} of {sent} records of the {device} never arrived ({stream.missed / sent:.1%})."


def _cycle_errors(cycles: CycleColumns, end: RunEnd) -> list[str]:
    interrupted = [int(i) for i, v in zip(cycles.cycle_index, cycles.verdict, strict=True) if v == Verdict.INTERRUPTED]
    if end.exit_status == IMPORT:  # a take begins and ends in the middle of a cycle, and nobody is at fault
        interrupted = []
    sentences = [_say_interrupted(interrupted)] if interrupted else []
    if not len(cycles.verdict):
        sentences.append("No cycle was recorded.")
    elif Verdict.OK not in cycles.verdict:
        sentences.append("No cycle has the verdict ok: see Cycles that need a look.")
    return sentences


def _curve_errors(cycles: CycleColumns, trusted_fraction: float) -> list[str]:
    judged = np.isin(cycles.verdict, [Verdict.OK, Verdict.SLOW])
    without = cycles.cycle_index[judged & np.isnan(cycles.max_curvature_per_m)].tolist()
    n_judged, sentences = int(judged.sum()), []
    if without and len(without) == n_judged:
        sentences.append("In no cycle could a curve be drawn.")
    elif without:
        sentences.append(f"In {len(without)} of {n_judged} cycles no curve can be trusted: {_list_briefly(without)}.")
    if 0 < trusted_fraction < FEWEST_TRUSTED:
        sentences.append(
            f"Only in {trusted_fraction:.0%} of the frames of cycles is the order of the markers sure and possible: a "
            "tight bend in the others would not be seen."
        )
    return sentences


def _unseen_errors(bend_map_per_m: npt.NDArray[np.float64]) -> list[str]:
    share = find_unseen_share(bend_map_per_m)
    return [describe_unseen(bend_map_per_m)] if MOST_UNSEEN < share < 1 else []


def _say_interrupted(indices: list[int]) -> str:
    if len(indices) == 1:
        return f"Cycle {indices[0]} was interrupted."
    return f"{len(indices)} cycles were interrupted: {_list_briefly(indices)}."


def _list_briefly(numbers: list[int]) -> str:
    shown = ", ".join(str(number) for number in numbers[:10])
    return shown if len(numbers) <= 10 else f"{shown} and {len(numbers) - 10} more"
