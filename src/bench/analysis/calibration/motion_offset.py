"""One time: how far two clocks are apart, from a motion that both devices saw, whatever their frames of reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from bench.analysis.arrays import Bools, Floats, Ints
from bench.analysis.calibration.hand_eye import FlangeSightings
from bench.analysis.calibration.pose_track import PoseTrack
from bench.errors import AnalysisError

__all__ = ["MotionOffset", "estimate_motion_offset"]

LARGEST_OFFSET_S = 0.5
"""Both clocks are mapped to host time before: what is left are delays of milliseconds, in bad networks tens of them."""
STEP_S = 0.004
HALF_WINDOW_S = 0.03
"""Speeds are chords over 60 ms, of both devices alike: 0.2 mm of noise is then 5 mm/s, and bends of a path stay."""
MOST_SIGMA_S = 0.02
CLEAR_GAIN = 12.0
"""How much less likely another peak must be: e^-12, after neighbours that err together are counted once."""
BLOCK_S = 1.0
FEWEST_SPEEDS = 50
FASTEST_RATIO = 9.0
"""Of squared speeds: a point of the flange three times as fast as the TCP ever is was not the flange."""
REJECT_SIGMAS = 4.5
MEDIAN_TO_SIGMA = 1.4826
"""Standard deviation of normal numbers over the median of their magnitude."""
MOVE_UNEVENLY = "Record a run in which the flange starts, stops and changes its speed often, in no even rhythm."
TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class MotionOffset:
    """A constant between two clocks."""

    offset_s: float
    """To be added to the tracker's times so that they agree with the robot's."""
    sigma_s: float
    """Standard deviation, from the scatter of the speeds."""
    agreement: float
    """Correlation of both devices' speeds at this offset, 0…1."""


@dataclass(frozen=True, eq=False)
class _Chords:
    """Pairs of sightings of the flange."""

    first: Ints
    second: Ints
    middle_s: Floats
    span_s: Floats
    half_s: float
    """Half of their usual distance in time."""


@dataclass(frozen=True)
class _Candidate:
    offset: MotionOffset
    other_s: float
    """The offset of the next best peak; NaN where there is only one."""
    gain: float
    """How much less likely that is: difference of the logarithms."""


@dataclass(frozen=True, eq=False)
class _Speeds:
    """Chord speeds of both devices: those of the robot on a fine grid, to be read at any offset."""

    time_s: Floats
    seen: Floats
    grid_s: Floats
    driven: Floats

    def take(self, rows: Bools) -> _Speeds:
        """Return some of the seen speeds."""
        return _Speeds(self.time_s[rows], self.seen[rows], self.grid_s, self.driven)

    def misfit(self, offset_s: float) -> Floats:
        """Return what is left of the seen speeds (n,) after a straight line through the driven ones."""
        driven = np.interp(self.time_s + offset_s, self.grid_s, self.driven)
        driven = driven - driven.mean()
        seen = self.seen - self.seen.mean()
        gain = float(driven @ seen) / max(float(driven @ driven), TINY)
        return np.asarray(seen - max(gain, 0.0) * driven)

    def cost(self, offset_s: float) -> float:
        """Return the negative log-likelihood of an offset, with gain and noise at their best."""
        return 0.5 * len(self.time_s) * float(np.log(max(self.misfit(offset_s).var(), TINY)))

    def refine(self, offset_s: float) -> tuple[float, float]:
        """Return the least cost near an offset of the grid, and where it is."""
        bounds = (offset_s - 2 * STEP_S, offset_s + 2 * STEP_S)
        found = scipy.optimize.minimize_scalar(self.cost, bounds=bounds, method="bounded", options={"xatol": 1e-7})
        return float(found.fun), float(found.x)

    def sigma_s(self, offset_s: float) -> tuple[float, float]:
        """Return an offset's standard deviation, and how many speeds err together.

        From the scatter of the scores of stretches of a second, which neighbours that err together, or against each
        other as overlapping chords do, cannot deceive.
        """
        driven, ahead, behind = (
            np.interp(self.time_s + offset_s + shift, self.grid_s, self.driven) for shift in (0.0, STEP_S, -STEP_S)
        )
        known = np.stack([np.ones_like(driven), driven], axis=1)
        gain = np.linalg.lstsq(known, self.seen, rcond=None)[0][1]
        slope = gain * (ahead - behind) / (2 * STEP_S)
        slope = slope - known @ np.linalg.lstsq(known, slope, rcond=None)[0]
        information, misfit = float(slope @ slope), self.misfit(offset_s)
        block = ((self.time_s - self.time_s[0]) / BLOCK_S).astype(np.int64)
        scores = np.bincount(block, slope * misfit)
        sigma_s = np.sqrt(scores @ scores) / max(information, TINY)
        alone_s = misfit.std() / np.sqrt(max(information, TINY))
        return float(sigma_s), float(max(np.square(sigma_s / max(alone_s, TINY)), 1.0))


