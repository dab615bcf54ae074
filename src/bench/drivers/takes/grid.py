"""When the frames of a take were captured: the exact grid of its rate, or the times written in the file."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from fractions import Fraction

import numpy as np

from bench.drivers.takes.rows import Ascending, Floats, Stamps, Ticks
from bench.drivers.takes.take import TICKS_PER_S

__all__ = [
    "MAX_FRAME_NUMBER",
    "MAX_TIME_S",
    "METRES_PER_UNIT",
    "GridSurvey",
    "Survey",
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
MAX_ROUNDING_S = 1.1e-3
"""Times are written to the millisecond, rounded or cut off: 1 ms, and a tenth for the digits after it."""
RATE_LIMITS_HZ = (0.01, 1e6)
MAX_FRAME_NUMBER = 0xFFFFFFFF
"""MCAP's sequence numbers are 32-bit."""
MAX_TIME_S = 1e9
"""Some 30 years: a larger time is no time of a take."""
MAX_START_S = 4_102_444_800
"""The year 2100: with `MAX_TIME_S` added, nanoseconds still fit 64 bits."""
UNKNOWN_START = (0, "unknown: the take's frame 0 is put at 1970-01-01 00:00 UTC")
START = re.compile(r"(\d{4})-(\d\d)-(\d\d)[ T](\d\d)[.:](\d\d)[.:](\d\d)(?:\.(\d{1,6}))?(?: ([AP]M))?")


@dataclass
class Survey:
    """What one pass over the numbers and times of all frames found, before any of them is used."""

    n_frames: int = 0
    cut: list[int] = field(default_factory=list)
    """Number of the last line where it has no line end."""
    first: tuple[int, float] | None = None
    """Number and time of the first frame."""
    _last: tuple[int, float] | None = None
    _steps: list[Floats] = field(default_factory=list)
    _n_steps: int = 0
    _ascending: Ascending = field(default_factory=Ascending)

    def add(self, found: Stamps) -> None:
        """Take in the next frames; those that do not ascend are only counted."""
        stamps = found.keep(self._ascending.mask(found))
        if len(stamps) == 0:
            return
        self.first = self.first or (int(stamps.number[0]), float(stamps.time_s[0]))
        self.n_frames += len(stamps)
        self._add_steps(stamps)
        self._last = int(stamps.number[-1]), float(stamps.time_s[-1])
        self.compare(stamps)

    def compare(self, stamps: Stamps) -> None:
        """Compare the times of frames that ascend with whatever the format says of them; here with nothing."""

    @property
    def median_rate_hz(self) -> float:
        """1 / median time step, to a millihertz; 0 where there are no times or none pass."""
        steps = np.concatenate([np.empty(0), *self._steps])
        steps = steps[steps > 0]
        return round(1.0 / float(np.median(steps)), 3) if len(steps) else 0.0

    def warnings(self, promised: int | None) -> list[str]:
        """Return what was found amiss, one sentence each."""
        found = []
        if self.cut:
            found.append(f"The last line ({self.cut[0]}) has no line end and may be cut, so it is left out.")
        if self._ascending.n_left_out:
            n, line = self._ascending.n_left_out, self._ascending.first_line
            frames = f"{n} frames are left out, the first of them" if n > 1 else "1 frame is left out,"
            found.append(f"{frames} in line {line}: repeated, or back in number or in time.")
        if promised is not None and promised != self.n_frames:
            found.append(f"The header promises {promised} frames, {self.n_frames} were found.")
        return found

    def _add_steps(self, stamps: Stamps) -> None:
        """Keep the time per frame number between neighbours."""
        if self._n_steps >= MAX_STEPS:
            return
        number, time_s = stamps.number, stamps.time_s
        if self._last is not None:
            number = np.concatenate([[self._last[0]], number])
            time_s = np.concatenate([[self._last[1]], time_s])
        self._steps.append(np.diff(time_s) / np.diff(number))
        self._n_steps += len(number) - 1


@dataclass
class GridSurvey(Survey):
    """And how far the written times are from the grids of the rates that the header gives."""

    rates_hz: tuple[Fraction, ...] = ()
    worst_s: Floats = field(default_factory=lambda: np.zeros(0))
    """For each of the rates."""

    def __post_init__(self) -> None:
        self.worst_s = np.zeros(len(self.rates_hz))

    def compare(self, stamps: Stamps) -> None:
        number, time_s = self.first or (0, 0.0)
        rates_hz = np.array([float(rate) for rate in self.rates_hz])
        grid_s = (stamps.number - number)[:, None] / rates_hz
        off_s = np.abs((stamps.time_s - time_s)[:, None] - grid_s)
        self.worst_s = np.maximum(self.worst_s, np.nan_to_num(off_s).max(axis=0))  # NaN: the file has no times

    @property
    def grid_rate_hz(self) -> Fraction | None:
        """The first rate whose grid the written times follow: exports may number frames of either."""
        pairs = zip(self.rates_hz, self.worst_s.tolist(), strict=True)
        return next((rate for rate, worst_s in pairs if worst_s <= MAX_ROUNDING_S), None)


def grid_ticks(rate_hz: Fraction, origin: int = 0) -> Ticks:
    """Return the function that puts frames on the grid of `rate_hz`, exactly: frame number over rate, in nanoseconds.

    The times written in a Motive export are rounded to milliseconds (0.44 ms off at 360 Hz); the grid is not.
    `origin` is the number of the frame at time 0.
    """
    num, den = rate_hz.numerator, rate_hz.denominator

    def ticks(stamps: Stamps) -> list[int]:
        return [(2 * (number - origin) * TICKS_PER_S * den + num) // (2 * num) for number in stamps.number.tolist()]

    return ticks


def file_ticks(stamps: Stamps) -> list[int]:
    """Return the times written in the file, in nanoseconds."""
    return [round(time_s * TICKS_PER_S) for time_s in stamps.time_s.tolist()]


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
