"""How well points fit one marker, given where it and the markers beside it are before and after."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from bench.analysis.arrays import Bools, Floats, Ints
from bench.analysis.sorting.marker_motion import MarkerMotion
from bench.analysis.sorting.point_tracks import PointTracks
from bench.analysis.sorting.track_votes import LONG_S

__all__ = ["FREE_SHARE", "WINDOW", "FreeFit", "MarkerFit", "MarkerPlaces"]

FREE_SHARE = 0.5
"""Of a track's frames: in the others the marker has another point, as where a track begins beside its own end."""
WINDOW = 2
"""Rows before and after a point that are left out with it: half of the ghosts live four frames."""
JUMP_SIGMAS = 4.0
"""A point farther off the line of its neighbours in time is looked at more closely: of normal noise 1 in 900."""
STEP_SIGMAS = 6.0
"""Of normal noise 1 in ten million steps is larger, and parting a track there costs nothing."""
JOINED_ODDS = 4.4
"""The logarithm of 80, for each end of a short track at which the marker is seen in the very next row: a marker is
hidden in one row of twenty, and of ghosts that live four frames one in four comes in just that row."""
DOUBTED = -1.0
"""Log odds of a labeled point at which it is taken away: it was the only one there, which speaks for it."""


@dataclass(eq=False)
class MarkerPlaces:
    """Where k markers are in F rows, seen or not."""

    source: Ints
    """(k, F): point of each marker, -1 without."""
    place_m: Floats
    """(k, F, 3)"""
    variance_m2: Floats
    """(k, F): of each axis; very large where nothing is known yet."""

    @classmethod
    def unknown(cls, source: Ints) -> MarkerPlaces:
        """Return markers of which nothing but the points is known."""
        return cls(source, np.zeros((*source.shape, 3)), np.full(source.shape, 1e6))


@dataclass(frozen=True, eq=False)
class FreeFit:
    """How well the T tracks without a label fit a hidden marker."""

    mean: Floats
    """(T,): log odds against a ghost, the mean over the track's points."""
    bounded: Floats
    """(T,): the same where a point that fits very well counts no more than one that fits well."""
    best: Floats
    """(T,): of the point that fits best."""
    n_points: Ints
    """(T,): points in rows in which the marker is hidden; 0 where it is seen all along."""


