"""One space: where the robot stands in the tracker's frame, from a body on its flange that both of them see."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from bench.analysis.arrays import Bools, Floats, Ints
from bench.analysis.calibration.correlation import correlation_length
from bench.analysis.calibration.hand_eye_start import start_from_body, start_from_marker
from bench.analysis.calibration.pose_track import PoseTrack
from bench.analysis.calibration.rigid import (
    REJECT_SIGMAS,
    RigidTransform,
    estimate_sigma,
    invert_information,
    lever,
    verify_told,
)
from bench.errors import AnalysisError

__all__ = ["FlangeSightings", "HandEye", "fit_hand_eye"]

FEWEST_POSES = 20
"""Thirteen unknowns, and some frames to tell whether they are right."""
LEAST_TRAVEL_M = 0.02
"""A body that keeps within 20 mm tells nothing of its frame's directions."""
MOST_FRAMES = 2_000
"""More are thinned out evenly: 0.2 mm of noise is 5 micrometres in the mean of 2 000."""
REJECT_ROUNDS = 4
MOST_STEPS = 20
DAMPING = 1e-6
NO_GAIN = 1e-9
HUBER = 2.0
"""Misfits beyond two standard deviations pull no harder than there, until those beyond 4.5 are left out."""
TIME_STEP_S = 1e-4
MOST_SIGMA_S = 0.002
"""At 1 m/s that is 2 mm."""
SMALLEST = 1e-12
MORE_AXES = (
    "Drive a calibration program that moves the flange by some 100 mm in three directions and turns it by 30 degrees "
    "or more about three axes."
)


@dataclass(frozen=True, eq=False)
class FlangeSightings:
    """What the tracker saw of a body, or of one marker, that is fixed to the robot's flange."""

    time_s: Floats
    """(n,): capture times, on the same scale as the robot's but for a constant."""
    position_m: Floats
    """(n, 3): lab frame; NaN where it was not tracked."""
    quaternion_xyzw: Floats | None = None
    """(n, 4): the body's orientation; None for a single marker."""

    def take(self, rows: Bools | Ints) -> FlangeSightings:
        """Return some of the sightings, or all in another order."""
        quaternion = None if self.quaternion_xyzw is None else self.quaternion_xyzw[rows]
        return FlangeSightings(self.time_s[rows], self.position_m[rows], quaternion)

    @property
    def is_known(self) -> Bools:
        """(n,): where it was tracked."""
        known = np.isfinite(self.position_m).all(axis=1)
        if self.quaternion_xyzw is not None:
            length = np.linalg.norm(self.quaternion_xyzw, axis=1)
            known = known & np.isfinite(length) & (length > 0)
        return np.asarray(known, dtype=bool)


@dataclass(frozen=True, eq=False)
class HandEye:
    """Robot and tracker in one space and one time."""

    lab_from_base: RigidTransform
    """Maps the robot's base frame into the lab frame."""
    tcp_from_body: RigidTransform
    """Maps the body's own frame into the TCP frame; of a single marker its shift alone."""
    offset_s: float
    """To be added to the tracker's times so that they agree with the robot's."""
    covariance: Floats
    """(13, 13): steps of `lab_from_base` (6), of `tcp_from_body` (6), and the offset; NaN for a marker's rotation."""
    residual_m: Floats
    """(n,): distance of each sighting from where the robot puts it; NaN where it was not compared."""
    residual_rad: Floats
    """(n,): angle between both orientations; NaN where there is none."""
    used: Bools
    """(n,): sightings that are no outliers."""
    correlation: float
    """How many neighbouring sightings err together: the covariance is that of so many times fewer sightings."""

    @property
    def sigma(self) -> Floats:
        """(13,): standard deviations, rad, m and s in the order of `covariance`."""
        return np.asarray(np.sqrt(np.diag(self.covariance)), dtype=np.float64)


