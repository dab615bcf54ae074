"""Maps from a device's clock to host time.

Two kinds of evidence: a stream whose samples arrive late by an unknown but never negative delay (a robot), and
questions that are answered (a tracker's clock echo). The first gives the line below all (device, arrival) pairs,
the lower convex hull, which load on the machine cannot bend; the second a line through the quickest answers.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import overload

import numpy as np
import numpy.typing as npt

__all__ = ["ClockMap", "EchoFilter", "MinimumDelayFilter", "estimate_echo_map", "estimate_hull_map"]

HULL_BINS = 2_000
"""The hull needs the earliest arrival of each stretch only; 2 000 stretches keep a 20-minute segment to 0.6 s each."""
ECHO_BINS = 500
"""The quickest answer of each stretch is kept: with an echo each 250 ms, of 4 answers in 8 minutes."""
SHORTEST_FIT_NS = 2_000_000_000
"""Below this span, the nominal rate is nearer the truth than a fitted one (0.1 ms of jitter over 2 s is 50 ppm)."""


@dataclass(frozen=True, slots=True)
class ClockMap:
    """A straight line from device ticks to host time, valid for one clock segment."""

    device_origin: int
    """Device ticks at the origin of the line."""
    host_origin_ns: int
    """Host time at the origin of the line."""
    ns_per_tick: float
    """Slope: host nanoseconds in one device tick."""
    nominal_ns_per_tick: float
    """The slope the device claims."""
    residual_sd_ns: float = float("nan")
    """Standard deviation of the evidence about the line: of the answers' midpoints, or of the hull over its span."""
    bias_bound_ns: float = float("nan")
    """Bound of the constant error: half the shortest round trip. NaN where one-way data hides it."""
    n_samples: int = 0
    """Pairs that went into the estimate."""

    @property
    def drift_ppm(self) -> float:
        """How much faster host time runs than the device claims, parts per million."""
        return (self.ns_per_tick / self.nominal_ns_per_tick - 1.0) * 1e6

    @overload
    def to_host_ns(self, ticks: int) -> int: ...

    @overload
    def to_host_ns(self, ticks: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]: ...

    def to_host_ns(self, ticks: int | npt.NDArray[np.int64]) -> int | npt.NDArray[np.int64]:
        """Map device ticks to host Unix nanoseconds, one or an array of any shape."""
        if isinstance(ticks, np.ndarray):
            elapsed = (ticks.astype(np.int64) - self.device_origin).astype(np.float64)
            return np.asarray(np.rint(elapsed * self.ns_per_tick), dtype=np.int64) + self.host_origin_ns
        return self.host_origin_ns + round((ticks - self.device_origin) * self.ns_per_tick)


def estimate_hull_map(
    ticks: npt.NDArray[np.int64], arrival_ns: npt.NDArray[np.int64], nominal_ns_per_tick: float
) -> ClockMap:
    """Estimate the line that lies below every arrival and nearest to all of them.

    Parameters
    ----------
    ticks, arrival_ns : (n,) int64
        Device time and host arrival time of each sample of one clock segment, in any order.
    nominal_ns_per_tick : float
        The device's claimed rate, used as it is where the span is too short for a fit.

    Returns
    -------
    ClockMap
        Late by the shortest delay that occurred (0.1 to 0.3 ms on a direct cable), a constant.

    Raises
    ------
    ValueError
        Without a single sample.

    References
    ----------
    Zhang, Liu, Xia: Clock synchronization algorithms for network measurements, INFOCOM 2002.
    """
    if len(ticks) == 0:
        raise ValueError("no samples to map a clock with")
    x, y, origin, host_origin = _relative(ticks, arrival_ns, nominal_ns_per_tick)
    if np.ptp(x) * nominal_ns_per_tick < SHORTEST_FIT_NS:
        slope, intercept = 0.0, float(y.min())
        corners_y = np.array([intercept])
        corners_x = np.array([0.0])
    else:
        corners_x, corners_y = _lower_hull(*_earliest_by_bin(x, y, HULL_BINS))
        slope, intercept = _edge_over(corners_x, corners_y, float(x.mean()))
    residual = corners_y - (intercept + slope * corners_x)
    return ClockMap(
        device_origin=origin,
        host_origin_ns=host_origin + round(intercept),
        ns_per_tick=nominal_ns_per_tick + slope,
        nominal_ns_per_tick=nominal_ns_per_tick,
        residual_sd_ns=_root_mean_square_over(corners_x, residual),
        n_samples=len(ticks),
    )


def estimate_echo_map(
    send_ns: npt.NDArray[np.int64],
    ticks: npt.NDArray[np.int64],
    receive_ns: npt.NDArray[np.int64],
    nominal_ns_per_tick: float,
) -> ClockMap:
    """Estimate the line through the quickest answers to clock questions.

    Parameters
    ----------
    send_ns, ticks, receive_ns : (n,) int64
        Host time before the question, the device's answer, host time after it; one clock segment.
    nominal_ns_per_tick : float
        The device's claimed rate, used as it is where the span is too short for a fit.

    Raises
    ------
    ValueError
        Without a single answer.
    """
    if len(ticks) == 0:
        raise ValueError("no answers to map a clock with")
    round_trip = receive_ns - send_ns
    middle = send_ns + round_trip // 2
    x, y, origin, host_origin = _relative(ticks, middle, nominal_ns_per_tick)
    quick = _quickest_by_bin(x, round_trip)
    quick = quick[round_trip[quick] <= 2 * np.median(round_trip[quick])]
    xq, yq = x[quick], y[quick]
    if len(quick) >= 3 and np.ptp(xq) * nominal_ns_per_tick >= SHORTEST_FIT_NS:
        weight = 1.0 / np.maximum(round_trip[quick], 1)
        slope, intercept = np.polyfit(xq, yq, 1, w=weight)
    else:
        slope, intercept = 0.0, float(y[np.argmin(round_trip)])
    residual = yq - (intercept + slope * xq)
    return ClockMap(
        device_origin=origin,
        host_origin_ns=host_origin + round(float(intercept)),
        ns_per_tick=nominal_ns_per_tick + float(slope),
        nominal_ns_per_tick=nominal_ns_per_tick,
        residual_sd_ns=float(np.sqrt(np.mean(residual**2))),
        bias_bound_ns=float(round_trip.min()) / 2,
        n_samples=len(ticks),
    )


