"""When the frames of a take were captured: the exact grid of its rate, or the times written in the file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from statistics import median

from bench.drivers.takes.take import TICKS_PER_S, Row

__all__ = [
    "MAX_FRAME_NUMBER",
    "MAX_TIME_S",
    "METRES_PER_UNIT",
    "Survey",
    "ascending",
    "file_ticks",
    "grid_ticks",
    "parse_rate",
    "parse_start",
]

METRES_PER_UNIT = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("dm", "decimeters", "decimetres"), 0.1),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), 0.01),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 0.001),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
    **dict.fromkeys(("ft", "foot", "feet"), 0.3048),
}
"""Length units that Motive and C3D files name, lower case."""

MAX_STEPS = 100_000
"""Time steps kept for the median: more would not change it, and memory stays bounded."""
RATE_LIMITS_HZ = (0.01, 1e6)
MAX_FRAME_NUMBER = 0xFFFFFFFF
"""MCAP's sequence numbers are 32-bit."""
MAX_TIME_S = 1e9
"""Some 30 years: a larger time is no time of a take."""
MAX_START_S = 4_102_444_800
"""The year 2100: with `MAX_TIME_S` added, nanoseconds still fit 64 bits."""
UNKNOWN_START = (0, "unknown: the take's frame 0 is put at 1970-01-01 00:00 UTC")
START = re.compile(r"(\d{4})-(\d\d)-(\d\d)[ T](\d\d)[.:](\d\d)[.:](\d\d)(?:\.(\d{1,6}))?(?: ([AP]M))?")

Ticks = Callable[[Row], int]


@dataclass
class Survey:
    """What one pass over all rows of a take found, before anything of it is used."""

    n_frames: int = 0
    n_points: int = 0
    points_min: int = 0
    points_max: int = 0
    first: Row | None = None
    steps_s: list[float] = field(default_factory=list)
    """Time per frame number, one for each pair of neighbouring rows."""
    n_not_ascending: int = 0
    cut: list[int] = field(default_factory=list)
    """Number of the last line where it has no line end."""
    _last: Row | None = None

    def add(self, row: Row) -> None:
        n = len(row.points_m)
        self.points_min = n if self.first is None else min(self.points_min, n)
        self.points_max = max(self.points_max, n)
        self.n_frames += 1
        self.n_points += n
        if self._last is not None and len(self.steps_s) < MAX_STEPS:
            self.steps_s.append((row.time_s - self._last.time_s) / (row.number - self._last.number))
        self.first = self.first or row
        self._last = row

    @property
    def median_rate_hz(self) -> float:
        """1 / median time step, to a millihertz; 0 where there are no times or none pass."""
        steps = [step for step in self.steps_s if step > 0]
        return round(1.0 / median(steps), 3) if steps else 0.0

    def warnings(self, promised: int | None) -> list[str]:
        """Return what was found amiss, one sentence each."""
        found = []
        if self.cut:
            found.append(f"The last line ({self.cut[0]}) has no line end and may be cut, so it is left out.")
        if self.n_not_ascending:
            found.append(f"{self.n_not_ascending} frames are left out: they repeat or go back in number or in time.")
        if promised is not None and promised != self.n_frames:
            found.append(f"The header promises {promised} frames, {self.n_frames} were found.")
        return found


def ascending(rows: Iterable[Row], survey: Survey | None = None) -> Iterator[Row]:
    """Yield the rows whose number ascends and whose time does not go back; the others are counted in `survey`."""
    last: Row | None = None
    for row in rows:
        if last is not None and (row.number <= last.number or row.time_s < last.time_s):
            if survey is not None:
                survey.n_not_ascending += 1
            continue
        last = row
        yield row


def grid_ticks(rate_hz: Fraction) -> Ticks:
    """Return the function that puts a row on the grid of `rate_hz`, exactly: frame number over rate, in nanoseconds.

    The times written in a Motive export are rounded to milliseconds (0.44 ms off at 360 Hz); the grid is not.
    """
    num, den = rate_hz.numerator, rate_hz.denominator
    return lambda row: (2 * row.number * TICKS_PER_S * den + num) // (2 * num)


def file_ticks(row: Row) -> int:
    """Return the time written in the file, in nanoseconds."""
    return round(row.time_s * TICKS_PER_S)


def parse_rate(text: str) -> Fraction | None:
    """Read a frame rate exactly as it is written; None if it is no usable rate."""
    try:
        usable = RATE_LIMITS_HZ[0] <= float(text) <= RATE_LIMITS_HZ[1]
        return Fraction(text.strip()) if usable else None
    except ValueError:
        return None


def parse_start(text: str) -> tuple[int, str]:
    """Read a capture start time such as ``2016-01-05 03.49.50.755 PM``.

    Motive writes it in the language of its PC (``DU.``, ``下午``); whatever is not plain digits, with AM or PM where
    the clock has twelve hours, is not read.

    Returns
    -------
    start_ns : int
        Unix nanoseconds as if the PC's local time were UTC; 0 where the text is not understood.
    origin : str
        What that is, in words.
    """
    match = START.fullmatch(text.strip())
    if match is None:
        return UNKNOWN_START
    year, month, day, hour, minute, second = (int(part) for part in match.groups()[:6])
    half = match.group(8)
    if half:
        hour = hour % 12 + (12 if half == "PM" else 0) if 1 <= hour <= 12 else -1
    try:
        moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return UNKNOWN_START
    whole_s = (moment - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(seconds=1)
    if not 0 <= whole_s < MAX_START_S:
        return UNKNOWN_START
    nanoseconds = int((match.group(7) or "").ljust(9, "0"))
    return whole_s * TICKS_PER_S + nanoseconds, "the take's own clock, its time zone unknown: read as UTC"
