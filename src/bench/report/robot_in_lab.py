"""The robot's tool in the lab frame at each tracker frame, by the calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from bench.analysis import CableEnd, ClampDirection, PoseTrack, RigidTransform, exclude_near, place_end
from bench.config import Calibration, SpaceCalibration
from bench.errors import AnalysisError
from bench.report.markers import ChainStart
from bench.report.source import RobotSamples, TrackerFrames

__all__ = ["RobotInLab", "exclude_flange_marker", "find_robot", "seconds_since"]

Floats = npt.NDArray[np.float64]

SAME_TCP_M, SAME_TCP_RAD = 1e-4, 1e-3
"""A controller tells what was typed in, to single precision or better: more is another TCP."""


@dataclass(frozen=True, eq=False)
class RobotInLab:
    """TCP poses of F frames in the base frame, and how the base frame lies in the lab frame."""

    turn: Floats
    """(F, 3, 3)"""
    place_m: Floats
    """(F, 3): NaN where the robot told no pose."""
    space: SpaceCalibration
    tcp_offset: Floats
    """(6,): the TCP in the flange frame as it was set in this run; NaN where unknown."""

    def warn_of_tcp(self) -> list[str]:
        """Return a warning where another TCP was set than in the calibration."""
        apart = np.abs(self.tcp_offset - np.array(self.space.tcp_offset or [np.nan] * 6))
        if not (apart[:3].max() > SAME_TCP_M or apart[3:].max() > SAME_TCP_RAD):
            return []
        was, now = (
            ", ".join(f"{value * 1e3:.1f}" for value in offset[:3])
            for offset in (self.space.tcp_offset or (), self.tcp_offset)
        )
        text = (
            f"The TCP was set to ({now}) mm on the controller, and to ({was}) mm in the calibration: what it knows of "
        )
        return [f"{text}the TCP frame (clamp, marker on the flange) does not hold for this run."]

    def place(self, point_m: tuple[float, float, float], clamp: ClampDirection | None = None) -> CableEnd:
        """Place a point of the TCP frame, and a direction from it, in the lab frame of each frame."""
        space = self.space
        turn = Rotation.from_rotvec(space.lab_from_base_rotation_rad).as_matrix()
        lab = RigidTransform(turn, np.array(space.lab_from_base_shift_m))
        covariance = np.array(space.lab_from_base_covariance)
        return place_end(self.turn, self.place_m, np.array(point_m), clamp, lab, covariance)


def seconds_since(time_ns: npt.NDArray[np.int64], origin_ns: int) -> Floats:
    """Return times (n,) as seconds after an origin."""
    return np.asarray((time_ns - origin_ns) * 1e-9, dtype=np.float64)


def find_robot(frames: TrackerFrames, robot: RobotSamples | None, calibration: Calibration | None) -> RobotInLab | None:
    """Return where the robot is in each frame; None without a calibration, or a robot that tells its TCP pose."""
    if robot is None or calibration is None:
        return None
    origin_ns = int(robot.counter.host_ns[0])
    try:
        track = PoseTrack(seconds_since(robot.counter.host_ns, origin_ns), robot.tcp_pose)
    except AnalysisError:
        return None
    time_s = seconds_since(frames.time_ns, origin_ns)
    turn, place_m = track.at(time_s)
    place_m[~track.covers(time_s)] = np.nan
    return RobotInLab(turn, place_m, calibration.space, robot.tcp_offset)


def exclude_flange_marker(start: ChainStart, frames: TrackerFrames, robot: RobotInLab | None) -> None:
    """Take out the single marker on the flange that a calibration was made with: it is none of the cable's."""
    if robot is None or robot.space.method != "marker" or len(frames.points_m) == 0:
        return
    place_m = robot.place(robot.space.tcp_from_body_shift_m).position_m
    start.usable = exclude_near(frames.points_m, frames.offsets, start.usable, place_m)
