"""From two analysed recordings, or one and a known shape, to their difference over cycle phase and arc length."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from bench.analysis import (
    TRUSTED_CONFIDENCE,
    KnownShape,
    MotionDifference,
    RigidTransform,
    align_in_space,
    align_in_time,
    compare_motions,
    draw_motion,
    fit_shape,
    median_cycle,
    shift_motion,
)
from bench.config import describe_loaded_program, describe_program_file
from bench.errors import AnalysisError, TooFewMarkersError
from bench.model import Verdict
from bench.report.results import Results

__all__ = ["Comparison", "compare_runs", "compare_with_shape"]

Floats = npt.NDArray[np.float64]

MOST_PHASES = 1_000
"""20 ms of a take of 20 s; with the places along the cable a table of 100 000 rows."""
LOW_COMPARED = 0.5
FEWEST_MARKERS = 4
"""A spline through fewer is not told."""
WHOLE_CYCLES = (Verdict.OK.value, Verdict.SLOW.value)
"""Cycles that were driven to their end without a stop; their phase is the same as any other's."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two motions at the same P phases and G places along the cable."""

    first: Results
    second_name: str
    cycle_phase: Floats
    """(P,)"""
    arc_length_m: Floats
    """(G,)"""
    first_m: Floats
    """(P, G, 3): lab frame of the first."""
    second_m: Floats
    """(P, G, 3): the same, aligned as was asked for."""
    difference: MotionDifference
    late: float | None = None
    """Share of a cycle by which the second was late and was put forward; None where that was not asked for."""
    moved: RigidTransform | None = None
    """What laid the second into the lab frame of the first."""
    notes: list[str] = field(default_factory=list)
    """Sentences: what was compared, and how."""

    @property
    def late_s(self) -> float | None:
        """The same in seconds of the first's usual cycle."""
        return None if self.late is None else self.late * float(np.median(self.first.cycles.duration_s))


def compare_runs(first: Results, second: Results, *, in_time: bool = False, in_space: bool = False) -> Comparison:
    """Compare the usual cycle of two recordings at equal phases and equal arc lengths.

    Parameters
    ----------
    first, second : Results
        Of `analyse_run`.
    in_time : bool
        Whether the second is shifted to where it fits best.
    in_space : bool
        Whether it is turned and shifted as a whole to where it fits best.

    Raises
    ------
    TooFewMarkersError
        One has fewer than 4 markers.
    AnalysisError
        They have no stretch of cable, or no phase, in common.
    """
    _verify_markers(first, second)
    phase, arc = _phase_grid(first, second), _common_places(first, second)
    one, other = _draw_usual(first, phase, arc), _draw_usual(second, phase, arc)
    late, moved = None, None
    if in_time:
        late = align_in_time(one, other, repeats=_repeats(first) and _repeats(second), in_space=in_space)
        other = shift_motion(other, late, repeats=_repeats(first) and _repeats(second))
    if in_space:
        moved = align_in_space(one, other)
        other = moved.apply(other)
    difference = compare_motions(one, other, arc)
    notes = [
        _state_markers(first, second, arc),
        *_state_cycles(first, second, phase=phase),
        *_state_programs(first, second),
    ]
    if difference.compared < LOW_COMPARED:
        notes.append("Less than half of the motion could be compared: elsewhere the markers of one were not found.")
    return Comparison(first, second.run_path, phase, arc, one, other, difference, late, moved, notes)


def compare_with_shape(first: Results, shape: KnownShape) -> Comparison:
    """Compare the usual cycle of a recording with a known shape that stands still where it fits best.

    Raises
    ------
    TooFewMarkersError
        There are fewer than 4 markers.
    AnalysisError
        The shape is shorter than the cable between the markers.
    """
    _verify_markers(first)
    markers_s = first.marker_arc_length_m
    phase, arc = _phase_grid(first), _common_places(first)
    markers = _usual_markers(first, phase)
    seen = np.isfinite(markers).all(axis=2).any(axis=0)
    fit = fit_shape(np.nanmean(markers[:, seen], axis=0), markers_s[seen], shape)
    one = draw_motion(markers, markers_s, arc)
    still = fit.lab_from_shape.apply(shape.place(arc + fit.offset_m))
    other = np.broadcast_to(still, one.shape).copy()
    notes = [
        "The shape stands still where it fits the markers' mean places over the cycle best.",
        *_state_cycles(first, phase=phase),
    ]
    return Comparison(first, shape.name, phase, arc, one, other, compare_motions(one, other, arc), notes=notes)


