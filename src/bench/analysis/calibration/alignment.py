"""Device time to host time, again, from everything that was recorded: better than what could be known online."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Ints
from bench.timing import ClockMap, estimate_echo_map, estimate_hull_map

__all__ = ["AlignedClock", "SegmentClock", "align_by_arrival", "align_by_echo"]

STRETCH_NS = 20 * 60 * 1_000_000_000
"""A device clock keeps its rate to 0.1 ppm for about 20 minutes of warming up; longer segments get several lines."""


@dataclass(frozen=True)
class SegmentClock:
    """The map of one clock segment."""

    segment: int
    method: str
    """`lower hull`, `echo`, or `as recorded` where no evidence was recorded."""
    offset_s: float
    """Host Unix time minus device time at the segment's first sample."""
    drift_ppm: float
    """How much faster host time runs than the device claims, over the whole segment; NaN if as recorded."""
    residual_sd_us: float
    residual_p50_us: float
    """Median distance of the evidence from the line: of arrivals, how late they came; of answers, either way."""
    residual_p99_us: float
    n_samples: int
    """Pairs of device and host time the map rests on."""


@dataclass(frozen=True, eq=False)
class AlignedClock:
    """Host times of n records and how they were found."""

    host_ns: Ints
    """(n,)"""
    segments: list[SegmentClock]


def align_by_arrival(
    ticks: Ints, arrival_ns: Ints, capture_ns: Ints, segment: Ints, nominal_ns_per_tick: float
) -> AlignedClock:
    """Map a one-way stream (a robot): each segment by the lower hull of its (device, arrival) pairs.

    Parameters
    ----------
    ticks, arrival_ns, capture_ns, segment : (n,)
        Device time, arrival, the capture time known online, clock segment of each record.
    nominal_ns_per_tick : float
        The device's claimed rate.
    """
    host, found = capture_ns.copy(), []
    for number in np.unique(segment):
        rows = np.flatnonzero(segment == number)
        maps = [
            estimate_hull_map(ticks[part], arrival_ns[part], nominal_ns_per_tick)
            for part in _stretches(rows, ticks[rows], nominal_ns_per_tick)
        ]
        host[rows] = _join(maps, ticks[rows])
        late_ns = arrival_ns[rows] - host[rows]
        found.append(_describe(int(number), "lower hull", maps, ticks[rows], host[rows], late_ns))
    return AlignedClock(host, found)


def align_by_echo(
    ticks: Ints,
    capture_ns: Ints,
    segment: Ints,
    sample_segment: Ints,
    send_ns: Ints,
    sample_ticks: Ints,
    receive_ns: Ints,
    nominal_ns_per_tick: float,
) -> AlignedClock:
    """Map a device that answers clock questions (a tracker): each segment by its own answers.

    Segments without answers, and imported takes, keep the capture times of the recording.

    Parameters
    ----------
    ticks, capture_ns, segment : (n,)
        Device time, the capture time known online, clock segment of each record.
    sample_segment, send_ns, sample_ticks, receive_ns : (m,)
        The questions and answers.
    nominal_ns_per_tick : float
        The device's claimed rate.
    """
    host, found = capture_ns.copy(), []
    for number in np.unique(segment):
        rows, asked = np.flatnonzero(segment == number), np.flatnonzero(sample_segment == number)
        maps = [
            estimate_echo_map(send_ns[part], sample_ticks[part], receive_ns[part], nominal_ns_per_tick)
            for part in _stretches(asked, sample_ticks[asked], nominal_ns_per_tick)
        ]
        apart_ns = np.zeros(0, dtype=np.int64)
        if maps:
            host[rows] = _join(maps, ticks[rows])
            middle_ns = send_ns[asked] + (receive_ns[asked] - send_ns[asked]) // 2
            apart_ns = np.abs(middle_ns - _join(maps, sample_ticks[asked]))
        method = "echo" if maps else "as recorded"
        found.append(_describe(int(number), method, maps, ticks[rows], host[rows], apart_ns, nominal_ns_per_tick))
    return AlignedClock(host, found)


def _stretches(rows: Ints, ticks: Ints, ns_per_tick: float) -> list[Ints]:
    """Split the rows of a segment into equal stretches of at most 20 minutes of device time; empty ones left out."""
    if len(rows) == 0:
        return []
    elapsed = (ticks - ticks.min()).astype(np.float64) * ns_per_tick
    n_stretches = max(1, int(np.ceil(elapsed.max() / STRETCH_NS)))
    number = np.minimum((elapsed / max(elapsed.max(), 1.0) * n_stretches).astype(np.int64), n_stretches - 1)
    parts = [rows[number == i] for i in range(n_stretches)]
    return [part for part in parts if len(part)]


def _join(maps: list[ClockMap], ticks: Ints) -> Ints:
    """Map ticks by one line, or by several that are made to meet halfway where one stretch ends and the next begins."""
    if len(maps) == 1:
        return maps[0].to_host_ns(ticks)
    inner = [following.device_origin for following in maps[1:]]
    knots = np.array([min(maps[0].device_origin, int(ticks.min())), *inner, max(inner[-1] + 1, int(ticks.max()))])
    before, after = [maps[0], *maps], [*maps, maps[-1]]
    host = np.array(
        [(a.to_host_ns(int(t)) + b.to_host_ns(int(t))) // 2 for a, b, t in zip(before, after, knots, strict=True)]
    )
    nominal = maps[0].nominal_ns_per_tick
    away = (host - host[0]) - (knots - knots[0]) * nominal
    elapsed = (ticks - knots[0]).astype(np.float64)
    line = elapsed * nominal + np.interp(elapsed, knots - knots[0], away)
    return np.asarray(host[0] + np.rint(line).astype(np.int64), dtype=np.int64)


def _describe(
    number: int,
    method: str,
    maps: list[ClockMap],
    ticks: Ints,
    host_ns: Ints,
    apart_ns: Ints,
    ns_per_tick: float = float("nan"),
) -> SegmentClock:
    nominal = maps[0].nominal_ns_per_tick if maps else ns_per_tick
    first, last = int(ticks.argmin()), int(ticks.argmax())
    span = float(ticks[last] - ticks[first]) * nominal
    drift = maps[0].drift_ppm if len(maps) == 1 else float("nan")
    if len(maps) > 1 and span > 0:
        drift = (float(host_ns[last] - host_ns[first]) / span - 1.0) * 1e6
    variances = [one.residual_sd_ns**2 for one in maps]
    p50, p99 = np.quantile(apart_ns, [0.5, 0.99]) * 1e-3 if len(apart_ns) else (np.nan, np.nan)
    return SegmentClock(
        segment=number,
        method=method,
        offset_s=float(host_ns[first]) * 1e-9 - float(ticks[first]) * nominal * 1e-9,
        drift_ppm=drift,
        residual_sd_us=float(np.sqrt(np.mean(variances))) * 1e-3 if maps else float("nan"),
        residual_p50_us=float(p50),
        residual_p99_us=float(p99),
        n_samples=sum(one.n_samples for one in maps),
    )