def fit_hand_eye(
    track: PoseTrack, sightings: FlangeSightings, offset_s: float = 0.0, *, has_other_offset: bool = False
) -> HandEye:
    """Find lab frame, body and time offset at once from what the tracker saw of the flange.

    The pose that the tracker sees is ``lab_from_base * tcp_pose(t + offset) * tcp_from_body``. A start in closed
    form (rotations by singular values, shifts linearly, both against outliers), then least squares over all thirteen
    unknowns; sightings further away than 4.5 robust standard deviations are left out. Positions and angles are
    weighted by their own scatter. The covariance is that of the residuals as they are: where neighbouring ones err
    together, by the robot's own errors for instance, it is that of correspondingly fewer sightings.

    Parameters
    ----------
    track : PoseTrack
        The robot's TCP pose in the base frame.
    sightings : FlangeSightings
        A rigid body's poses, or the positions of a single marker.
    offset_s : float
        Start value of the offset, good to some 50 ms (`estimate_motion_offset`).
    has_other_offset : bool
        Whether the offset is known otherwise, so that a motion that does not tell it is no error.

    Raises
    ------
    AnalysisError
        Too few sightings, no motion, or one that turns about too few axes: each in one sentence with what to do.
    """
    rows = _choose_rows(track, sightings, offset_s)
    chosen = sightings.take(rows)
    problem = _Problem(track, chosen)
    turn, place = track.at(chosen.time_s + offset_s)
    if problem.turns is None:
        lab, body = start_from_marker(turn, place, chosen.position_m)
    else:
        lab, body = start_from_body(turn, place, problem.turns, chosen.position_m)
    state, used = problem.solve(_State(lab, body, offset_s))
    return _describe(problem, state, used, rows, len(sightings.time_s), has_other_offset=has_other_offset)


@dataclass(frozen=True, eq=False)
class _State:
    lab: RigidTransform
    body: RigidTransform
    offset_s: float

    def changed_by(self, step: Floats) -> _State:
        return _State(self.lab.changed_by(step[:6]), self.body.changed_by(step[6:12]), self.offset_s + step[12])


class _Problem:
    """The residuals of n sightings and how they change with the thirteen unknowns."""

    def __init__(self, track: PoseTrack, seen: FlangeSightings) -> None:
        self.track, self.seen = track, seen
        self.turns: Floats | None = None
        if seen.quaternion_xyzw is not None:
            self.turns = scipy.spatial.transform.Rotation.from_quat(seen.quaternion_xyzw).as_matrix()
        self.has_turns = self.turns is not None
        free = np.ones(13, dtype=bool)
        free[6:9] = self.has_turns
        self.free = np.flatnonzero(free)

    def misfits(self, state: _State) -> Floats:
        """Return (n, 3) or (n, 6): measured minus expected position (m), and rotation vector between both (rad)."""
        turn, place = self.track.at(self.seen.time_s + state.offset_s)
        expected = state.lab.apply(place + turn @ state.body.shift_m)
        apart = self.seen.position_m - expected
        if self.turns is None:
            return apart
        body = state.lab.rotation @ turn @ state.body.rotation
        between = scipy.spatial.transform.Rotation.from_matrix(np.swapaxes(body, 1, 2) @ self.turns).as_rotvec()
        return np.hstack([apart, between])

    def solve(self, state: _State) -> tuple[_State, Bools]:
        """Fit all unknowns by least squares, and leave out what does not fit."""
        used = self._fitting(state, np.ones(len(self.seen.time_s), dtype=bool))
        for _ in range(REJECT_ROUNDS):
            state = self._minimise(state, used)
            before, used = used, self._fitting(state, used)
            if np.array_equal(before, used):
                break
        return state, used

    def scales(self, misfit: Floats, used: Bools) -> Floats:
        """Return the robust standard deviation of each column."""
        parts = [misfit[used, i : i + 3] for i in range(0, misfit.shape[1], 3)]
        return np.repeat([estimate_sigma(np.linalg.norm(part, axis=1)) for part in parts], 3)

    def slopes(self, state: _State) -> Floats:
        """Return (n, 3 or 6, 13 or 10): how the misfits change with each unknown, to first order in small angles."""
        turn, place = self.track.at(self.seen.time_s + state.offset_s)
        reach = state.lab.turn(place + turn @ state.body.shift_m)
        slopes = np.zeros((len(place), 6 if self.has_turns else 3, 13))
        slopes[:, :3, :6] = -lever(reach)
        slopes[:, :3, 9:12] = -state.lab.rotation @ turn
        if self.has_turns:
            body = state.lab.rotation @ turn @ state.body.rotation
            slopes[:, 3:, :3] = -np.swapaxes(body, 1, 2)
            slopes[:, 3:, 6:9] = -state.body.rotation.T
        ahead, behind = (
            self.misfits(replace(state, offset_s=state.offset_s + dt)) for dt in (TIME_STEP_S, -TIME_STEP_S)
        )
        slopes[:, :, 12] = (ahead - behind) / (2 * TIME_STEP_S)
        return slopes[:, :, self.free]

    def _fitting(self, state: _State, known: Bools) -> Bools:
        misfit = self.misfits(state)
        sizes = np.linalg.norm((misfit / self.scales(misfit, known)).reshape(len(misfit), -1, 3), axis=2)
        return np.asarray((sizes <= REJECT_SIGMAS).all(axis=1))

    def _minimise(self, state: _State, used: Bools) -> _State:
        """Levenberg and Marquardt's steps with Huber's weights, from a start that is near."""
        scale = self.scales(self.misfits(state), used)
        damping, cost = DAMPING, self._cost(state, used, scale)
        for _ in range(MOST_STEPS):
            misfit = (self.misfits(state)[used] / scale).ravel()
            slopes = (self.slopes(state)[used] / scale[:, None]).reshape(-1, len(self.free))
            weighted = slopes * np.minimum(1.0, HUBER / np.maximum(np.abs(misfit), SMALLEST))[:, None]
            information = weighted.T @ slopes
            information[np.diag_indices_from(information)] *= 1.0 + damping
            step = invert_information(information) @ (weighted.T @ -misfit)
            moved = state.changed_by(self._full(step))
            moved_cost = self._cost(moved, used, scale)
            if moved_cost <= cost:
                gain, state, cost, damping = cost - moved_cost, moved, moved_cost, damping / 10
                if gain <= NO_GAIN * cost:
                    break
            else:
                damping *= 10
        return state

    def _cost(self, state: _State, used: Bools, scale: Floats) -> float:
        size = np.abs(self.misfits(state)[used] / scale)
        return float(np.where(size <= HUBER, size**2, 2 * HUBER * size - HUBER**2).sum())

    def _full(self, step: Floats) -> Floats:
        full = np.zeros(13)
        full[self.free] = step
        return full


