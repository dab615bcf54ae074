"""Which track of points is which marker: by the votes for long tracks, by their fit for what is left."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy

from bench.analysis.arrays import Bools, Floats, Ints
from bench.analysis.sorting.gates import SortSettings
from bench.analysis.sorting.marker_fit import FREE_SHARE, WINDOW, MarkerFit, MarkerPlaces
from bench.analysis.sorting.marker_motion import REACH, MarkerMotion, learn_motion
from bench.analysis.sorting.point_tracks import PointTracks
from bench.analysis.sorting.track_votes import LONG_S, TrackVotes, find_turn, log_odds

__all__ = ["TrackLabels", "label_by_votes"]

PASSES = 4
LEARNING_PASSES = 2
"""The motion is learnt from the long tracks alone, then once more with all that fitted."""
MAJORITY = 0.5
FEWEST_VOTES = 1.5
ACCEPTED = 1.0
LEAD = 3.0
"""Log odds at which a track is taken for a marker's, and by which it must lead over others for the same place."""
MIXED = 3.0
FEW_POINTS = 3
"""Of points linked as they came up, some may be a marker's and others a ghost's: once one of them fits so well, two or
three are taken one by one, and longer tracks parted where they turn most."""
MOST_RIVALS = 3


@dataclass(eq=False)
class TrackLabels:
    """Which track is which marker, while it is being found out."""

    tracks: PointTracks
    votes: TrackVotes
    places: MarkerPlaces
    label: Ints
    """(T,): marker of each track, -1 without."""
    confidence: Floats
    """(T,): how sure the label is, 0…1."""
    by_fit: Bools
    """(T,): labeled because it fits, not by its votes."""
    refused: Ints = field(init=False)
    """(T,): marker that each track fits, but another one as well, or that another track fits; -1 without."""
    vote_odds: Floats = field(init=False)
    """(T, k): log odds of each track being each marker, by the votes alone."""
    broken: Bools = field(init=False)
    """(k, F): the point was taken away, for it breaks what the marker does before and after."""

    def __post_init__(self) -> None:
        self.refused = np.full(len(self.tracks), -1)
        self.broken = np.zeros(self.places.source.shape, dtype=bool)
        self.vote_odds = log_odds(*self.votes.count(self.tracks, len(self.places.source)))

    def complete(self, settings: SortSettings) -> None:
        """Label what fits, doubt what does not, and again; then take away what still does not."""
        motion = learn_motion(self.tracks, self.places.source, settings, is_alone=True)
        n_changed = self._improve(motion, doubts=False)
        for attempt in range(1, PASSES):
            if attempt < LEARNING_PASSES:
                motion = learn_motion(self.tracks, self.places.source, settings, is_alone=False)
            n_changed = self._improve(motion, doubts=attempt < PASSES - 1)
            if n_changed == 0:
                break
        self._take_away(motion)

    def _improve(self, motion: MarkerMotion, *, doubts: bool) -> int:
        """Label the tracks that fit, and unlabel those that do not; return how many."""
        n_points, source = len(self.tracks.points_m), self.places.source
        fits = np.full((len(self.tracks), len(source)), -np.inf)
        doubtful, jumps = np.zeros(source.shape, dtype=bool), np.zeros(source.shape)
        parted = np.zeros(n_points, dtype=bool)
        loose, mixed = np.zeros(len(self.tracks), dtype=bool), np.zeros(len(self.tracks), dtype=bool)
        is_free = np.ones(n_points, dtype=bool)
        is_free[source[source >= 0]] = False
        for marker in range(len(source)):
            fit = MarkerFit(self.tracks, self.places, motion, marker)
            free = fit.fit_free(is_free)
            possible, odds = (free.n_points > 0) & (self.label < 0), self.vote_odds[:, marker]
            accepted = possible & (free.bounded + odds > ACCEPTED)
            fits[accepted, marker] = (free.mean + odds)[accepted]
            mixed |= possible & ~accepted & (free.best > MIXED)
            if doubts:
                doubtful[marker], jumps[marker] = fit.find_doubtful()
                parted[source[marker, fit.find_steps()]] = True
                loose |= fit.find_loose(self.label, self.vote_odds)
        alone = np.zeros(n_points, dtype=bool)
        alone[source[_find_culprits(doubtful, jumps)]] = True
        n_changed = self._drop(loose) + self._take(fits)
        mixed &= self.label < 0
        few = np.diff(self.tracks.begins) <= FEW_POINTS
        alone |= (mixed & few)[self.tracks.track]
        parted[[find_turn(self.tracks, track) for track in np.flatnonzero(mixed & ~few).tolist()]] = True
        return n_changed + self._cut(alone, parted)

    def _take_away(self, motion: MarkerMotion) -> None:
        """Unlabel at last what breaks the motion before and after it."""
        source = self.places.source
        doubtful, jumps = np.zeros(source.shape, dtype=bool), np.zeros(source.shape)
        loose = np.zeros(len(self.tracks), dtype=bool)
        for marker in range(len(source)):
            fit = MarkerFit(self.tracks, self.places, motion, marker)
            loose |= fit.find_loose(self.label, self.vote_odds)
            doubtful[marker], jumps[marker] = fit.find_doubtful()
        self.broken = _find_culprits(doubtful, jumps)
        if loose.any():
            self.broken |= (source >= 0) & loose[self.tracks.track[source]]
        source[self.broken] = -1

    def _drop(self, dropped: Bools) -> int:
        tracks = np.flatnonzero(dropped & (self.label >= 0)).tolist()
        for track in tracks:
            self._unlabel(track)
        return len(tracks)

    def _unlabel(self, track: int) -> None:
        points = self.tracks.members[self.tracks.begins[track] : self.tracks.begins[track + 1]]
        row, own = self.tracks.row[points], self.places.source[self.label[track]]
        own[row[own[row] == points]] = -1
        self.label[track] = -1

    def _take(self, fits: Floats) -> int:
        """Label the tracks that fit a marker (T, k) better than any other, and better than any other track does."""
        best = fits.argmax(axis=1)
        odds = fits[np.arange(len(fits)), best]
        others = fits.copy()
        others[np.arange(len(fits)), best] = -np.inf
        fitting = odds > -np.inf
        alike = fitting & (others.max(axis=1, initial=-np.inf) > odds - LEAD)
        alike |= self._find_rivals(fitting, best, odds)
        self.refused = np.where(alike, best, -1)
        chosen = np.flatnonzero(fitting & ~alike)
        chosen = chosen[np.argsort(-odds[chosen], kind="stable")]
        labeled = chosen[self.give(chosen, best[chosen], FREE_SHARE)]
        self.label[labeled], self.by_fit[labeled] = best[labeled], True
        self.confidence[labeled] = 1.0 / (1.0 + np.exp(-odds[labeled]))
        return len(labeled)

    def give(self, chosen: Ints, marker: Ints, share: float) -> Bools:
        """Give the points of tracks to their markers, and to labeled tracks what others of the same marker had."""
        from bench.analysis.kernels.track_fits import label_tracks

        tracks, source = self.tracks, self.places.source
        taken = label_tracks(chosen, marker, tracks.begins, tracks.members, tracks.row, share, source)
        known = np.flatnonzero(self.label >= 0)
        known = known[np.argsort(-tracks.lasts_s[known], kind="stable")]
        label_tracks(known, self.label[known], tracks.begins, tracks.members, tracks.row, 0.0, source)
        return taken

    def _find_rivals(self, fitting: Bools, marker: Ints, odds: Floats) -> Bools:
        """Return the tracks (T,) that fit a marker at a time at which another one fits it nearly as well."""
        first, last = self.tracks.first, self.tracks.last
        rivals = np.zeros(len(fitting), dtype=bool)
        listed = np.flatnonzero(fitting)
        listed = listed[np.lexsort((first[listed], marker[listed]))]
        for step in range(1, MOST_RIVALS + 1):
            a, b = listed[:-step], listed[step:]
            alike = (marker[a] == marker[b]) & (first[b] <= last[a]) & (np.abs(odds[a] - odds[b]) < LEAD)
            rivals[a[alike]] = rivals[b[alike]] = True
        return rivals

    def _cut(self, doubtful: Bools, parted: Bools) -> int:
        """Make each doubtful point (N,) a track of its own, without a label, and ask what is left for its votes.

        Where points (N,) are apart from those before them the track is only parted, so that a ghost's share of it is
        judged by itself the next time.
        """
        if not (doubtful | parted).any():
            return 0
        self.tracks, parents = self.tracks.cut(doubtful | self.tracks.find_next(doubtful) | parted)
        self.label, self.confidence, self.by_fit = self.label[parents], self.confidence[parents], self.by_fit[parents]
        self.refused = self.refused[parents]
        votes, every = self.votes.count(self.tracks, len(self.places.source))
        self.vote_odds = log_odds(votes, every)
        own = votes[np.arange(len(parents)), np.maximum(self.label, 0)]
        outvoted = ~self.by_fit & (every > 0) & (own < MAJORITY * every)
        alone = doubtful[self.tracks.members[self.tracks.begins[:-1]]]
        self._drop((np.bincount(parents)[parents] > 1) & (alone | outvoted))
        return int(doubtful.sum())


