"""The tracker's frames in the robot's cycles, and one row of figures for each cycle."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from bench.analysis import (
    CycleTable,
    CycleVerdicts,
    find_cycles,
    find_repeated_cycles,
    judge_cycles,
    phase_from_path,
    phase_from_register,
    phase_from_time,
    refine_starts,
    summarise_cycles,
    whole_take,
)
from bench.config import AnalysisConfig
from bench.report.results import CycleColumns
from bench.report.source import CycleAccount, RobotSamples, TrackerFrames
from bench.report.trace import TracedCable

__all__ = ["PlacedFrames", "describe_cycles", "place_frames"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


WHOLE = "whole take"


@dataclass(frozen=True, eq=False)
class PlacedFrames:
    """Each of F frames in its cycle."""

    table: CycleTable
    refined: npt.NDArray[np.bool_]
    """(C,): whether a cycle's start is that of the joints' motion."""
    verdicts: CycleVerdicts
    row: Ints
    """(F,): row of the cycle in `table`, -1 outside any."""
    cycle_index: Ints
    """(F,): -1 outside any cycle."""
    phase: Floats
    """(F,): NaN outside any cycle."""
    method: str


def place_frames(
    frames: TrackerFrames,
    robot: RobotSamples | None,
    config: AnalysisConfig,
    account: CycleAccount,
    n_driven: int | None = None,
) -> PlacedFrames:
    """Find the cycles, judge them, and say of every frame in which cycle and where in it it was taken.

    As the robot shows them; without a robot, as the motion repeats. Where it does not, or if so configured, the whole
    recording is cycle 0.

    Parameters
    ----------
    frames : TrackerFrames
    robot : RobotSamples or None
    config : AnalysisConfig
    account : CycleAccount
    n_driven : int, optional
        Cycles of the run; what a program that waits for no grant began after them is none of it.
    """
    shown = None if config.cycles == "whole" else robot
    if robot is None and config.cycles == "auto":
        table, method = _find_repeated(frames)
        refined = np.zeros(len(table.cycle_index), dtype=bool)
    else:
        table, refined, method = _find_table(frames, shown, account, n_driven)
    row = table.locate(frames.time_ns)
    phase, how = _find_phase(table, shown, row, frames.time_ns)
    index = np.full(len(row), -1, dtype=np.int64)
    index[row >= 0] = table.cycle_index[row[row >= 0]]
    robot_gaps = robot.gaps if robot else None
    verdicts = judge_cycles(
        table,
        np.sort(frames.time_ns),
        frames.gaps,
        robot_gaps,
        config.slow_cycle_ratio,
        account.interrupted,
        account.slowed,
    )
    return PlacedFrames(table, refined, verdicts, row, index, phase, f"{method}, {how}")


def _find_repeated(frames: TrackerFrames) -> tuple[CycleTable, str]:
    """Return the cycles of a take, and what showed them: the whole of it is one where no motion repeats."""
    in_order = bool((np.diff(frames.time_ns) > 0).all())
    table = find_repeated_cycles(frames.points_m, frames.offsets, frames.time_ns) if in_order else None
    return (_whole_recording(frames), WHOLE) if table is None else (table, "motion that repeats")


def _find_table(
    frames: TrackerFrames, robot: RobotSamples | None, account: CycleAccount, n_driven: int | None
) -> tuple[CycleTable, npt.NDArray[np.bool_], str]:
    """Return the cycles, whether each start is that of the joints' motion, and what showed them."""
    if robot is None:
        table, method = _whole_recording(frames), WHOLE
        refined = np.zeros(len(table.cycle_index), dtype=bool)
    else:
        table = find_cycles(robot.counter)
        if n_driven is not None:
            table = table.take(table.cycle_index + account.first_cycle_index < n_driven)
        table, refined = refine_starts(table, robot.counter.host_ns, robot.speed_rad_s)
        method = robot.source.name if robot.source else "robot's counter"
    return replace(table, cycle_index=table.cycle_index + account.first_cycle_index), refined, method


def _find_phase(table: CycleTable, robot: RobotSamples | None, row: Ints, time_ns: Ints) -> tuple[Floats, str]:
    """Return the phase of each frame (F,) by the best that is known, and by what: register, then path, then time."""
    by_time = phase_from_time(table, row, time_ns)
    if robot is None:
        return by_time, "phase by time"
    phase = phase_from_register(table, robot.counter, row, time_ns)
    if phase is not None:
        return phase, "phase by the robot's register"
    phase = phase_from_path(table, robot.travel, row, time_ns) if robot.travel else None
    if phase is None:
        return by_time, "phase by time"
    elsewhere = np.unique(row[(row >= 0) & np.isnan(phase)])
    by_path = "phase by the robot's path"
    if len(elsewhere):
        by_path += f" ({len(elsewhere)} of {len(table.cycle_index)} cycles by time: they took another path)"
    return np.where(np.isnan(phase), by_time, phase), by_path


def describe_cycles(placed: PlacedFrames, traced: TracedCable) -> CycleColumns:
    """Return one row of figures for each cycle."""
    table = placed.table
    bends = summarise_cycles(
        placed.row,
        len(table.cycle_index),
        traced.complete,
        traced.trusted,
        traced.curve.curvature_per_m,
        traced.curve.sigma_per_m,
        traced.arc_length_m,
    )
    with np.errstate(divide="ignore"):
        radius_mm = 1e3 / bends.max_curvature_per_m
    return CycleColumns(
        cycle_index=table.cycle_index,
        start_ns=table.start_ns,
        start_from=["motion" if is_refined else "signal" for is_refined in placed.refined],
        end_ns=table.end_ns,
        duration_s=table.duration_s,
        n_frames=bends.n_frames,
        verdict=[str(verdict) for verdict in placed.verdicts.verdict],
        complete_fraction=bends.complete_fraction,
        max_curvature_per_m=bends.max_curvature_per_m,
        max_curvature_sigma_per_m=bends.max_curvature_sigma_per_m,
        max_curvature_arc_length_m=bends.max_curvature_arc_length_m,
        min_bend_radius_mm=radius_mm,
        mean_curvature_per_m=bends.mean_curvature_per_m,
    )


def _whole_recording(frames: TrackerFrames) -> CycleTable:
    if len(frames) == 0:
        table = whole_take(0, 0)
        return CycleTable(*(getattr(table, name)[:0] for name in table.__dataclass_fields__))
    return whole_take(int(frames.time_ns.min()), int(frames.time_ns.max()))