def _verify_markers(*runs: Results) -> None:
    for results in runs:
        n_markers = len(results.marker_arc_length_m)
        if n_markers < FEWEST_MARKERS:
            raise TooFewMarkersError(
                f"{results.run_path} has {n_markers} markers; at least {FEWEST_MARKERS} are needed for its curve."
            )


def _phase_grid(*runs: Results) -> Floats:
    """Return phases no closer than the frames of a usual cycle."""
    usual = [int(np.median(results.cycles.n_frames)) if len(results.cycles.n_frames) else 1 for results in runs]
    n_phases = max(min(MOST_PHASES, *usual), 1)
    return (np.arange(n_phases) + 0.5) / n_phases


def _common_places(*runs: Results) -> Floats:
    low = max(float(results.marker_arc_length_m[0]) for results in runs)
    high = min(float(results.marker_arc_length_m[-1]) for results in runs)
    if low >= high:
        spans = " and ".join(
            f"{1e3 * results.marker_arc_length_m[0]:.0f} to {1e3 * results.marker_arc_length_m[-1]:.0f} mm"
            for results in runs
        )
        raise AnalysisError(
            f"The markers of the two have no stretch of cable in common: {spans} from the anchor.",
            hint="Arc lengths of both must count from the same place.",
        )
    return np.linspace(low, high, runs[0].config.analysis.arc_length_samples)


def _draw_usual(results: Results, phase: Floats, arc: Floats) -> Floats:
    return draw_motion(_usual_markers(results, phase), results.marker_arc_length_m, arc)


def _usual_markers(results: Results, phase: Floats) -> Floats:
    """Return the markers (P, k, 3) of the usual cycle."""
    frames, cycles = results.frames, results.cycles
    whole = cycles.cycle_index[np.isin(np.array(cycles.verdict, dtype=str), WHOLE_CYCLES)]
    cycle = np.where(np.isin(frames.cycle_index, whole), frames.cycle_index, -1) if len(whole) else frames.cycle_index
    trusted = frames.confidence >= TRUSTED_CONFIDENCE
    markers = median_cycle(frames.position_m, cycle, frames.cycle_phase, frames.time_ns, trusted, phase)
    if (np.isfinite(markers).all(axis=2).sum(axis=1) < FEWEST_MARKERS).all():
        raise AnalysisError(
            f"{results.run_path} shows at no phase of its cycles the {FEWEST_MARKERS} markers that a curve needs.",
            hint="`bench report` says what was seen.",
        )
    return markers


def _repeats(results: Results) -> bool:
    return not results.methods["cycles"].startswith("whole take")


def _state_markers(first: Results, second: Results, arc: Floats) -> str:
    counts = len(first.marker_arc_length_m), len(second.marker_arc_length_m)
    span = f"{1e3 * arc[0]:.0f} to {1e3 * arc[-1]:.0f} mm from the anchor"
    if np.array_equal(first.marker_arc_length_m, second.marker_arc_length_m):
        return f"Both have the same {counts[0]} markers. Compared: the curves through them, {span}."
    return (
        f"The first has {counts[0]} markers, the second {counts[1]}, at other places: compared are the curves through "
        f"them where both have one, {span}."
    )


def _state_cycles(*runs: Results, phase: Floats) -> list[str]:
    stated = [
        f"{results.run_path}: {_say_cycles(len(results.cycles.cycle_index))} at {len(phase)} phases "
        f"({results.methods['cycles']})."
        for results in runs
    ]
    if len({results.methods["cycles"].rpartition(", ")[2] for results in runs}) > 1:
        stated.append("Their phases are told by different means: equal phases may be different moments.")
    return stated


def _state_programs(first: Results, second: Results) -> list[str]:
    """Return a sentence where both recordings have a copy of their program, or both a hash that the controller told."""
    for key, describe in (("sha256", describe_program_file), ("loaded_sha256", describe_loaded_program)):
        hashes = {results.program_facts.get(key, "") for results in (first, second)}
        one, other = describe(first.program_facts), describe(second.program_facts)
        if "" not in hashes:
            same = f"The robot drove by the same program in both: {one}."
            return [same if len(hashes) == 1 else f"The robot drove by different programs: {one}; and {other}."]
    return []


def _say_cycles(n_cycles: int) -> str:
    return "its one cycle" if n_cycles == 1 else f"the median of its {n_cycles} cycles"
