"""From a run in which both devices see the flange to one space, one time, and the markers' places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.analysis import (
    FlangeSightings,
    HandEye,
    MotionOffset,
    PoseTrack,
    PulseOffset,
    SwitchTimes,
    estimate_motion_offset,
    estimate_pulse_offset,
    fit_hand_eye,
    follow_marker,
    make_cycle_source,
    see_lamp,
)
from bench.config import (
    Calibration,
    CalibrationConfig,
    Config,
)
from bench.errors import AnalysisError, ConfigError
from bench.recording import Run
from bench.report.calibration.cable import SortedCable
from bench.report.calibration.file import describe_findings
from bench.report.markers import TrackedBodies
from bench.report.robot_in_lab import seconds_since
from bench.report.source import RobotSamples, TrackerFrames, load_topics, read_frames, read_robot

__all__ = ["CalibrationResults", "calibrate_run"]

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CalibrationResults:
    """What a calibration run tells."""

    calibration: Calibration
    """What the file holds."""
    hand_eye: HandEye
    motion_offset: MotionOffset | None
    """The offset by the flange's speed alone, which needs no space; None where the speed does not tell it."""
    pulse_offset: PulseOffset | None
    """The offset by the pulses of a sync lamp; None without one."""
    configured_m: Floats
    """(k,): the arc lengths of the configuration."""
    n_seen: int
    """Frames in which the body was tracked."""
    n_frames: int
    warnings: list[str]


def calibrate_run(run: Run, config: Config, flange_body: str = "") -> CalibrationResults:
    """Calibrate space, time and the markers' places from a recording.

    Parameters
    ----------
    run : Run
        A recording in which the robot tells its TCP pose and the tracker sees a body on the flange.
    config : Config
        Of the cable and the robot; a calibration in it is not used.
    flange_body : str
        The rigid body's name in the tracker's software; left out: the body or marker that the configuration names.

    Raises
    ------
    ConfigError
        Nothing on the flange is named.
    AnalysisError
        The body is not in the recording, or the motion does not tell what is wanted.
    """
    load_topics(run)
    source = make_cycle_source(config.robot.cycle) if config.robot else None
    frames, robot = read_frames(run), read_robot(run, source)
    if robot is None:
        raise AnalysisError(
            f"{run.path} holds no robot samples: there is nothing to calibrate the tracker against.",
            hint="Record a calibration run with `bench run`.",
        )
    origin_ns = int(robot.counter.host_ns[0])
    track = PoseTrack(seconds_since(robot.counter.host_ns, origin_ns), robot.tcp_pose)
    sightings = _sight_flange(run, frames, config.calibration, flange_body, origin_ns)
    order = np.argsort(sightings.time_s, kind="stable")
    by_speed = _offset_by_speed(track, sightings.take(order))
    by_pulses = _offset_by_pulses(frames, robot, config.calibration, origin_ns)
    start = by_pulses or by_speed
    offset_s = start.offset_s if start else 0.0
    found = fit_hand_eye(track, sightings.take(order), offset_s, has_other_offset=by_pulses is not None)
    warnings: list[str] = []
    cable = SortedCable.sort(run, frames, robot, config, sightings, warnings)
    places = cable.measure_places(config, warnings) if cable else None
    clamp = cable.find_clamp(config, found, track, sightings.time_s, warnings) if cable else None
    return CalibrationResults(
        calibration=describe_findings(run, robot.tcp_offset, found, by_pulses, places, clamp),
        hand_eye=found,
        motion_offset=by_speed,
        pulse_offset=by_pulses,
        configured_m=np.array(config.cable.arc_length_m),
        n_seen=int(sightings.is_known.sum()),
        n_frames=len(frames),
        warnings=warnings,
    )


def _sight_flange(
    run: Run, frames: TrackerFrames, named: CalibrationConfig, flange_body: str, origin_ns: int
) -> FlangeSightings:
    name, time_s = flange_body or named.flange_body, seconds_since(frames.time_ns, origin_ns)
    if name:
        bodies = TrackedBodies(run, frames)
        return FlangeSightings(time_s, *bodies.poses(bodies.id_of(name)))
    if named.flange_marker_m is not None:
        start_m = np.array(named.flange_marker_m)
        return FlangeSightings(time_s, follow_marker(frames.points_m, frames.offsets, time_s, start_m))
    raise ConfigError(
        "Nothing on the flange is named.",
        hint="Name its rigid body as [calibration] flange_body or with --flange-body, or give flange_marker_m.",
    )


def _offset_by_speed(track: PoseTrack, sightings: FlangeSightings) -> MotionOffset | None:
    """Return the offset that needs no space; where the speed does not tell it, the fit of space may yet do."""
    try:
        return estimate_motion_offset(track, sightings)
    except AnalysisError:
        return None


def _offset_by_pulses(
    frames: TrackerFrames, robot: RobotSamples, named: CalibrationConfig, origin_ns: int
) -> PulseOffset | None:
    if named.sync_output is None or named.sync_marker_m is None:
        return None
    lit = see_lamp(frames.points_m, frames.offsets, np.array(named.sync_marker_m))
    order = np.argsort(frames.time_ns, kind="stable")
    lamp = SwitchTimes.find(seconds_since(frames.time_ns, origin_ns)[order], lit[order])
    known = robot.digital_outputs >= 0
    is_on = (robot.digital_outputs[known] >> named.sync_output & 1) == 1
    output = SwitchTimes.find(seconds_since(robot.counter.host_ns[known], origin_ns), is_on)
    return estimate_pulse_offset(output, lamp)
