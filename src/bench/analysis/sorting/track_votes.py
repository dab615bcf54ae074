"""What single frames say about tracks: which frames to ask, and the votes that the chain search gives in them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bench.analysis.arrays import Floats, Ints
from bench.analysis.sorting.markers import SortedMarkers
from bench.analysis.sorting.point_tracks import PointTracks

__all__ = ["LONG_S", "TrackVotes", "choose_voting_rows", "collect_votes", "find_turn", "log_odds", "split_by_votes"]

LONG_S = 0.15
"""Three in four ghost markers live 4 frames: a track of 15 frames at 100 Hz is a marker's, or a reflection's."""
EVERY_S = 0.1
VOTES_PER_TRACK = 5
"""The chain search is wrong in 4 to 6 % of frames, often for many frames on end: five spread ones outvote that."""
HALF_VOTE = 0.5
"""Added to both sides, so that no vote is certain."""
CHANGED_VOTES = 2
"""So many votes more must agree with a track cut in two than with the whole: one wrong frame cuts nothing."""


@dataclass(frozen=True, eq=False)
class TrackVotes:
    """Votes of V points: those of all tracks that pass the frames asked."""

    point: Ints
    """(V,)"""
    marker: Ints
    """(V,): what the frame makes the point, -1 for no marker."""
    weight: Floats
    """(V,): how sure the frame is, 0…1."""

    def count(self, tracks: PointTracks, n_markers: int) -> tuple[Floats, Floats]:
        """Return the votes of each track for each marker (T, k), and all of its votes (T,)."""
        track, n_tracks = tracks.track[self.point], len(tracks)
        every = np.asarray(np.bincount(track, self.weight, n_tracks), dtype=np.float64)
        named = self.marker >= 0
        column = track[named] * n_markers + self.marker[named]
        votes = np.asarray(np.bincount(column, self.weight[named], n_tracks * n_markers), dtype=np.float64)
        return votes.reshape(n_tracks, n_markers), every


def log_odds(votes: Floats, every: Floats) -> Floats:
    """Return the log odds (T, k) of each track being each marker by its votes alone; 0 for a track without votes."""
    against = np.maximum(every[:, None] - votes, 0.0)
    return np.where(every[:, None] > 0, np.log((votes + HALF_VOTE) / (against + HALF_VOTE)), 0.0)


def choose_voting_rows(tracks: PointTracks) -> Ints:
    """Return the rows in which the chain search is asked: ten times a second, and five spread over each long track."""
    n_rows, time_s = len(tracks.time_s), tracks.time_s
    chosen = np.zeros(n_rows, dtype=bool)
    chosen[np.searchsorted(time_s, np.arange(EVERY_S / 2, time_s[-1], EVERY_S))] = True
    chosen[n_rows // 2] = True
    first, last = tracks.first, tracks.last
    long = np.flatnonzero(tracks.lasts_s >= LONG_S)
    for track in long[np.argsort(last[long], kind="stable")]:
        edges = np.linspace(first[track], last[track] + 1, VOTES_PER_TRACK + 1).astype(np.int64).tolist()
        for low, high in pairwise(edges):
            if not chosen[low:high].any():
                chosen[(low + high) // 2] = True
    return np.flatnonzero(chosen)


def collect_votes(tracks: PointTracks, rows: Ints, found: SortedMarkers) -> TrackVotes:
    """Return the votes of the points in `rows` (C,), as `found` has sorted them."""
    counts = np.diff(tracks.offsets)[rows]
    asked = np.repeat(np.arange(len(rows)), counts)
    point = np.repeat(tracks.offsets[rows] - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
    marker = np.full((len(rows), int(max(tracks.slot.max(initial=-1), found.source.max(initial=-1))) + 1), -1)
    row, column = np.nonzero(found.source >= 0)
    marker[row, found.source[row, column]] = column
    named = marker[asked, tracks.slot[point]]
    sure = found.marker_confidence[asked, np.maximum(named, 0)]
    return TrackVotes(point, named, np.where(named >= 0, sure, found.confidence[asked]).astype(np.float64))


def split_by_votes(tracks: PointTracks, votes: TrackVotes) -> PointTracks:
    """Cut the tracks whose votes change for good: two markers' points were joined.

    The cut is where the track turns most between the last vote for the one and the first for the other.
    """
    begins = np.zeros(len(tracks.points_m), dtype=bool)
    named = votes.marker >= 0
    point, marker = votes.point[named], votes.marker[named]
    order = np.lexsort((tracks.row[point], tracks.track[point]))
    point, marker = point[order], marker[order]
    edges = np.concatenate([[0], np.cumsum(np.bincount(tracks.track[point], minlength=len(tracks)))])
    changes = np.concatenate([[0], np.cumsum(marker[1:] != marker[:-1])])
    several = edges[1:] - edges[:-1] >= 2 * CHANGED_VOTES
    for track in np.flatnonzero(several).tolist():
        low, high = edges[track], edges[track + 1]
        if changes[high - 1] == changes[low]:
            continue
        at = _find_change(marker[low:high])
        if at:
            early, late = tracks.row[point[low + at - 1 : low + at + 1]]
            begins[find_turn(tracks, track, int(early), int(late))] = True
    return tracks.cut(begins)[0]


def _find_change(marker: Ints) -> int:
    """Return the index at which a sequence of votes changes for good, 0 if it does not."""
    agreed = [np.bincount(marker[:at]).max() + np.bincount(marker[at:]).max() for at in range(1, len(marker))]
    at = 1 + int(np.argmax(agreed))
    changes = np.bincount(marker[:at]).argmax() != np.bincount(marker[at:]).argmax()
    return at if changes and agreed[at - 1] >= np.bincount(marker).max() + CHANGED_VOTES else 0


def find_turn(tracks: PointTracks, track: int, early: int | None = None, late: int | None = None) -> int:
    """Return the point of a track at which its speed changes most, after row `early` and up to row `late`."""
    members = tracks.members[tracks.begins[track] : tracks.begins[track + 1]]
    rows = tracks.row[members]
    speed = np.diff(tracks.points_m[members], axis=0) / np.maximum(np.diff(tracks.time_s[rows]), 1e-9)[:, None]
    turn = np.zeros(len(members))
    turn[1:] += np.linalg.norm(np.diff(speed, axis=0, prepend=speed[:1]), axis=1)
    turn[1:-1] += np.linalg.norm(np.diff(speed, axis=0), axis=1)
    low = 1 if early is None else int(np.searchsorted(rows, early)) + 1
    high = len(rows) if late is None else int(np.searchsorted(rows, late)) + 1
    return int(members[low + turn[low:high].argmax()])
