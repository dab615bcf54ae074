"""From a run file to everything the report says: one pass through the analysis, no picture and no file."""

from __future__ import annotations

import json
import time
from pathlib import PurePath

import numpy as np
import numpy.typing as npt

from bench.analysis import TRUSTED_CONFIDENCE, average_by_phase, interpolate_curve, make_cycle_source
from bench.config import Config
from bench.model import Verdict
from bench.recording import FRAME, POINTS, ROBOT, Run
from bench.report.cycles import PlacedFrames, describe_cycles, place_frames
from bench.report.drift import find_drift
from bench.report.ends import find_cable_ends, find_up_axis, verify_end, warn_of_end_bend
from bench.report.facts import count_driven, find_versions, hash_config, read_run_end, state_facts
from bench.report.host_clock import warn_of_steps
from bench.report.markers import ChainStart, find_chain_start, list_points
from bench.report.outcome import UNFINISHED, find_attention, judge_run
from bench.report.results import ExampleFrame, FrameColumns, Results
from bench.report.robot_in_lab import exclude_flange_marker, find_robot
from bench.report.source import (
    CycleAccount,
    RobotSamples,
    TrackerFrames,
    load_topics,
    read_account,
    read_frames,
    read_noted,
    read_robot,
)
from bench.report.streams import find_streams
from bench.report.trace import TracedCable, trace_cable
from bench.report.wording import say_percent

__all__ = ["analyse_run"]

MOST_PHASE_BINS = 100
"""Bins of the bend-radius map: 20 ms of a 2 s cycle."""
FRAMES_PER_BIN = 2
"""Of each cycle, so that no bin stays empty when frames and cycles keep step: fewer bins for short cycles."""
LOW_COMPLETE_FRACTION = 0.9
"""Below this the reader is told: with nothing hidden a chain finds every marker."""

Floats = npt.NDArray[np.float64]


def analyse_run(run: Run, config: Config | None = None, *, run_path: str = "") -> Results:
    """Analyse a recording.

    Parameters
    ----------
    run : Run
        What `bench.recording.open_run` returns.
    config : Config, optional
        Replaces the configuration that travels in the file.
    run_path : str, optional
        Name of the run file, for the report's title; the run's own path where it is left out.

    Returns
    -------
    Results
        Everything the tables, the figures and the page are made from.

    Raises
    ------
    AnalysisError
        The anchor cannot be found, or the recording contradicts itself.
    """
    begin = time.perf_counter()
    config = config or run.config
    load_topics(run)
    source = make_cycle_source(config.robot.cycle) if config.robot else None
    frames, robot = read_frames(run, config.calibration.offset_s), read_robot(run, source)
    account = read_account(run)
    placed = place_frames(frames, robot, config.analysis, account, count_driven(run, config))
    start = find_chain_start(run, frames, config, placed.table)
    in_lab = find_robot(frames, robot, config.calibration.measured)
    exclude_flange_marker(start, frames, in_lab)
    ends = find_cable_ends(start, in_lab, config)
    end_facts = verify_end(ends, list_points(frames, start, placed.row, placed.phase), config)
    points, up_axis = list_points(frames, start, placed.row, placed.phase, ends.end), find_up_axis(run)
    traced = trace_cable(points, config, ends.clamps(config.cable.length_m, up_axis))
    cycles = describe_cycles(placed, traced)
    streams, end = find_streams(run, _count_gaps(frames, robot)), read_run_end(run)
    inside = traced.trusted & (placed.row >= 0)
    trusted_fraction = inside.sum() / max((placed.row >= 0).sum(), 1)
    limit_mm = config.cable.minimum_bend_radius_mm
    n_bins = _count_phase_bins(cycles.n_frames)
    curve = traced.curve.curvature_per_m, traced.curve.sigma_per_m
    bend_map = average_by_phase(*curve, placed.row, placed.phase, inside, n_bins).curvature_per_m
    outcome, outcome_reasons = judge_run(cycles, streams, end, limit_mm, trusted_fraction, bend_map)
    return Results(
        run_path=PurePath(run_path or run.path).name,
        config=config,
        config_sha256=hash_config(config),
        versions=find_versions(run),
        methods={"sorting": traced.markers.method, "curvature": traced.curve.method, "cycles": placed.method},
        exit_status=end.exit_status,
        exit_reason=end.reason,
        outcome=outcome,
        outcome_reasons=outcome_reasons,
        run_facts=state_facts(run, frames, cycles, config) | start.facts | end_facts,
        arc_length_m=traced.arc_length_m,
        marker_arc_length_m=traced.marker_arc_length_m,
        frames=_frame_columns(frames, placed, traced),
        cycles=cycles,
        phase_grid=(np.arange(n_bins) + 0.5) / n_bins,
        bend_map_per_m=bend_map,
        example=_choose_example(frames, start, placed, traced, bend_map, up_axis),
        streams=streams,
        clocks=[*(robot.clocks if robot else []), *frames.clocks],
        program_facts=run.metadata.get("bench.program", {}),
        attention=find_attention(cycles, placed.verdicts),
        noted=read_noted(run),
        warnings=[
            *start.warnings,
            *(in_lab.warn_of_tcp() if in_lab else []),
            *ends.warnings,
            *traced.markers.warnings,
            *traced.curve.warnings,
            *warn_of_end_bend(ends, traced, bend_map),
            *_warn_of_origin(account),
            *warn_of_steps(run),
            *_warn(run, frames, traced, end.exit_status),
        ],
        method_notes={
            "sorting": traced.markers.notes,
            "curvature": [*traced.curve.notes, *ends.describe_unused()],
        },
        ends=ends.columns(len(frames)),
        drift=find_drift(placed, traced, cycles, config.analysis.marker_noise_mm),
        analysis_s=time.perf_counter() - begin,
    )