class MarkerFit:
    """One marker: its motion before and after every row, and how well points fit between.

    Making it also brings `places` up to date for the marker, so that those beside it find it there.

    Parameters
    ----------
    tracks : PointTracks
    places : MarkerPlaces
    motion : MarkerMotion
    marker : int
    """

    def __init__(self, tracks: PointTracks, places: MarkerPlaces, motion: MarkerMotion, marker: int) -> None:
        from bench.analysis.kernels import motion_bridges, track_fits

        self._tracks, self._places, self._motion, self._marker = tracks, places, motion, marker
        self._own = places.source[marker]
        self._jolt, self._noise = float(motion.jolt_m2_s3[marker]), float(motion.noise_m2[marker])
        self._base, self._spread, self._apart = track_fits.follow_neighbours(
            tracks.points_m, places.source, places.place_m, places.variance_m2, motion.weight[marker], marker
        )
        self._variance, seen = self._spread + self._noise, self._own >= 0
        self._before, self._after = motion_bridges.find_neighbours_in_time(seen)
        self._onward, self._back = (
            motion_bridges.filter_motion(
                self._apart,
                self._variance,
                seen,
                tracks.time_s,
                self._jolt,
                float(motion.speed_m2_s2[marker]),
                is_onward,
            )
            for is_onward in (True, False)
        )
        track_fits.estimate_places(
            tracks.points_m,
            places.source,
            marker,
            *self._bridge(),
            self._base,
            self._spread,
            self._noise,
            places.place_m[marker],
            places.variance_m2[marker],
        )

    def _bridge(self) -> tuple[Floats, Floats, Ints, Ints, Floats, float]:
        return self._onward, self._back, self._before, self._after, self._tracks.time_s, self._jolt

    def _bounds(self) -> tuple[float, Floats, Floats, Floats]:
        motion = self._motion
        return motion.log_clutter, motion.chord_rate_m2_s, motion.chord_noise_m2, motion.longest_m

    def fit_free(self, is_free: Bools) -> FreeFit:
        """Return how well tracks fit whose points (N,) are free, where the marker is hidden."""
        from bench.analysis.kernels.track_fits import fit_free_tracks

        tracks, places = self._tracks, self._places
        total, bounded, best, count = fit_free_tracks(
            tracks.points_m,
            tracks.offsets,
            tracks.track,
            is_free,
            places.source,
            self._marker,
            self._before,
            self._after,
            tracks.time_s,
            places.place_m[self._marker],
            places.variance_m2[self._marker],
            self._noise,
            *self._bounds(),
            len(tracks),
        )
        count[count < FREE_SHARE * np.diff(tracks.begins)] = 0
        number = np.maximum(count, 1)
        return FreeFit(total / number, bounded / number, best, count)

    def find_doubtful(self) -> tuple[Bools, Floats]:
        """Return the rows (F,) whose point does not fit between those before and after it, and how far it jumps (F,).

        The jump is in squares of standard deviations.
        """
        from bench.analysis.kernels.track_fits import measure_jumps

        rows, time_s = np.arange(len(self._own)), self._tracks.time_s
        jumps = measure_jumps(
            self._apart, self._before, self._after, self._own >= 0, time_s, self._variance, self._jolt
        )
        close = scipy.ndimage.maximum_filter1d(jumps, 2 * WINDOW + 1) > JUMP_SIGMAS**2
        first, last = np.maximum(rows - WINDOW, 0), np.minimum(rows + WINDOW, len(rows) - 1)
        scores = self._fit_own(np.where(close, first, -1), last)
        return scores < DOUBTED, jumps

    def find_steps(self) -> Bools:
        """Return the rows (F,) whose point is apart from the one before it, by the motion up to that and from here."""
        from bench.analysis.kernels.motion_bridges import measure_steps

        steps = measure_steps(
            self._onward,
            self._back,
            self._apart,
            self._variance,
            self._before,
            self._own >= 0,
            self._tracks.time_s,
            self._jolt,
        )
        return np.asarray(steps > STEP_SIGMAS**2)

    def find_loose(self, label: Ints, vote_odds: Floats) -> Bools:
        """Return the marker's short tracks (T,) that do not fit what it does before and after them.

        Parameters
        ----------
        label : (T,)
            Marker of each track.
        vote_odds : (T, k)
            What the votes add.
        """
        tracks = self._tracks
        short = (label == self._marker) & (tracks.lasts_s < LONG_S)
        track = np.where(self._own >= 0, tracks.track[self._own], -1)
        asked = np.flatnonzero((track >= 0) & short[track])
        first, last = np.full(len(track), -1), np.full(len(track), -1)
        first[asked], last[asked] = tracks.first[track[asked]], tracks.last[track[asked]]
        scores = self._fit_own(first, last)[asked]
        count = np.bincount(track[asked], minlength=len(tracks))
        odds = np.bincount(track[asked], scores, len(tracks)) / np.maximum(count, 1) + vote_odds[:, self._marker]
        seen = np.concatenate([[False], self._own >= 0, [False]])
        n_joined = seen[tracks.first].astype(np.int64) + seen[tracks.last + 2]
        return np.asarray((count > 0) & (odds + JOINED_ODDS * n_joined < DOUBTED))

    def _fit_own(self, first: Ints, last: Ints) -> Floats:
        from bench.analysis.kernels.track_fits import fit_labeled

        return fit_labeled(
            self._tracks.points_m,
            self._places.source,
            self._marker,
            first,
            last,
            *self._bridge(),
            self._base,
            self._spread,
            self._noise,
            *self._bounds(),
        )
