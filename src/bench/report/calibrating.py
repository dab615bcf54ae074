"""From a run in which both devices see the flange to one space, one time, and the markers' places."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import PurePath

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from bench.analysis import (
    ClampDirection,
    FlangeSightings,
    HandEye,
    MarkerPlaces,
    MotionOffset,
    PoseTrack,
    estimate_clamp_direction,
    estimate_motion_offset,
    fit_hand_eye,
    make_cycle_source,
    measure_marker_places,
)
from bench.config import Calibration, ClampCalibration, Config, SpaceCalibration, SpacingCalibration, TimeCalibration
from bench.errors import AnalysisError, ConfigError
from bench.recording import Run
from bench.report.cycles import place_frames
from bench.report.ends import seconds_since
from bench.report.facts import count_driven
from bench.report.markers import TrackedBodies, find_chain_start
from bench.report.source import RobotSamples, TrackerFrames, load_topics, read_account, read_frames, read_robot
from bench.report.trace import trace_cable

__all__ = ["CalibrationResults", "calibrate_run"]

N_BESIDE_CLAMP = 3

Floats = npt.NDArray[np.float64]
Triple = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]
SixBySix = tuple[Six, Six, Six, Six, Six, Six]


@dataclass(frozen=True, eq=False)
class CalibrationResults:
    """What a calibration run tells."""

    calibration: Calibration
    """What the file holds."""
    hand_eye: HandEye
    motion_offset: MotionOffset | None
    """The offset by the flange's speed alone, which needs no space; None where the speed does not tell it."""
    places: MarkerPlaces | None
    """None where the cable's markers could not be sorted."""
    configured_m: Floats
    """(k,): the arc lengths of the configuration."""
    n_seen: int
    """Frames in which the body was tracked."""
    n_frames: int
    warnings: list[str]


def calibrate_run(run: Run, config: Config, flange_body: str) -> CalibrationResults:
    """Calibrate space, time and the markers' places from a recording.

    Parameters
    ----------
    run : Run
        A recording in which the robot tells its TCP pose and the tracker sees a body on the flange.
    config : Config
        Of the cable and the robot; a calibration in it is not used.
    flange_body : str
        The rigid body's name in the tracker's software.

    Raises
    ------
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
    sightings = _sight_flange(run, frames, flange_body, origin_ns)
    by_speed = _offset_by_speed(track, sightings)
    found = fit_hand_eye(track, sightings, by_speed.offset_s if by_speed else 0.0)
    warnings: list[str] = []
    traced = _Traced.trace(run, frames, robot, config, warnings)
    places = traced.measure_places(config, warnings) if traced else None
    clamp = (
        traced.find_clamp(config, found, track, seconds_since(frames.time_ns, origin_ns), warnings) if traced else None
    )
    return CalibrationResults(
        calibration=_describe(run, found, places, clamp),
        hand_eye=found,
        motion_offset=by_speed,
        places=places,
        configured_m=np.array(config.cable.arc_length_m),
        n_seen=int(sightings.is_known.sum()),
        n_frames=len(frames),
        warnings=warnings,
    )


def _sight_flange(run: Run, frames: TrackerFrames, name: str, origin_ns: int) -> FlangeSightings:
    if not name:
        raise ConfigError(
            "No rigid body on the flange is named.",
            hint="Write its name as [calibration] flange_body, or give it with --flange-body.",
        )
    bodies = TrackedBodies(run, frames)
    position, quaternion = bodies.poses(bodies.id_of(name))
    order = np.argsort(frames.time_ns, kind="stable")
    return FlangeSightings(seconds_since(frames.time_ns[order], origin_ns), position[order], quaternion[order])


def _offset_by_speed(track: PoseTrack, sightings: FlangeSightings) -> MotionOffset | None:
    """Return the offset that needs no space; where the speed does not tell it, the fit of space may yet do."""
    try:
        return estimate_motion_offset(track, sightings)
    except AnalysisError:
        return None


@dataclass(frozen=True, eq=False)
class _Traced:
    """The cable's markers in each of F frames, as far as they are sorted without doubt."""

    position_m: npt.NDArray[np.float32]
    usable: npt.NDArray[np.bool_]
    anchor_m: Floats | None

    @classmethod
    def trace(
        cls, run: Run, frames: TrackerFrames, robot: RobotSamples, config: Config, warnings: list[str]
    ) -> _Traced | None:
        """Sort the markers; None, with a warning, where that cannot be done: space and time need no cable."""
        try:
            placed = place_frames(frames, robot, config.analysis, read_account(run), count_driven(run, config))
            start = find_chain_start(run, frames, config, placed.table)
        except AnalysisError as error:
            warnings.append(f"The cable's markers were not looked at: {error}")
            return None
        warnings += start.warnings
        traced = trace_cable(frames, start, config)
        return cls(traced.markers.position_m, traced.complete & traced.trusted, start.anchor_m)

    def measure_places(self, config: Config, warnings: list[str]) -> MarkerPlaces | None:
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
            return estimate_clamp_direction(in_tcp - np.array(end.clamp_m))
        except AnalysisError as error:
            warnings.append(str(error))
            return None