def _choose_rows(track: PoseTrack, sightings: FlangeSightings, offset_s: float) -> Bools:
    """Return the sightings to compare, thinned out evenly where there are very many."""
    known = sightings.is_known
    chosen = known & track.covers(sightings.time_s + offset_s)
    index = np.flatnonzero(chosen)
    if len(index) < FEWEST_POSES:
        raise AnalysisError(
            f"The flange was tracked in {int(known.sum())} frames, {len(index)} of them while the robot told its TCP "
            f"pose; at least {FEWEST_POSES} are needed.",
            hint="See that the flange's markers stay in the cameras' common view, and record a calibration run again.",
        )
    travel = float(np.ptp(sightings.position_m[index], axis=0).max())
    if travel < LEAST_TRAVEL_M:
        raise AnalysisError(
            f"The flange moved by {travel * 1e3:.1f} mm; at least {LEAST_TRAVEL_M * 1e3:.0f} mm are needed.",
            hint=MORE_AXES,
        )
    rows = np.zeros(len(chosen), dtype=bool)
    rows[index[:: -(-len(index) // MOST_FRAMES)]] = True
    return rows


def _verify_offset(sigma_s: float) -> None:
    """Raise `AnalysisError` if the motion tells no time offset, as one of constant speed, or standing still, does."""
    if not sigma_s <= MOST_SIGMA_S:
        raise AnalysisError(
            f"The time offset cannot be told (standard deviation {sigma_s * 1e3:.2g} ms): the flange hardly moves.",
            hint=MORE_AXES,
        )


def _describe(
    problem: _Problem, state: _State, used: Bools, rows: Bools, n_rows: int, *, has_other_offset: bool
) -> HandEye:
    misfit = problem.misfits(state)
    scale = np.repeat([np.sqrt(np.mean(np.square(misfit[used, i : i + 3]))) for i in range(0, misfit.shape[1], 3)], 3)
    slopes = (problem.slopes(state)[used] / scale[:, None]).reshape(-1, len(problem.free))
    correlation = correlation_length(misfit[used])
    freedom = len(slopes) / max(len(slopes) - len(problem.free), 1)
    covariance = np.full((13, 13), np.nan)
    covariance[np.ix_(problem.free, problem.free)] = invert_information(slopes.T @ slopes) * correlation * freedom
    verify_told(covariance[:6, :6], "The robot's place in the lab frame", MORE_AXES)
    if not has_other_offset:
        _verify_offset(float(np.sqrt(covariance[12, 12])))
    length, angle = np.full(n_rows, np.nan), np.full(n_rows, np.nan)
    length[rows] = np.linalg.norm(misfit[:, :3], axis=1)
    if problem.has_turns:
        angle[rows] = np.linalg.norm(misfit[:, 3:], axis=1)
    kept = np.zeros(n_rows, dtype=bool)
    kept[rows] = used
    return HandEye(state.lab, state.body, state.offset_s, covariance, length, angle, kept, correlation)
