"""Where on its path the robot was at each moment, told by how far it has moved: by no clock and by no register.

What a cycle has travelled is the length of the way its joints went. It grows with every motion and stands still in
every rest, so it tells the place on the path whatever the speed, and also where the path goes back over itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, Ints
from bench.analysis.cycles.sources import REST_RAD_S
from bench.analysis.cycles.table import CycleTable

__all__ = ["Travel", "measure_travel", "phase_from_path"]

BLOCK_NS = 20_000_000
"""Samples are averaged over this time: ten at 500 Hz, so that noise at rest stays below the speed of rest."""
REST_M_S = 0.002
"""Speed of rest of a TCP: that of a joint at rest (0.01 rad/s) on a lever of 0.2 m."""
REST_NS = 100_000_000
"""A standstill of this length is a rest; a path that only turns back stands for less."""
SAME_LENGTH = 0.02
"""Cycles on one path differ in length by their noise, 0.001 and less; one that differs by more took another path."""
SAME_DURATION = 0.02
"""A cycle that is longer than the usual one by this part was slowed or held, and is not learnt from."""
SAME_PLACE = 0.005
"""Two rests at levels no further apart are the same rest: half a millimetre on a path of 0.1 m."""


@dataclass(frozen=True, eq=False)
class Travel:
    """How far the robot had moved since the recording began, at each of b moments."""

    time_ns: Ints
    length: Floats
    """(b,): rad of the six joints' way, or metres of the TCP's; rests add nothing."""
    moving: Bools
    """(b - 1,): whether it moved between each moment and the next."""

    def at(self, host_ns: Ints) -> Floats:
        """Return the length at other moments."""
        origin = self.time_ns[0]
        moments, known = (host_ns - origin).astype(np.float64), (self.time_ns - origin).astype(np.float64)
        return np.asarray(np.interp(moments, known, self.length))


@dataclass(frozen=True, eq=False)
class _Rests:
    """Stretches of standstill, each inside one cycle."""

    row: Ints
    begin_ns: Ints
    end_ns: Ints
    level: Floats
    """Place on the path, 0…1."""


def measure_travel(host_ns: Ints, q_rad: Floats, tcp_pose: Floats) -> Travel | None:
    """Measure how far the robot had moved at each moment; None where it does not say where it is.

    Parameters
    ----------
    host_ns : (n,)
        Times of the robot's samples, ascending.
    q_rad : (n, j)
        Joint positions; NaN where unknown.
    tcp_pose : (n, 6)
        TCP poses; their positions are used where no joints are known. A turn on the spot does not show there.
    """
    for values, rest in ((q_rad, REST_RAD_S), (tcp_pose[:, :3], REST_M_S)):
        given = np.isfinite(values).any(axis=0)
        known = np.isfinite(values[:, given]).all(axis=1)
        if given.any() and int(known.sum()) > 1:
            everything = given.all() and known.all()
            return _add_up(host_ns[known], values if everything else values[known][:, given], rest)
    return None


def _add_up(host_ns: Ints, values: Floats, rest_per_s: float) -> Travel:
    block = (host_ns - host_ns[0]) // BLOCK_NS
    first = np.flatnonzero(np.diff(block, prepend=-1))
    n = np.diff(np.append(first, len(block)))
    time_ns = host_ns[0] + np.add.reduceat(host_ns - host_ns[0], first) // n
    mean = np.add.reduceat(values, first, axis=0) / n[:, None]
    step = np.linalg.norm(np.diff(mean, axis=0), axis=1)
    moving = step > rest_per_s * 1e-9 * np.diff(time_ns)
    return Travel(time_ns, np.concatenate([[0.0], np.cumsum(np.where(moving, step, 0.0))]), moving)


def phase_from_path(table: CycleTable, travel: Travel, row: Ints, host_ns: Ints) -> Floats | None:
    """Return the phase of each moment (F,): the share of a usual cycle's time after which it was in the same place.

    A cycle of the usual duration is the reference. A cycle that is driven at another speed, or stops on its way, has
    the reference's phase in each place. Where the reference rests, its phase goes on, and that of another cycle which
    rests there too goes from one end of the rest to the other. None where no cycle is complete or nothing moves; NaN
    outside any cycle, and in cycles that took another path.

    Parameters
    ----------
    table : CycleTable
        The cycles.
    travel : Travel
        The robot's way.
    row : (F,)
        The cycle row of each moment, -1 outside.
    host_ns : (F,)
        The moments.
    """
    begun = travel.at(table.start_ns)
    length = travel.at(table.end_ns) - begun
    reference = _choose_reference(table, travel)
    if reference < 0 or length[reference] <= 0:
        return None
    scale = _scale_cycles(table.complete, length, float(length[reference]))
    knots_ns = travel.time_ns[(travel.time_ns > table.start_ns[reference]) & (travel.time_ns < table.end_ns[reference])]
    ends = table.start_ns[reference], table.end_ns[reference]
    knots_ns = np.concatenate([ends[:1], knots_ns, ends[1:]])
    knot_phase = (knots_ns - ends[0]) / (ends[1] - ends[0])
    knot_level = (travel.at(knots_ns) - begun[reference]) / length[reference]
    inside = np.flatnonzero(row >= 0)
    phase = np.full(len(host_ns), np.nan)
    level = (travel.at(host_ns[inside]) - begun[row[inside]]) / scale[row[inside]]
    phase[inside] = np.interp(level, knot_level, knot_phase)
    rests = _find_rests(table, travel, begun, scale)
    phase[inside] = _go_through_rests(phase[inside], table, reference, rests, row[inside], host_ns[inside])
    return phase


def _choose_reference(table: CycleTable, travel: Travel) -> int:
    """Return the row of a whole cycle of the usual duration, of these the one with most samples; -1 without any."""
    whole = np.flatnonzero(table.complete & table.unbroken & table.seen)
    if not len(whole):
        return -1
    duration = table.duration_s[whole]
    usual = np.sort(duration)[(len(whole) - 1) // 2]
    alike = whole[np.abs(duration - usual) <= SAME_DURATION * usual]
    n_samples = np.diff(np.searchsorted(travel.time_ns, [table.start_ns[alike], table.end_ns[alike]]), axis=0)[0]
    return int(alike[n_samples.argmax()])


def _scale_cycles(complete: Bools, length: Floats, usual: float) -> Floats:
    """Return the length (C,) that is the whole path in each cycle, NaN where it is another path."""
    same = np.abs(length / usual - 1.0) <= SAME_LENGTH
    begun = ~complete & (length <= (1.0 + SAME_LENGTH) * usual)
    return np.where(complete & same, length, np.where(begun, usual, np.nan))


def _find_rests(table: CycleTable, travel: Travel, begun: Floats, scale: Floats) -> _Rests:
    middle = travel.time_ns[:-1] + np.diff(travel.time_ns) // 2
    row = np.where(travel.moving, -1, table.locate(middle))
    first = np.flatnonzero(np.diff(row, prepend=-2))
    stop = np.append(first[1:], len(row))
    at = row[first]
    begin_ns = np.maximum(travel.time_ns[first], table.start_ns[at])
    end_ns = np.minimum(travel.time_ns[stop], table.end_ns[at])
    kept = (at >= 0) & (end_ns - begin_ns >= REST_NS)
    level = (travel.length[first] - begun[at]) / scale[at]
    return _Rests(at[kept], begin_ns[kept], end_ns[kept], level[kept])


def _go_through_rests(
    phase: Floats, table: CycleTable, reference: int, rests: _Rests, row: Ints, host_ns: Ints
) -> Floats:
    """Let the phase (F,) of frames inside cycles go on in the rests that are the reference's too."""
    start_ns, duration_ns = table.start_ns[reference], table.end_ns[reference] - table.start_ns[reference]
    for one in np.flatnonzero(rests.row == reference):
        begin_phase = (rests.begin_ns[one] - start_ns) / duration_ns
        end_phase = (rests.end_ns[one] - start_ns) / duration_ns
        same = np.abs(rests.level - rests.level[one]) <= SAME_PLACE
        begin_ns, end_ns = table.end_ns.copy(), table.start_ns.copy()
        np.minimum.at(begin_ns, rests.row[same], rests.begin_ns[same])
        np.maximum.at(end_ns, rests.row[same], rests.end_ns[same])
        begin, end = begin_ns[row], end_ns[row]
        rested = begin < end
        share = (host_ns - begin) / np.maximum(end - begin, 1)
        within = begin_phase + np.clip(share, 0.0, 1.0) * (end_phase - begin_phase)
        before, after = rested & (host_ns < begin), rested & (host_ns > end)
        phase = np.where(rested & ~before & ~after, within, phase)
        phase = np.where(before, np.minimum(phase, begin_phase), phase)
        phase = np.where(after, np.maximum(phase, end_phase), phase)
    return np.asarray(np.clip(phase, 0.0, 1.0))