def _describe(run: Run, found: HandEye, places: MarkerPlaces | None, clamp: ClampDirection | None) -> Calibration:
    return Calibration(
        run_file=PurePath(run.path).name,
        run_id=run.run_id,
        created_utc=datetime.now(tz=UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        bench_version=version("cable-bench"),
        time=TimeCalibration(offset_ms=found.offset_s * 1e3, offset_sd_ms=float(found.sigma[12]) * 1e3),
        space=_describe_space(found),
        spacing=_describe_places(places) if places else None,
        clamp=_describe_clamp(clamp) if clamp else None,
    )


def _describe_places(places: MarkerPlaces) -> SpacingCalibration:
    return SpacingCalibration(
        marker_arc_length_m=tuple(np.round(places.arc_length_m, 6).tolist()),
        sd_mm=tuple(np.round(places.sigma_m * 1e3, 4).tolist()),
    )


def _describe_clamp(clamp: ClampDirection) -> ClampCalibration:
    return ClampCalibration(direction=_triple(clamp.direction), direction_sd_deg=float(np.rad2deg(clamp.sigma_rad)))


def _describe_space(found: HandEye) -> SpaceCalibration:
    used = found.residual_m[found.used]
    has_body = bool(np.isfinite(found.sigma[6:9]).all())
    lab, body = found.lab_from_base, found.tcp_from_body
    return SpaceCalibration(
        method="rigid body" if has_body else "marker",
        lab_from_base_rotation_rad=_triple(Rotation.from_matrix(lab.rotation).as_rotvec()),
        lab_from_base_shift_m=_triple(lab.shift_m),
        lab_from_base_covariance=_matrix(found.covariance[:6, :6]),
        tcp_from_body_rotation_rad=_triple(Rotation.from_matrix(body.rotation).as_rotvec()) if has_body else None,
        tcp_from_body_shift_m=_triple(body.shift_m),
        tcp_from_body_sd_mm=_triple(found.sigma[9:12] * 1e3),
        residual_rms_mm=float(np.sqrt(np.mean(used**2))) * 1e3,
        residual_max_mm=float(used.max()) * 1e3,
        n_frames=int(np.isfinite(found.residual_m).sum()),
        n_outliers=int(np.isfinite(found.residual_m).sum() - found.used.sum()),
    )


def _triple(values: Floats) -> Triple:
    x, y, z = values.tolist()
    return x, y, z


def _matrix(values: Floats) -> SixBySix:
    a, b, c, d, e, f = (_six(row) for row in values)
    return a, b, c, d, e, f


def _six(values: Floats) -> Six:
    a, b, c, d, e, f = values.tolist()
    return a, b, c, d, e, f
