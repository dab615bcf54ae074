"""What the frame numbers tell: frames that never came, came late, came twice, or began anew."""

from __future__ import annotations

from collections import OrderedDict
from enum import Enum

__all__ = ["FrameCounter", "Place"]

REORDER_FRAMES = 100
"""Network equipment reorders neighbours; a number that falls back further begins a new count."""


class Place(Enum):
    """Where a frame stands in the count."""

    NEXT = "next"
    LATE = "late"
    """Was counted as missed, and came after all."""
    DUPLICATE = "duplicate"
    RESTART = "restart"
    """The tracker's software counts anew: it was restarted, or changed between live and recorded frames."""


class FrameCounter:
    """Follows the frame numbers of one stream."""

    def __init__(self) -> None:
        self._newest: int | None = None
        self._newest_ticks = 0
        self._missing: OrderedDict[int, None] = OrderedDict()
        self.missed = 0
        """Frames that have not come, of all the numbers since the first."""

    def place(self, number: int, ticks: int) -> tuple[Place, int]:
        """Take one frame into account.

        Parameters
        ----------
        number : int
            The tracker's frame number.
        ticks : int
            Its capture time by the tracker's clock, which tells a late frame from a new count.

        Returns
        -------
        place : Place
        change : int
            How much the number of missed frames changed: the gap before this frame, or -1 for a late one.
        """
        newest = self._newest
        if newest is None:
            return self._advance(number, ticks, Place.NEXT), 0
        if number > newest:
            gap = number - newest - 1
            self._expect(newest + 1, number)
            self.missed += gap
            return self._advance(number, ticks, Place.NEXT), gap
        if newest - number > REORDER_FRAMES or ticks > self._newest_ticks:
            self._missing.clear()
            return self._advance(number, ticks, Place.RESTART), 0
        if number in self._missing:
            del self._missing[number]
            self.missed -= 1
            return Place.LATE, -1
        return Place.DUPLICATE, 0

    def _advance(self, number: int, ticks: int, place: Place) -> Place:
        self._newest, self._newest_ticks = number, ticks
        return place

    def _expect(self, first: int, stop: int) -> None:
        for number in range(max(first, stop - REORDER_FRAMES), stop):
            self._missing[number] = None
        while len(self._missing) > REORDER_FRAMES:
            self._missing.popitem(last=False)
