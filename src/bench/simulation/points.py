"""The points of a tracker's frame: their numbers, flags and order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from bench.model import UNLABELED
from bench.simulation.bodies import BODY_SIZE

__all__ = ["LABELED_FLAGS", "OCCLUDED", "Points"]

OCCLUDED = 0x01
POINT_CLOUD_SOLVED = 0x02
HAS_MODEL = 0x08
UNLABELED_FLAGS = UNLABELED | POINT_CLOUD_SOLVED
LABELED_FLAGS = HAS_MODEL | POINT_CLOUD_SOLVED
"""NatNet marker parameters as real packets have them: 18 and 10, and 11 where a body's marker is hidden."""
FIRST_LOOSE_ID = 50_001
"""Motive numbers unlabeled points from about here; a real recording has 50007."""
BODY_IDS_BEGIN, BODY_IDS_END = 1 << 16, 1 << 20
"""Between them are the numbers of the bodies' markers, which no loose point gets."""
MARKER_SIZE_M = (0.008, 0.011)
RESIDUAL_M = (0.00022, 0.00069)
"""Range of the residual field in a real recording, steady for each marker."""

Indices = npt.NDArray[np.intp]
Bools = npt.NDArray[np.bool_]


class Points:
    """Every point that can ever be seen, each at its fixed index: loose markers, ghosts, reflections, bodies' markers.

    Parameters
    ----------
    n_loose, n_ghosts, n_reflections : int
        Points that belong to no rigid body.
    body_ids : sequence of int
        Numbers of the rigid bodies.
    shuffles : bool
        True: each frame lists them in another order; False: as Motive does, labeled ones before unlabeled, both by
        ascending number.
    rng : numpy.random.Generator
    """

    def __init__(
        self,
        n_loose: int,
        n_ghosts: int,
        n_reflections: int,
        body_ids: Sequence[int],
        *,
        shuffles: bool,
        rng: np.random.Generator,
    ) -> None:
        self._shuffles = shuffles
        self._rng = rng
        self.n_loose = n_loose
        self.first_member = n_loose + n_ghosts + n_reflections
        """Index of the first marker of a body; all from here on are."""
        n_points = self.first_member + BODY_SIZE * len(body_ids)
        members = [(body_id << 16) | member for body_id in body_ids for member in range(1, BODY_SIZE + 1)]
        # Numbers are given as points are found, which has nothing to do with their place on the cable.
        self._next_id = FIRST_LOOSE_ID + self.first_member
        loose_ids = FIRST_LOOSE_ID + rng.permutation(self.first_member)
        self.ids = np.concatenate([loose_ids, np.array(members, dtype=np.int64)]).astype(np.uint32)
        """(n,): body << 16 | member for a body's marker, else a number that changes after each gap."""
        self.flags = np.full(n_points, UNLABELED_FLAGS, dtype=np.uint32)
        self.flags[self.first_member :] = LABELED_FLAGS
        self.size_m = rng.uniform(*MARKER_SIZE_M, n_points).astype(np.float32)
        self.residual_m = rng.uniform(*RESIDUAL_M, n_points).astype(np.float32)
        self._seen = np.ones(n_points, dtype=np.bool_)

    def __len__(self) -> int:
        return len(self.ids)

    def renew(self, points: Indices) -> None:
        """Give points that appear numbers that were never used, as Motive does."""
        n = len(points)
        if n == 0:
            return
        if self._next_id < BODY_IDS_BEGIN <= self._next_id + n:
            self._next_id = BODY_IDS_END
        self.ids[points] = np.arange(self._next_id, self._next_id + n, dtype=np.uint32)
        self._next_id += n

    def hide(self, loose: Bools) -> None:
        """Say which loose markers (n_loose,) are hidden in this frame; those that come back get new numbers."""
        seen = self._seen[: self.n_loose]
        if loose.any() or not seen.all():
            self.renew(np.flatnonzero(~loose & ~seen))
            seen[:] = ~loose

    def hide_members(self, hidden: Bools, lost: Bools) -> None:
        """Say which bodies' markers are hidden: the tracker fills them in, unless it has lost their body."""
        self.flags[self.first_member :] = np.where(hidden, LABELED_FLAGS | OCCLUDED, LABELED_FLAGS)
        self._seen[self.first_member :] = ~np.repeat(lost, BODY_SIZE)

    def order(self) -> Indices:
        """Return the indices of all that are seen, as this frame lists them."""
        seen = np.flatnonzero(self._seen)
        if self._shuffles:
            return self._rng.permutation(seen)
        n_others = np.searchsorted(seen, self.first_member)
        others = seen[:n_others]
        return np.concatenate([seen[n_others:], others[np.argsort(self.ids[others])]])