def estimate_motion_offset(track: PoseTrack, sightings: FlangeSightings) -> MotionOffset:
    """Estimate the constant offset between tracker and robot from the flange's speed.

    Speeds do not depend on the frame of reference, so this needs no calibration of space. The seen speed is a straight
    line over the driven one, with noise of unknown size; the offset makes this most likely, and its standard deviation
    is from the curvature of that likelihood, with speeds that err together counted once. Where the tracker gives
    orientations, the same is done with the angular speed, which all points of the flange share (a body beside the TCP
    is faster or slower than it while the flange turns), and the better told offset is taken.

    Parameters
    ----------
    track : PoseTrack
        The robot's TCP pose.
    sightings : FlangeSightings
        Of a body or marker on the flange.

    Raises
    ------
    AnalysisError
        The speed tells no offset (it is constant), or more than one (it repeats within half a second).
    """
    chords = _find_chords(track, sightings)
    parts = [_translation(track, sightings, chords)]
    if sightings.quaternion_xyzw is not None:
        parts.append(_rotation(track, sightings.quaternion_xyzw, chords))
    candidates = [_estimate(part) for part in parts]
    best = min(candidates, key=lambda candidate: candidate.offset.sigma_s)
    if not best.offset.sigma_s <= MOST_SIGMA_S:
        raise AnalysisError(
            "The time offset cannot be told: the flange's speed hardly changes "
            f"(standard deviation {best.offset.sigma_s * 1e3:.2g} ms, at most {MOST_SIGMA_S * 1e3:g} ms).",
            hint=MOVE_UNEVENLY,
        )
    if best.gain < CLEAR_GAIN:
        raise AnalysisError(
            f"The time offset cannot be told: {best.offset.offset_s * 1e3:.0f} ms and {best.other_s * 1e3:.0f} ms fit "
            "alike, for the flange's speed repeats itself.",
            hint=MOVE_UNEVENLY,
        )
    return best.offset


def _estimate(speeds: _Speeds) -> _Candidate:
    """Estimate by all speeds that can be, then again without those that do not fit."""
    speeds = speeds.take(speeds.seen <= FASTEST_RATIO * np.quantile(speeds.driven, 0.99))
    if len(speeds.time_s) < FEWEST_SPEEDS:
        return _Candidate(MotionOffset(0.0, np.inf, 0.0), 0.0, 0.0)
    misfit = np.abs(speeds.misfit(_find(speeds).offset.offset_s))
    return _find(speeds.take(misfit <= REJECT_SIGMAS * MEDIAN_TO_SIGMA * np.median(misfit)))


def _find(speeds: _Speeds) -> _Candidate:
    offsets = np.arange(-LARGEST_OFFSET_S, LARGEST_OFFSET_S + STEP_S / 2, STEP_S)
    cost = np.array([speeds.cost(offset) for offset in offsets])
    dips = np.flatnonzero((cost[1:-1] <= cost[:-2]) & (cost[1:-1] < cost[2:])) + 1
    dips = dips[np.argsort(cost[dips])][:2] if len(dips) else np.array([cost.argmin()])
    found = sorted(speeds.refine(float(offset)) for offset in offsets[dips])
    (least, offset_s), (next_cost, other_s) = found[0], found[1] if len(found) > 1 else (np.inf, np.nan)
    sigma_s, correlation = speeds.sigma_s(offset_s)
    unexplained = speeds.misfit(offset_s).var() / max(speeds.seen.var(), TINY)
    agreement = float(np.sqrt(max(1.0 - unexplained, 0.0)))
    return _Candidate(MotionOffset(offset_s, sigma_s, agreement), other_s, (next_cost - least) / correlation)


def _translation(track: PoseTrack, sightings: FlangeSightings, chords: _Chords) -> _Speeds:
    place, grid, half = sightings.position_m, _grid(track), chords.half_s
    seen = np.linalg.norm(place[chords.second] - place[chords.first], axis=1) / chords.span_s
    driven = np.linalg.norm(track.positions_at(grid + half) - track.positions_at(grid - half), axis=1) / (2 * half)
    return _Speeds(chords.middle_s, seen**2, grid, driven**2)


def _rotation(track: PoseTrack, quaternion_xyzw: Floats, chords: _Chords) -> _Speeds:
    grid, half = _grid(track), chords.half_s
    before, after = (
        scipy.spatial.transform.Rotation.from_quat(quaternion_xyzw[rows]) for rows in (chords.first, chords.second)
    )
    seen = (before.inv() * after).magnitude() / chords.span_s
    behind, ahead = (scipy.spatial.transform.Rotation.from_matrix(track.at(grid + sign * half)[0]) for sign in (-1, 1))
    driven = np.asarray((behind.inv() * ahead).magnitude() / (2 * half), dtype=np.float64)
    return _Speeds(chords.middle_s, seen**2, grid, driven**2)


def _find_chords(track: PoseTrack, sightings: FlangeSightings) -> _Chords:
    """Return pairs of sightings 60 ms apart, without a gap between; `AnalysisError` if there are too few."""
    known = np.flatnonzero(sightings.is_known)
    time_s = sightings.time_s[known]
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else HALF_WINDOW_S
    lag = max(round(2 * HALF_WINDOW_S / step), 1)
    span_s, middle_s = time_s[lag:] - time_s[:-lag], (time_s[lag:] + time_s[:-lag]) / 2
    even = np.abs(span_s - lag * step) < 0.25 * step
    for edge in (-LARGEST_OFFSET_S - HALF_WINDOW_S, LARGEST_OFFSET_S + HALF_WINDOW_S):
        even &= track.covers(middle_s + edge)
    if even.sum() < FEWEST_SPEEDS:
        raise AnalysisError(
            f"The flange's speed was seen at {int(even.sum())} moments while the robot told its pose; at least "
            f"{FEWEST_SPEEDS} are needed for a time offset.",
            hint="See that the flange's markers stay in the cameras' common view, and record the run again.",
        )
    return _Chords(known[:-lag][even], known[lag:][even], middle_s[even], span_s[even], lag * step / 2)


def _grid(track: PoseTrack) -> Floats:
    return np.arange(track.time_s[0], track.time_s[-1], min(track.usual_step_s, STEP_S))