def _count_phase_bins(n_frames: npt.NDArray[np.int64]) -> int:
    usual = int(np.median(n_frames)) if len(n_frames) else 0
    return min(max(usual // FRAMES_PER_BIN, 1), MOST_PHASE_BINS)


def _count_gaps(frames: TrackerFrames, robot: RobotSamples | None) -> dict[str, int]:
    gaps = {POINTS: frames.gaps.total, FRAME: frames.gaps.total}
    return gaps | ({ROBOT: robot.gaps.total} if robot else {})


def _frame_columns(frames: TrackerFrames, placed: PlacedFrames, traced: TracedCable) -> FrameColumns:
    return FrameColumns(
        frame_number=frames.frame_number,
        time_ns=frames.time_ns,
        cycle_index=placed.cycle_index,
        cycle_phase=placed.phase,
        source=traced.markers.source,
        position_m=traced.markers.position_m,
        confidence=traced.markers.confidence,
        marker_confidence=traced.markers.marker_confidence,
        reason=traced.markers.reason,
        curvature_per_m=traced.curve.curvature_per_m,
        sigma_per_m=traced.curve.sigma_per_m,
    )


def _choose_example(
    frames: TrackerFrames,
    start: ChainStart,
    placed: PlacedFrames,
    traced: TracedCable,
    bend_map: Floats,
    up_axis: int,
) -> ExampleFrame | None:
    """Choose a complete frame near the phase of the largest curvature, from the middle one of the good cycles."""
    candidates = np.flatnonzero(traced.complete & traced.trusted & (placed.row >= 0))
    if not len(candidates) or not np.isfinite(traced.curve.curvature_per_m[candidates]).any():
        return None
    peak = np.where(np.isfinite(bend_map), bend_map, -1.0).max(axis=1)
    wanted = (int(peak.argmax()) + 0.5) / len(peak)
    good = [verdict is Verdict.OK for verdict in placed.verdicts.verdict]
    rows = np.unique(placed.row[candidates])
    rows = rows[np.array(good)[rows]] if np.array(good)[rows].any() else rows
    nearest = candidates[placed.row[candidates] == rows[len(rows) // 2]]
    frame = int(nearest[np.abs(placed.phase[nearest] - wanted).argmin()])
    position = traced.markers.position_m[frame]
    return ExampleFrame(
        frame_number=int(frames.frame_number[frame]),
        cycle_index=int(placed.cycle_index[frame]),
        cycle_phase=float(placed.phase[frame]),
        points_m=frames.points_m[frames.offsets[frame] : frames.offsets[frame + 1]],
        position_m=position,
        anchor_m=np.full(3, np.nan) if start.anchor_m is None else np.asarray(start.anchor_m[frame]),
        curve_m=interpolate_curve(position, traced.marker_arc_length_m, traced.arc_length_m),
        curvature_per_m=traced.curve.curvature_per_m[frame],
        sigma_per_m=traced.curve.sigma_per_m[frame],
        up_axis=up_axis,
    )


def _warn_of_origin(account: CycleAccount) -> list[str]:
    if not account.resumed_from:
        return []
    text = (
        f"This run goes on with {account.resumed_from}, after {account.first_cycle_index} completed cycles; "
        "these are in the report of that file."
    )
    if account.n_unrecorded:
        n = account.n_unrecorded
        text += f" Of the last {n if n > 1 else 'one'} of them the recording was lost, for bench was killed."
    return [text]


def _warn(run: Run, frames: TrackerFrames, traced: TracedCable, exit_status: str) -> list[str]:
    warnings = [str(text) for text in json.loads(run.metadata.get("bench.import", {}).get("warnings", "[]"))]
    if exit_status == UNFINISHED:
        lost = f" Lost: {run.status.lost}." if run.status.lost else ""
        warnings.append(f"The recording was not finished.{lost}")
    elif run.status.lost:
        warnings.append(f"The recording is damaged; lost: {run.status.lost}.")
    if len(frames) == 0:
        return [*warnings, "The recording holds no tracker frames."]
    fraction = float(traced.complete.mean())
    if fraction == 0:
        warnings.append(
            "In no frame were all markers found: check marker_arc_length_m, the anchor and the gates. "
            "`bench check --recording` says which are missing where."
        )
    elif fraction < LOW_COMPLETE_FRACTION:
        warnings.append(
            f"All markers were found in {say_percent(fraction)} of the frames; in the others the curve is less certain "
            "beside a missing marker, and ends at the last one found. "
            "`bench check --recording` says which are missing where."
        )
    n_impossible = int(traced.impossible.sum())
    if n_impossible:
        warnings.append(
            f"{n_impossible} of {len(frames)} frames have a bend tighter than the cable's own radius or fold back, "
            "which cannot be: a marker is wrongly sorted in them. They do not enter the cycles' figures; others may be "
            "wrong unseen."
        )
    if traced.isolated.any():
        tightest = 1e3 / traced.isolated_bend_per_m
        warnings.append(
            f"{int(traced.isolated.sum())} of {len(frames)} frames have a bend that is gone a moment later, down to "
            f"{tightest:.1f} mm: a marker is wrongly sorted in them, or the cable jumped. "
            "They do not enter the cycles' figures."
        )
    doubtful = int((traced.complete & ~traced.trusted & ~traced.impossible & ~traced.isolated).sum())
    if doubtful:
        warnings.append(
            f"{doubtful} of {len(frames)} frames are complete but doubtful (confidence below {TRUSTED_CONFIDENCE}): "
            "they do not enter the cycles' figures."
        )
    return warnings