class MinimumDelayFilter:
    """The map of a one-way stream while it runs: nominal rate, smallest delay of the last seconds.

    Good to the drift over the window (30 ppm times 10 s is 0.3 ms); for display and for `publish_time`. The report
    uses `estimate_hull_map`.
    """

    def __init__(self, ns_per_tick: float, window_ns: int = 10_000_000_000) -> None:
        self._ns_per_tick = ns_per_tick
        self._window_ns = window_ns
        self._delays: deque[tuple[int, int]] = deque()

    def update(self, ticks: int, arrival_ns: int) -> int:
        """Take one sample into account and return its host time."""
        device_ns = round(ticks * self._ns_per_tick)
        delay = arrival_ns - device_ns
        kept = self._delays
        while kept and kept[-1][1] >= delay:
            kept.pop()
        kept.append((arrival_ns, delay))
        while kept[0][0] < arrival_ns - self._window_ns:
            kept.popleft()
        return device_ns + kept[0][1]

    def reset(self) -> None:
        """Forget everything: a new clock segment begins."""
        self._delays.clear()


class EchoFilter:
    """The map of a device that answers clock questions, refitted at each answer over the last minute."""

    def __init__(self, n_kept: int = 240) -> None:
        self._answers: deque[tuple[int, int, int]] = deque(maxlen=n_kept)
        self.map: ClockMap | None = None
        """The newest map, or None before the first answer."""

    def update(self, send_ns: int, ticks: int, receive_ns: int, ns_per_tick: float) -> None:
        """Take one answer into account: host time before it, the device's clock, host time after it."""
        self._answers.append((send_ns, ticks, receive_ns))
        send, answer, receive = np.array(self._answers, dtype=np.int64).T
        self.map = estimate_echo_map(send, answer, receive, ns_per_tick)

    def reset(self) -> None:
        """Forget everything: a new clock segment begins."""
        self._answers.clear()
        self.map = None


def _relative(
    ticks: npt.NDArray[np.int64], host_ns: npt.NDArray[np.int64], ns_per_tick: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], int, int]:
    """Take the nominal line out, so that what is left fits a float exactly."""
    origin, host_origin = int(ticks[0]), int(host_ns[0])
    x = (ticks - origin).astype(np.float64)
    y = (host_ns - host_origin).astype(np.float64) - x * ns_per_tick
    return x, y, origin, host_origin


def _bin_of(x: npt.NDArray[np.float64], n_bins: int) -> npt.NDArray[np.intp]:
    span = max(float(np.ptp(x)), 1.0)
    bins: npt.NDArray[np.intp] = ((x - x.min()) / span * n_bins).astype(np.intp)
    return np.minimum(bins, n_bins - 1)


def _first_of_bins(
    bins: npt.NDArray[np.intp], key: npt.NDArray[np.float64] | npt.NDArray[np.int64]
) -> npt.NDArray[np.intp]:
    order = np.lexsort((key, bins))
    _, first = np.unique(bins[order], return_index=True)
    return np.asarray(order[first], dtype=np.intp)


def _earliest_by_bin(
    x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], n_bins: int
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    chosen = _first_of_bins(_bin_of(x, n_bins), y)
    order = np.argsort(x[chosen], kind="stable")
    return x[chosen][order], y[chosen][order]


def _quickest_by_bin(x: npt.NDArray[np.float64], round_trip: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
    n_bins = min(ECHO_BINS, max(1, len(x) // 4))
    return _first_of_bins(_bin_of(x, n_bins), round_trip)


def _lower_hull(
    x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Andrew's monotone chain over points sorted by x."""
    hull: list[tuple[float, float]] = []
    for px, py in zip(x.tolist(), y.tolist(), strict=True):
        while len(hull) > 1 and _turns_right(hull[-2], hull[-1], (px, py)):
            hull.pop()
        hull.append((px, py))
    corners = np.array(hull)
    return corners[:, 0], corners[:, 1]


def _turns_right(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) <= 0


def _edge_over(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], middle: float) -> tuple[float, float]:
    """Return slope and intercept of the hull's edge over `middle`: of all lines below the points, the nearest."""
    if len(x) == 1:
        return 0.0, float(y[0])
    right = int(np.clip(np.searchsorted(x, middle), 1, len(x) - 1))
    slope = (y[right] - y[right - 1]) / (x[right] - x[right - 1])
    return float(slope), float(y[right] - slope * x[right])


def _root_mean_square_over(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> float:
    """Return the root mean square over x of the polyline through (x, y): a corner counts as long as it lasts."""
    if len(x) == 1:
        return float(abs(y[0]))
    squares = (y[:-1] ** 2 + y[:-1] * y[1:] + y[1:] ** 2) / 3
    return float(np.sqrt(np.sum(squares * np.diff(x)) / (x[-1] - x[0])))
