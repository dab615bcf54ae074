"""Where a cycle begins and ends, by each way in which a robot can show it: the one definition for run and report.

The run asks sample by sample (`CycleFollower`), the report asks of all samples at once (`count_cycles`); both give the
program's own numbers, cycles completed and whether it is on its path, as a counting program writes them itself.

A program's count begins at 0 when it starts to play. A sample shows the robot waiting, on its path, or neither:

* ``digital_output``, level: high is on the path, low is waiting;
* ``digital_output``, pulse: each rising edge ends the cycle before it and begins the next;
* ``joint_return``: any joint further than the tolerance from the start pose is on the path, all joints within it and
  at rest is waiting, anything else is neither and changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from bench.analysis.arrays import Floats, Ints
from bench.model import RobotState

__all__ = [
    "CycleFollower",
    "CycleSettings",
    "CycleSource",
    "DigitalOutput",
    "JointReturn",
    "RobotSigns",
    "count_cycles",
    "describe_source",
    "make_cycle_source",
]

RUNTIME_STOPPED = (0, 1)
"""UR runtime states in which no program is on its path, whatever shows: stopping, stopped (RTDE guide)."""
COUNTER_ACCURACY = "starts and ends are known to one robot sample, and no count can be lost"
WAITING, ON_PATH, NEITHER = 0, 1, 2
REST_RAD_S = 0.01
"""A joint slower than this is at rest: twice the noise of `actual_qd` of a standing arm, and 8 ms of a usual start."""


class CycleSettings(Protocol):
    """What `make_cycle_source` must be told: the table ``[robot.cycle]`` has these."""

    @property
    def source(self) -> str: ...
    @property
    def digital_output(self) -> int | None: ...
    @property
    def digital_output_mode(self) -> str: ...
    @property
    def joint_tolerance_deg(self) -> float: ...
    @property
    def start_joints_deg(self) -> tuple[float, ...] | None: ...


@dataclass(frozen=True, eq=False)
class RobotSigns:
    """What a robot that does not count shows of its cycles: n samples in order of capture."""

    digital_outputs: Ints
    """(n,): bits of the digital outputs."""
    q_rad: Floats
    """(n, 6): joint positions."""
    qd_rad_s: Floats
    """(n, 6): joint velocities."""


class CycleSource(Protocol):
    """Reads from a robot's samples where it is in its cycle."""

    @property
    def name(self) -> str:
        """What it goes by, in the report."""
        ...

    @property
    def accuracy(self) -> str:
        """How well it knows when a cycle starts and ends, in one sentence."""
        ...

    @property
    def waiting(self) -> str:
        """How the robot shows that it waits for the start of a cycle, in a few words."""
        ...

    @property
    def ends_at_next(self) -> bool:
        """Whether the next start ends a cycle; else waiting does."""
        ...

    def places(self, signs: RobotSigns, before: RobotSigns) -> Ints:
        """Return `WAITING`, `ON_PATH` or `NEITHER` for each sample (n,).

        Parameters
        ----------
        signs : RobotSigns
            The samples.
        before : RobotSigns
            The one sample before the program began to play.
        """
        ...


@dataclass(frozen=True, slots=True)
class DigitalOutput:
    """A digital output that is high on the path (level), or that goes high once at each start (pulse).

    Known to one sample of the state stream: 2 ms at 500 Hz. A pulse that falls into a gap of the stream is lost.
    """

    number: int
    """Bit of the outputs: 0 to 7 standard, 8 to 15 configurable, 16 and 17 tool."""
    ends_at_next: bool = False
    """Whether the program only pulses."""

    @property
    def name(self) -> str:
        return f"digital output {self.number}, {'pulses' if self.ends_at_next else 'high on the path'}"

    @property
    def accuracy(self) -> str:
        return "starts and ends are known to one robot sample; an edge that no sample shows is a cycle lost"

    @property
    def waiting(self) -> str:
        return f"digital output {self.number} low"

    def places(self, signs: RobotSigns, before: RobotSigns) -> Ints:  # noqa: ARG002 - a level needs no history
        return np.asarray(signs.digital_outputs >> self.number & 1, dtype=np.int64)


@dataclass(frozen=True, slots=True)
class JointReturn:
    """All joints back within a tolerance of the start pose and at rest, after any of them had left it.

    A start is seen when the tolerance is exceeded, about 0.1 s late; the report refines it to the sample in which the
    joints' speed leaves zero. An end is seen when the last joint is slower than 0.01 rad/s.
    """

    tolerance_rad: float
    start_rad: tuple[float, ...] | None = None
    """Joints at the start of the path; None: where the robot stood in the last sample before the program played."""
    ends_at_next: bool = False

    @property
    def name(self) -> str:
        return f"joints' return to the start pose within {np.rad2deg(self.tolerance_rad):g}°"

    @property
    def accuracy(self) -> str:
        return f"a cycle ends when the last joint is slower than {REST_RAD_S:g} rad/s, about 10 ms before it stands"

    @property
    def waiting(self) -> str:
        return "all joints at rest in the start pose"

    def places(self, signs: RobotSigns, before: RobotSigns) -> Ints:
        start = before.q_rad[0] if self.start_rad is None else np.array(self.start_rad)
        apart = np.abs(signs.q_rad - start)
        away = (apart > self.tolerance_rad).any(axis=1)
        back = (apart <= self.tolerance_rad).all(axis=1) & (np.abs(signs.qd_rad_s) <= REST_RAD_S).all(axis=1)
        return np.where(away, ON_PATH, np.where(back, WAITING, NEITHER))


