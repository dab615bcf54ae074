"""What the cameras saw of one cycle: how often each marker, where it was missing, how fast it went, where it sits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.analysis import (
    TRUSTED_CONFIDENCE,
    HiddenStretch,
    MarkerPlaces,
    PointFrames,
    fastest_speed,
    find_hidden_stretches,
    make_cycle_source,
    measure_marker_places,
    sort_automatically,
)
from bench.config import Config
from bench.errors import AnalysisError
from bench.recording import ROBOT, Run
from bench.report.cycles import PlacedFrames, place_frames
from bench.report.facts import count_driven
from bench.report.markers import find_chain_start, list_points, make_sort_settings
from bench.report.source import RobotSamples, TrackerFrames, load_topics, read_account, read_frames, read_robot

__all__ = ["SeenCycle", "see_first_cycle"]

Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]
Floats32 = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int64]

MISPLACED_SHARE = 0.15
"""Of the smallest spacing: markers that sit so far off are found all the same, for that is what is asked here."""
RIGHT_SHARE = 0.98
"""Of a marker's speeds in doubtful frames: on a real cable with ghosts every fiftieth point was a wrong one."""
FEWEST_FRAMES = 5
"""A marker that is missing for fewer frames flickers; occlusions last 5 to 50 frames in real recordings."""


@dataclass(frozen=True, eq=False)
class SeenCycle:
    """One cycle of F frames with k markers, as the cameras saw it."""

    cycle_index: int
    phase: Floats
    """(F,): place on the path."""
    rate_hz: float
    """Frames that arrived, a second."""
    position_m: Floats32
    """(F, k, 3): markers, NaN where not seen."""
    stretches: list[HiddenStretch]
    speed_m_s: float
    """Of the fastest marker, or of the TCP if that is faster, as driven; NaN where unknown."""
    speed_fraction: float
    """Where the speed slider stood; 1 where nothing tells."""
    places: MarkerPlaces | None
    places_problem: str
    """Why `places` is None."""

    @property
    def seen(self) -> Bools:
        """(F, k): whether each marker is seen."""
        return np.isfinite(self.position_m[:, :, 0])

    @property
    def full_speed_m_s(self) -> float:
        """`speed_m_s` with the slider at 100 %."""
        return self.speed_m_s / self.speed_fraction


def see_first_cycle(run: Run, config: Config) -> SeenCycle:
    """Look at the first completed cycle of a recording.

    Markers are sorted through time, so that a hidden marker does not count those beyond it as missing.

    Parameters
    ----------
    run : Run
        A recording, finished or not.
    config : Config
        Of the cable, the robot and the tracker.

    Raises
    ------
    AnalysisError
        No cycle was completed, it has no frames, or the anchor is not found.
    """
    load_topics(run)
    config = _widen_gates(config)
    robot = read_robot(run, make_cycle_source(config.robot.cycle) if config.robot else None)
    frames = read_frames(run, config.calibration.offset_s)
    placed = place_frames(frames, robot, config.analysis, read_account(run), count_driven(run, config))
    start = find_chain_start(run, frames, config, placed.table)
    row, rows = _find_first_cycle(run, frames, placed)
    cycle = list_points(frames, start, placed.row, placed.phase).take(rows)
    position, trusted = _sort(cycle, config)
    places, problem = _measure_places(position, trusted, cycle.anchor_m, config)
    table = placed.table
    return SeenCycle(
        cycle_index=int(table.cycle_index[row]),
        phase=placed.phase[rows],
        rate_hz=(len(rows) - 1) / ((cycle.time_ns[-1] - cycle.time_ns[0]) * 1e-9),
        position_m=position,
        stretches=find_hidden_stretches(position.astype(np.float64), cycle.anchor_m, trusted, FEWEST_FRAMES),
        speed_m_s=_find_speed(cycle, position, trusted, robot, int(table.start_ns[row]), int(table.end_ns[row])),
        speed_fraction=_read_speed_fraction(run, int(table.start_ns[row]), int(table.end_ns[row])),
        places=places,
        places_problem=problem,
    )


def _widen_gates(config: Config) -> Config:
    narrowest_mm = 1e3 * float(np.diff(config.cable.arc_length_m).min())
    tolerance_mm = max(config.analysis.gate_tolerance_mm, MISPLACED_SHARE * narrowest_mm)
    analysis = config.analysis.model_copy(update={"gate_tolerance_mm": tolerance_mm})
    return config.model_copy(update={"analysis": analysis})


def _find_first_cycle(run: Run, frames: TrackerFrames, placed: PlacedFrames) -> tuple[int, npt.NDArray[np.intp]]:
    """Return the cycle's row in the table, and its frames in order of time, each moment once."""
    completed = np.flatnonzero(placed.table.complete)
    if not len(completed):
        raise AnalysisError(
            f"{run.path} holds no completed cycle, so the optics cannot be judged by it.",
            hint="Let the robot drive one cycle: `bench check --cycle`.",
        )
    row = int(completed[0])
    rows = np.flatnonzero(placed.row == row)
    rows = rows[np.argsort(frames.time_ns[rows], kind="stable")]
    rows = rows[np.diff(frames.time_ns[rows], prepend=-1) > 0]
    if len(rows) < FEWEST_FRAMES:
        raise AnalysisError(
            f"Only {len(rows)} tracker frames were recorded in cycle {placed.table.cycle_index[row]}.",
            hint="Does the tracker stream all the time?",
        )
    return row, rows


def _sort(cycle: PointFrames, config: Config) -> tuple[Floats32, Bools]:
    """Return the markers' positions, and the frames in which all of them were found without doubt.

    Whatever the report sorts by, here by what suits a single cycle: the cameras are judged, and no sorter.
    """
    found = sort_automatically(cycle, make_sort_settings(config))
    trusted = np.asarray((found.confidence >= TRUSTED_CONFIDENCE) & (found.source >= 0).all(axis=1), dtype=bool)
    return found.position_m, trusted


def _measure_places(
    position_m: Floats32, trusted: Bools, anchor_m: Floats | None, config: Config
) -> tuple[MarkerPlaces | None, str]:
    try:
        return measure_marker_places(position_m, trusted, anchor_m, config.cable.arc_length_m[0]), ""
    except AnalysisError as error:
        return None, str(error)


def _find_speed(
    cycle: PointFrames, position_m: Floats32, trusted: Bools, robot: RobotSamples | None, start_ns: int, end_ns: int
) -> float:
    """Return the largest speed in frames without doubt, or nearly the largest in all: a label swap is no speed."""
    markers_m = position_m.astype(np.float64)
    speeds = [
        fastest_speed(cycle.time_ns, np.where(trusted[:, None, None], markers_m, np.nan)),
        fastest_speed(cycle.time_ns, markers_m, RIGHT_SHARE),
    ]
    if robot is not None:
        host_ns = robot.counter.host_ns
        inside = (host_ns >= start_ns) & (host_ns < end_ns)
        speeds.append(fastest_speed(host_ns[inside], robot.tcp_pose[inside, None, :3]))
    known = [speed for speed in speeds if np.isfinite(speed)]
    return max(known, default=float("nan"))


def _read_speed_fraction(run: Run, start_ns: int, end_ns: int) -> float:
    state = run[ROBOT]
    inside = (state.arrival_ns >= start_ns) & (state.arrival_ns < end_ns)
    known = state.speed_fraction[inside & (state.speed_fraction > 0)]
    return float(np.median(known)) if len(known) else 1.0
