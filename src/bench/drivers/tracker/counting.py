"""What the frame numbers tell: frames that never came, came late, came twice, or began anew."""

from __future__ import annotations

from collections import OrderedDict
from enum import Enum

__all__ = ["FrameCounter", "Place"]

REORDER_FRAMES = 100
"""Network equipment reorders neighbours; a number that falls back further begins a new count."""
PACE_TOLERANCE = 0.5
"""A leap over more frames than that by which the clock went on twice too little or too much is no loss."""


class Place(Enum):
    """Where a frame stands in the count."""

    NEXT = "next"
    LATE = "late"
    """Overtaken by a newer frame on its way; if it was counted as missed, it no longer is."""
    DUPLICATE = "duplicate"
    RESTART = "restart"
    """The tracker's software counts anew: it was restarted, or changed between live and recorded frames."""


class FrameCounter:
    """Follows the frame numbers of one stream."""

    def __init__(self) -> None:
        self._first = self._newest = 0
        self._newest_ticks = 0
        self._ticks_per_frame = 0.0
        self._recent: OrderedDict[int, int] = OrderedDict()
        self._missing: OrderedDict[int, None] = OrderedDict()
        self.missed = 0
        """Frames that have not come, of all the numbers since the first."""

    def place(self, number: int, ticks: int, *, after_silence: bool = False) -> tuple[Place, int]:
        """Take one frame into account.

        Parameters
        ----------
        number : int
            The tracker's frame number.
        ticks : int
            Its capture time by the tracker's clock, which tells a late or doubled frame from a new count.
        after_silence : bool, optional
            The first frame after a silence, longer than any frame is late.

        Returns
        -------
        place : Place
        change : int
            How much the number of missed frames changed: the gap before this frame, or -1 for a late one.
        """
        if not self._recent:
            self._begin(number, ticks)
            return Place.NEXT, 0
        if number > self._newest:
            if self._is_new_count(number, ticks):
                self._begin(number, ticks)
                return Place.RESTART, 0
            return Place.NEXT, self._advance(number, ticks)
        if self._recent.get(number) == ticks:
            return Place.DUPLICATE, 0
        if not after_silence and self._newest - number <= REORDER_FRAMES and ticks < self._newest_ticks:
            if number in self._missing:
                return Place.LATE, self._fill(number, ticks)
            if number < self._first:
                return Place.LATE, 0
        self._begin(number, ticks)
        return Place.RESTART, 0

    def begin_anew(self) -> None:
        """Take the next frame as the first of a new count, whatever its number."""
        self._recent.clear()

    def _is_new_count(self, number: int, ticks: int) -> bool:
        """Tell a leap of the numbers from a loss: the clock went back, or on by another time than so many frames take.

        A restarted tracker counts anew, and may have come further than the old count was.
        """
        elapsed, leap = ticks - self._newest_ticks, number - self._newest
        if elapsed < -REORDER_FRAMES * self._ticks_per_frame:
            return True
        if leap <= REORDER_FRAMES or self._ticks_per_frame == 0.0:
            return False
        due = leap * self._ticks_per_frame
        return abs(elapsed - due) > PACE_TOLERANCE * max(elapsed, due)

    def _begin(self, number: int, ticks: int) -> None:
        self._recent.clear()
        self._missing.clear()
        self._first = self._newest = number
        self._newest_ticks = self._recent[number] = ticks

    def _advance(self, number: int, ticks: int) -> int:
        gap = number - self._newest - 1
        if ticks > self._newest_ticks:
            self._ticks_per_frame = (ticks - self._newest_ticks) / (gap + 1)
        for absent in range(max(self._newest + 1, number - REORDER_FRAMES), number):
            self._missing[absent] = None
        self.missed += gap
        self._newest = number
        self._newest_ticks = self._recent[number] = ticks
        self._forget()
        return gap

    def _fill(self, number: int, ticks: int) -> int:
        del self._missing[number]
        self._recent[number] = ticks
        self.missed -= 1
        return -1

    def _forget(self) -> None:
        for kept in (self._missing, self._recent):
            while len(kept) > REORDER_FRAMES:
                kept.popitem(last=False)
