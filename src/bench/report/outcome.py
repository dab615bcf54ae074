"""The verdict on the run: PASS, FAIL for the cable, ERROR for the bench; and the cycles that need a look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis import CycleVerdicts, bend_radius
from bench.model import ExitStatus, Outcome, Verdict
from bench.report.results import CycleColumns, StreamFinding

__all__ = ["RunEnd", "find_attention", "judge_run"]

IMPORT = "import"
UNFINISHED = "unfinished"
OUTLIER_RATIO = 1.1
"""A cycle whose largest curvature is this times the median differs by more than noise and drift explain."""
LOW_COMPLETE_FRACTION = 0.5
FEWEST_TRUSTED = 0.5
"""Of the frames of cycles: with fewer, those that are trusted are the exception, and may be so by chance."""


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
) -> tuple[Outcome, list[str]]:
    """Judge the run and say why it is not PASS, one sentence for each reason.

    FAIL comes first: what was lost can hide a bend that is too tight, but cannot make one. FAIL rests on cycles with
    verdict ok or slow only. PASS needs a curve in each of these, and trust in most frames: that is what is left of a
    recording in which the order of the markers cannot be told, or contradicts itself.

    Parameters
    ----------
    cycles, streams, end
        What became of the run.
    minimum_bend_radius_mm : float
        The catalogue's limit.
    trusted_fraction : float
        Part of the frames inside cycles that may enter the figures; 0 without any.
    """
    failures = _too_tight(cycles, minimum_bend_radius_mm)
    lost = [*_end_errors(end), *_stream_errors(streams), *_cycle_errors(cycles, end)]
    errors = [*lost, *_curve_errors(cycles, trusted_fraction)]
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
    sentence = (
        f"The bend radius is below the limit of {limit_mm:g} mm in {len(tight)} of {int(judged.sum())} cycles; the "
        f"smallest is {cycles.min_bend_radius_mm[row]:.1f} mm ({1e3 * bend.low_m:.1f} to {1e3 * bend.high_m:.1f} mm "
        "within two standard deviations) in cycle "
        f"{cycles.cycle_index[row]}, {cycles.max_curvature_arc_length_m[row] * 1e3:.0f} mm from the anchor."
    )
    usual = float(np.median(cycles.min_bend_radius_mm[judged & np.isfinite(cycles.min_bend_radius_mm)]))
    if usual < limit_mm:
        return [sentence]
    return [f"{sentence} In the median cycle it is {usual:.1f} mm: see whether the markers of the others are sorted."]


def _end_errors(end: RunEnd) -> list[str]:
    if end.exit_status in (ExitStatus.SUCCESS, IMPORT):
        return []
    because = f": {end.reason.rstrip('.')}" if end.reason else ""
    return [f"The run did not end as meant ({end.exit_status}){because}."]


def _stream_errors(streams: list[StreamFinding]) -> list[str]:
    dropped = [f"{s.dropped} of {s.topic}" for s in streams if s.dropped]
    missed = [f"{s.missed} of {s.topic}" for s in streams if s.missed]
    sentences = [f"Records were dropped by the recorder: {', '.join(dropped)}."] if dropped else []
    return sentences + ([f"Records never arrived: {', '.join(missed)}."] if missed else [])


def _cycle_errors(cycles: CycleColumns, end: RunEnd) -> list[str]:
    interrupted = [int(i) for i, v in zip(cycles.cycle_index, cycles.verdict, strict=True) if v == Verdict.INTERRUPTED]
    if end.exit_status == IMPORT:  # a take begins and ends in the middle of a cycle, and nobody is at fault
        interrupted = []
    sentences = [f"Cycles were interrupted: {_list_briefly(interrupted)}."] if interrupted else []
    if Verdict.OK not in cycles.verdict:
        sentences.append("No cycle was recorded." if not len(cycles.verdict) else "No cycle has the verdict ok.")
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


def _list_briefly(numbers: list[int]) -> str:
    shown = ", ".join(str(number) for number in numbers[:10])
    return shown if len(numbers) <= 10 else f"{shown} and {len(numbers) - 10} more"