def describe_source(settings: CycleSettings) -> tuple[str, str]:
    """Return what the configured source goes by, and how well it knows when a cycle starts and ends."""
    source = make_cycle_source(settings)
    return (source.name, source.accuracy) if source else ("robot's counter", COUNTER_ACCURACY)


def make_cycle_source(settings: CycleSettings) -> CycleSource | None:
    """Return the configured source; None where the program counts itself."""
    if settings.source == "digital_output":
        return DigitalOutput(settings.digital_output or 0, settings.digital_output_mode == "pulse")
    if settings.source == "joint_return":
        start = settings.start_joints_deg
        start_rad = None if start is None else tuple(float(angle) for angle in np.deg2rad(start))
        return JointReturn(float(np.deg2rad(settings.joint_tolerance_deg)), start_rad)
    return None


class _Counter:
    """Counts for a program that does not: the same place twice in a row changes nothing."""

    def __init__(self, ends_at_next: bool) -> None:
        self._ends_at_next = ends_at_next
        self._may_start = False
        self.count = -1
        """Cycles completed, -1 before the first program."""
        self.running = 0

    def restart(self) -> None:
        """Begin to count: a program starts to play."""
        self.count = self.running = 0
        self._may_start = False

    def halt(self) -> None:
        """End the cycle under way without counting it: the program is stopped."""
        self.running = 0

    def take(self, place: int) -> None:
        """Take the next sample of a program that plays or is paused."""
        if place == WAITING:
            self._may_start = True
            if self.running and not self._ends_at_next:
                self.running = 0
                self.count += 1
        elif place == ON_PATH and self._may_start:
            self._may_start = False
            self.count += self.running
            self.running = 1


def count_cycles(source: CycleSource, runtime_state: Ints, signs: RobotSigns) -> tuple[Ints, Ints]:
    """Return cycles completed and whether the robot is on its path, at each of n samples.

    Parameters
    ----------
    source : CycleSource
        How the robot shows its cycles.
    runtime_state : (n,)
        UR runtime states; -1 where unknown, which counts as playing.
    signs : RobotSigns
        The samples.
    """
    n = len(runtime_state)
    count, running = np.full(n, -1, dtype=np.int64), np.zeros(n, dtype=np.int64)
    stopped = np.isin(runtime_state, RUNTIME_STOPPED)
    begins = np.flatnonzero(~stopped & np.concatenate([[True], stopped])[:n])
    counter = _Counter(source.ends_at_next)
    for low, high in zip(begins, [*begins, n][1:], strict=True):
        before = _part(signs, slice(max(low - 1, 0), max(low, 1)))
        place = np.where(stopped[low:high], -1, source.places(_part(signs, slice(low, high)), before))
        counter.restart()
        counter.take(int(source.places(before, before)[0]))
        changes = np.flatnonzero(np.diff(place, prepend=-2))
        for first, stop in zip(changes, [*changes[1:], high - low], strict=True):
            _take(counter, int(place[first]))
            count[low + first : low + stop], running[low + first : low + stop] = counter.count, counter.running
    return count, running


def _take(counter: _Counter, place: int) -> None:
    if place < 0:
        counter.halt()
    else:
        counter.take(place)


def _part(signs: RobotSigns, rows: slice) -> RobotSigns:
    return RobotSigns(signs.digital_outputs[rows], signs.q_rad[rows], signs.qd_rad_s[rows])


class CycleFollower:
    """`count_cycles` while the samples come, one at a time."""

    def __init__(self, source: CycleSource) -> None:
        self._source = source
        self._counter = _Counter(source.ends_at_next)
        self._before: RobotSigns | None = None
        self._latest: RobotSigns | None = None
        self._stopped = True

    def complete(self, state: RobotState) -> RobotState:
        """Take the next sample; return it with the cycles completed and whether the robot is on its path."""
        signs = _signs_of(state)
        was_stopped, self._stopped = self._stopped, state.runtime_state in RUNTIME_STOPPED
        if self._stopped:
            self._counter.halt()
        else:
            if was_stopped or self._before is None:
                self._before = self._latest or signs
                self._counter.restart()
                self._counter.take(self._place_of(self._before))
            self._counter.take(self._place_of(signs))
        self._latest = signs
        return replace(state, cycle_count=self._counter.count, cycle_running=self._counter.running)

    def _place_of(self, signs: RobotSigns) -> int:
        return int(self._source.places(signs, self._before or signs)[0])


def _signs_of(state: RobotState) -> RobotSigns:
    outputs: Any = np.array([state.digital_outputs], dtype=np.uint64).astype(np.int64)
    return RobotSigns(outputs, np.array([state.q_rad]), np.array([state.qd_rad_s]))
