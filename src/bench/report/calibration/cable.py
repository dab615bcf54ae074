"""What a calibration run tells of the cable itself: the markers' places, and how the clamp at the TCP holds it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.analysis import (
    ClampDirection,
    FlangeSightings,
    HandEye,
    MarkerPlaces,
    PoseTrack,
    estimate_clamp_direction,
    exclude_near,
    measure_marker_places,
)
from bench.config import Config
from bench.errors import AnalysisError
from bench.recording import Run
from bench.report.cycles import place_frames
from bench.report.ends import AT_THE_TCP
from bench.report.facts import count_driven
from bench.report.markers import find_chain_start, list_points
from bench.report.source import RobotSamples, TrackerFrames, read_account
from bench.report.trace import trace_cable

__all__ = ["SortedCable"]

Floats = npt.NDArray[np.float64]

N_BESIDE_CLAMP = 3


@dataclass(frozen=True, eq=False)
class SortedCable:
    """The cable's markers in each of F frames, as far as they are sorted without doubt."""

    position_m: npt.NDArray[np.float32]
    usable: npt.NDArray[np.bool_]
    anchor_m: Floats | None

    @classmethod
    def sort(
        cls,
        run: Run,
        frames: TrackerFrames,
        robot: RobotSamples,
        config: Config,
        flange: FlangeSightings,
        warnings: list[str],
    ) -> SortedCable | None:
        """Sort the markers; None, with a warning, where that cannot be done: space and time need no cable."""
        try:
            placed = place_frames(frames, robot, config.analysis, read_account(run), count_driven(run, config))
            start = find_chain_start(run, frames, config, placed.table)
        except AnalysisError as error:
            warnings.append(f"The cable's markers were not looked at: {error}")
            return None
        warnings += start.warnings
        if flange.quaternion_xyzw is None:
            start.usable = exclude_near(frames.points_m, frames.offsets, start.usable, flange.position_m)
        traced = trace_cable(list_points(frames, start, placed.row, placed.phase), config)
        return cls(traced.markers.position_m, traced.complete & traced.trusted, start.anchor_m)

    def measure_places(self, config: Config, warnings: list[str]) -> MarkerPlaces | None:
        """Measure the markers' places; None, with a warning, where too few frames are sorted without doubt."""
        try:
            first_m = float(config.cable.arc_length_m[0])
            return measure_marker_places(self.position_m, self.usable, self.anchor_m, first_m)
        except AnalysisError as error:
            warnings.append(f"The markers' places were not measured: {error}")
            return None

    def find_clamp(
        self, config: Config, found: HandEye, track: PoseTrack, time_s: Floats, warnings: list[str]
    ) -> ClampDirection | None:
        """Return the direction of the clamp at the TCP, if that is where the cable ends."""
        end = config.cable.end
        if end is None or end.kind != "tcp" or self.position_m.shape[1] < N_BESIDE_CLAMP:
            return None
        rows = self.usable & track.covers(time_s + found.offset_s)
        turn, place = track.at(time_s[rows] + found.offset_s)
        lab, beside = found.lab_from_base, self.position_m[rows, : -N_BESIDE_CLAMP - 1 : -1].astype(np.float64)
        in_base = (beside - lab.shift_m) @ lab.rotation
        in_tcp = (in_base - place[:, None]) @ turn
        try:
            return estimate_clamp_direction(in_tcp - np.array(end.clamp_m or AT_THE_TCP))
        except AnalysisError as error:
            warnings.append(str(error))
            return None
