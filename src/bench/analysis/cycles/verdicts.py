"""The verdict on each cycle, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Ints
from bench.analysis.cycles.gaps import Gaps
from bench.analysis.cycles.table import CycleTable
from bench.model import Verdict

__all__ = ["CycleVerdicts", "judge_cycles"]

END_SLACK = 2
"""Frame periods by which the first and last frame may miss a cycle's ends: an exposure is on its way for about one."""


@dataclass(frozen=True, eq=False)
class CycleVerdicts:
    """One verdict for each cycle, and the sentences behind those that are not ok."""

    verdict: list[Verdict]
    reasons: dict[int, list[str]]
    """By `cycle_index`."""


def judge_cycles(
    table: CycleTable,
    frame_ns: Ints,
    tracker_gaps: Gaps,
    robot_gaps: Gaps | None,
    slow_cycle_ratio: float,
    interrupted: Mapping[int, str] | None = None,
    slowed: Mapping[int, str] | None = None,
) -> CycleVerdicts:
    """Judge every cycle: interrupted before gap, gap before slow, else ok.

    Parameters
    ----------
    table : CycleTable
        The cycles.
    frame_ns : (F,)
        Capture times of the tracker's frames, ascending.
    tracker_gaps, robot_gaps : Gaps
        What is missing from both streams; None without a robot.
    slow_cycle_ratio : float
        A cycle longer than this times the median is slow.
    interrupted : mapping, optional
        What stopped the robot on its path, by `cycle_index`, though it may have gone on: as recorded in the run.
    slowed : mapping, optional
        How cycles were driven that were slower on purpose, by `cycle_index`: as recorded in the run.
    """
    stopped = np.isin(table.cycle_index, list(interrupted or {}))
    findings = [
        (Verdict.INTERRUPTED, ~table.complete, "was not completed"),
        (Verdict.INTERRUPTED, table.complete & ~table.unbroken, "was driven in more than one stretch"),
        (Verdict.INTERRUPTED, stopped & table.complete, "was interrupted, and driven to its end later"),
        (Verdict.GAP, table.complete & ~table.seen, "has no recorded beginning"),
        (Verdict.GAP, tracker_gaps.touch(table.start_ns, table.end_ns), "tracker frames are missing"),
        (Verdict.GAP, _lacks_frames(table, frame_ns), "the tracker's frames do not cover it"),
        (Verdict.SLOW, _is_slow(table, slow_cycle_ratio), _slow_sentence(table, slow_cycle_ratio)),
    ]
    if robot_gaps is not None:
        findings.insert(4, (Verdict.GAP, robot_gaps.touch(table.start_ns, table.end_ns), "robot samples are missing"))
    verdict = [Verdict.OK] * len(table.cycle_index)
    reasons: dict[int, list[str]] = {}
    for kind, rows, sentence in findings:
        for row in np.flatnonzero(rows):
            reasons.setdefault(int(table.cycle_index[row]), []).append(sentence)
            if verdict[row] is Verdict.OK:
                verdict[row] = kind
    for cycle_index, detail in [*(interrupted or {}).items(), *(slowed or {}).items()]:
        if cycle_index in reasons and detail:
            reasons[cycle_index].append(detail.rstrip("."))
    return CycleVerdicts(verdict, reasons)


def _lacks_frames(table: CycleTable, frame_ns: Ints) -> Bools:
    if len(frame_ns) < 2:
        return np.ones(len(table.start_ns), dtype=bool)
    slack = END_SLACK * int(np.median(np.diff(frame_ns)))
    return np.asarray((table.start_ns < frame_ns[0] - slack) | (table.end_ns > frame_ns[-1] + slack), dtype=bool)


def _is_slow(table: CycleTable, ratio: float) -> Bools:
    return np.asarray(table.duration_s > ratio * table.usual_duration_s, dtype=bool)


def _slow_sentence(table: CycleTable, ratio: float) -> str:
    return f"took longer than {ratio:g} times the usual {table.usual_duration_s:.3g} s"
