"""The robot's own program: waits for a grant, runs its path once, counts it, waits again."""

from __future__ import annotations

import threading
from dataclasses import dataclass

from bench.model import Vector6
from bench.simulation.path import JointPath, place_at_phase, rate_at_phase

__all__ = ["PULSE_PHASE", "Motion", "PathProgram"]

PULSE_PHASE = 0.1
"""A pulse of the program's digital output lasts this share of the cycle: long enough for 125 Hz in one of 0.2 s."""
SHORTEST_RETURN = 0.1
"""A return to the start of the path takes at least this share of a cycle."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Where the robot is at one instant."""

    q_rad: Vector6
    """Joint positions."""
    qd_rad_s: Vector6
    """Joint velocities."""
    tcp_pose: Vector6
    """Flange pose in the base frame: x, y, z (m), rotation vector (rad)."""
    tcp_speed: Vector6
    """Base frame, m/s and rad/s."""
    cycle_count: int
    """Cycles completed since the program started."""
    cycle_running: int
    """1 from the tick at which a cycle begins to the tick at which it is counted, else 0."""
    phase: float
    """Share of the cycle's duration that has passed, 0 to 1; 0 outside a cycle."""
    place: float = 0.0
    """Place on the path, 0 to 1, at rest too: `bench.simulation.path.place_at_phase` of the phase."""
    cycles_driven: float = 0.0
    """Cycles that the cable has gone through, whichever program drove them; of the one under way its share."""


@dataclass(frozen=True, slots=True)
class _Move:
    """From one place on the path to another, at rest at both ends."""

    start: float
    end: float
    duration_ns: float
    is_cycle: bool = False


class PathProgram:
    """A program on the controller that repeats one path, each time when it is granted.

    `play`, `pause` and `stop` may be called from any thread; they take effect at the next tick. A pause holds the
    pose at once (a real arm brakes for about a tenth of a second). Everything else belongs to the thread that ticks.

    Parameters
    ----------
    name : str
        Program name as the dashboard gives it.
    cycle_s : float
        Duration of one pass along the path at full speed, seconds of the clock.
    path : JointPath, optional
        Where the robot goes; left out, the path at amplitude 1.
    rest_s : float, optional
        Rest after each cycle, at full speed: what a program that waits for no grant needs, so that its end shows.
    """

    def __init__(
        self, name: str = "bend_test.urp", *, cycle_s: float = 2.0, path: JointPath | None = None, rest_s: float = 0.0
    ) -> None:
        self.name = name
        self.path = path or JointPath()
        self._cycle_ns = cycle_s * 1e9
        self._rest_ns = max(rest_s * 1e9, 1.0)
        self._lock = threading.Lock()
        self._state = "STOPPED"
        self._restart = False
        self._move = _Move(0.0, 0.0, 1.0)
        self._elapsed_ns = 1.0
        self._tick_ns: int | None = None
        self._rate = 0.0
        self._count = 0
        self._n_driven = 0

    @property
    def state(self) -> str:
        """'STOPPED', 'PLAYING' or 'PAUSED', as the dashboard's ``programState`` has it."""
        return self._state

    def play(self) -> None:
        """Start from the beginning after a stop (the count is 0 again), go on after a pause."""
        with self._lock:
            self._restart = self._restart or self._state == "STOPPED"
            self._state = "PLAYING"

    def pause(self) -> None:
        """Hold where the robot is; paused time does not advance the path."""
        with self._lock:
            if self._state == "PLAYING":
                self._state = "PAUSED"

    def stop(self) -> None:
        """End the program; the robot stays where it is, and the cycle under way is never counted."""
        with self._lock:
            self._state = "STOPPED"
            self._restart = False

    def reset(self) -> None:
        """Be as after start-up, the robot where it is: stopped, nothing counted. The thread that ticks."""
        self.stop()
        self._rest_here()
        self._count = 0

    def tick(self, host_ns: int, granted: int, speed_factor: float = 1.0) -> None:
        """Finish and begin what is due: one step of the controller.

        Parameters
        ----------
        host_ns : int
            Time of the tick, ascending from call to call.
        granted : int
            Cycles the program may have begun since it started.
        speed_factor : float
            Speed slider, 0 to 1, until the next tick.
        """
        self._advance(host_ns)
        with self._lock:
            state, restart, self._restart = self._state, self._restart, False
        if restart:
            self._begin_program()
        elif state == "STOPPED":
            self._rest_here()
        elif self._elapsed_ns >= self._move.duration_ns:
            self._next_move(granted if state == "PLAYING" else 0)
        self._rate = speed_factor if state == "PLAYING" else 0.0

    def motion_at(self, host_ns: int) -> Motion:
        """Return where the robot is at any instant since the last tick; at its end if the cycle is over by then."""
        move, phase = self._move, self._phase_at(host_ns)
        place = move.start + (move.end - move.start) * place_at_phase(phase)
        point = self.path.at(place)
        speed = (move.end - move.start) * rate_at_phase(phase) * self._rate / (move.duration_ns * 1e-9)
        q0, q1, q2, q3, q4, q5 = point.q_rad
        v0, v1, v2, v3, v4, v5 = point.q_rate
        s0, s1, s2, s3, s4, s5 = point.pose_rate
        x, y, z, rx, ry, rz = point.pose
        return Motion(
            (q0, q1, q2, q3, q4, q5),
            (v0 * speed, v1 * speed, v2 * speed, v3 * speed, v4 * speed, v5 * speed),
            (x, y, z, rx, ry, rz),
            (s0 * speed, s1 * speed, s2 * speed, s3 * speed, s4 * speed, s5 * speed),
            self._count,
            int(move.is_cycle),
            phase if move.is_cycle else 0.0,
            place,
            self._n_driven + (phase if move.is_cycle else 0.0),
        )

    def _phase_at(self, host_ns: int) -> float:
        since_tick = 0 if self._tick_ns is None else host_ns - self._tick_ns
        return min(max((self._elapsed_ns + since_tick * self._rate) / self._move.duration_ns, 0.0), 1.0)

    def _advance(self, host_ns: int) -> None:
        if self._tick_ns is not None:
            self._elapsed_ns += (host_ns - self._tick_ns) * self._rate
        self._tick_ns = host_ns

    def _place(self) -> float:
        phase = min(self._elapsed_ns / self._move.duration_ns, 1.0)
        return self._move.start + (self._move.end - self._move.start) * place_at_phase(phase)

    def _rest_here(self) -> None:
        self._set_move(_Move(self._place(), self._place(), 1.0), elapsed_ns=1.0)

    def _begin_program(self) -> None:
        """Count from 0, and go to the start of the path first if the last program was stopped half-way."""
        self._count = 0
        place = self._place()
        start = float(round(place))
        share = max(abs(start - place), SHORTEST_RETURN) if place != start else 0.0
        self._set_move(_Move(place, start, max(share * self._cycle_ns, 1.0)))

    def _next_move(self, granted: int) -> None:
        """Count a finished cycle; begin the next one a tick later at the earliest, so that both edges are seen."""
        if self._move.is_cycle:
            self._count += 1
            self._n_driven += 1
            self._set_move(_Move(0.0, 0.0, self._rest_ns))
        elif granted > self._count:
            self._set_move(_Move(0.0, 1.0, self._cycle_ns, is_cycle=True))

    def _set_move(self, move: _Move, elapsed_ns: float = 0.0) -> None:
        self._move = move
        self._elapsed_ns = elapsed_ns