def _find_culprits(doubtful: Bools, jumps: Floats) -> Bools:
    """Return the doubtful points (k, F) that jump farther than those of the markers whose motion follows theirs.

    A ghost makes the markers beside it doubtful too, for they seem not to move with it.
    """
    jumps = scipy.ndimage.maximum_filter1d(jumps, 2 * WINDOW + 1, axis=1)
    farthest = np.zeros_like(jumps)
    for step in range(1, REACH + 1):
        farthest[step:] = np.maximum(farthest[step:], jumps[:-step])
        farthest[:-step] = np.maximum(farthest[:-step], jumps[step:])
    return doubtful & (jumps >= farthest)


def label_by_votes(tracks: PointTracks, votes: TrackVotes, n_markers: int) -> TrackLabels:
    """Label long tracks by the majority of their votes; where two of one marker overlap, the one with more votes."""
    counted, every = votes.count(tracks, n_markers)
    label, most = counted.argmax(axis=1), counted.max(axis=1)
    chosen = np.flatnonzero((tracks.lasts_s >= LONG_S) & (most > MAJORITY * every) & (most >= FEWEST_VOTES))
    chosen = chosen[np.argsort(-most[chosen], kind="stable")]
    places = MarkerPlaces.unknown(np.full((n_markers, len(tracks.time_s)), -1))
    share = most / np.maximum(every, most + 1e-9)
    unlabeled, by_fit = np.full(len(tracks), -1), np.zeros(len(tracks), dtype=bool)
    labels = TrackLabels(tracks, votes, places, unlabeled, share, by_fit)
    taken = chosen[labels.give(chosen, label[chosen], FREE_SHARE)]
    labels.label[taken] = label[taken]
    return labels
