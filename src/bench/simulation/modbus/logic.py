"""What a simulated Modbus controller does in each scan: take commands, drive its program, show its state."""

from __future__ import annotations

import math

from bench.config import Command, ModbusRobotConfig, StateSignal
from bench.simulation.device_clock import DeviceClock
from bench.simulation.modbus.tables import Tables
from bench.simulation.program import Motion, PathProgram
from bench.timing import Clock, patience_ns

__all__ = ["PlcLogic"]

BEATS_MISSED = 4
"""Periods of bench's heartbeat after which the controller pauses its program, as its builder promised."""
BEATS_PER_AGE = 4
"""Changes of the controller's heartbeat in the time it may stand still: slower than any poll, which would miss some."""


class PlcLogic:
    """The controller's own program around the robot's path.

    Parameters
    ----------
    config : ModbusRobotConfig
        The register map.
    program : PathProgram
        What it starts and stops; shared with the scene.
    tables : Tables
        Its memory.
    clock : Clock
        For how long a heartbeat may be missing.
    controller_clock : DeviceClock
        Its own time.
    count_before : int
        Where a counter that counts on stood when it was switched on.
    """

    def __init__(
        self,
        config: ModbusRobotConfig,
        program: PathProgram,
        tables: Tables,
        clock: Clock,
        controller_clock: DeviceClock,
        count_before: int,
    ) -> None:
        self._map = config.map
        self.program = program
        self._tables = tables
        self._clock = clock
        self._controller_clock = controller_clock
        self._count_before = 0 if config.map.cycle_counter.restarts else count_before
        self._last_count = 0
        self._given: dict[str, bool] = {}
        self._beat: tuple[float, int] | None = None
        self.fault_code = 0
        """Not 0: the controller shows a fault and its program is stopped."""
        self.open_interlocks: set[str] = set()
        """Names of the interlocks that are open."""
        self.beats = True
        """False: the controller's own heartbeat stands still."""

    def scan(self, due_ns: int) -> None:
        """One scan; on the scheduler's thread, at ascending times."""
        with self._tables.scan():
            self._scan(due_ns)

    def _scan(self, due_ns: int) -> None:
        self._take_commands()
        if self.fault_code:
            self.program.stop()
        self._watch_heartbeat()
        self.program.tick(due_ns, self._granted())
        self._show(self.program.motion_at(due_ns), due_ns)

    def _take_commands(self) -> None:
        commands, program = self._map.command, self.program
        if self._is_given("stop", commands.stop):
            program.stop()
        if self._is_given("start", commands.start) and not self.fault_code:
            program.play()
        if commands.start is not None and commands.start.hold == "level" and not self._holds(commands.start):
            program.stop()
        self._is_given("reset", commands.reset)
        number = self._map.program_number
        if number is not None:
            self._is_given("strobe", number.strobe)

    def _is_given(self, name: str, command: Command | None) -> bool:
        """Acknowledge a command for as long as it stands; tell whether it was given since the last scan."""
        if command is None:
            return False
        before, now = self._given.get(name, False), self._holds(command)
        self._given[name] = now
        if command.ack is not None:
            self._tables.set(command.ack, command.ack.value if now else 0.0)
        return now and not before

    def _holds(self, command: Command) -> bool:
        return self._tables.get(command) == command.value

    def _watch_heartbeat(self) -> None:
        signal = self._map.heartbeat_out
        if signal is None:
            return
        value, now_ns = self._tables.get(signal), self._clock.now_ns()
        if self._beat is None and value == 0.0:
            return
        if self._beat is None or value != self._beat[0]:
            self._beat = (value, now_ns)
        elif now_ns - self._beat[1] > patience_ns(self._clock, BEATS_MISSED * signal.period_s):
            self.program.pause()

    def _granted(self) -> int:
        """Return how many cycles the program may have begun, from a register that may have wrapped."""
        signal, count = self._map.grant, self._last_count
        if signal is None:
            return 0
        granted = self._tables.get(signal) - self._count_before
        if signal.type.startswith("f"):
            return int(granted)
        n_bits = int(signal.type[1:])
        ahead = int(granted - count) % (1 << n_bits)
        return count + ahead if ahead < 1 << (n_bits - 1) else count

    def _show(self, motion: Motion, due_ns: int) -> None:
        tables, mapped = self._tables, self._map
        if motion.cycle_count < self._last_count and not mapped.cycle_counter.restarts:
            self._count_before += self._last_count  # the program was started again, the counter was not
        self._last_count = motion.cycle_count
        shown: dict[str, float] = {
            "cycle_counter": self._count_before + motion.cycle_count,
            "cycle_running": motion.cycle_running,
            "phase": motion.phase,
            "fault_code": self.fault_code,
            "speed_override": 1.0,
            "heartbeat_in": self._own_beat(),
        }
        for name, value in shown.items():
            signal = getattr(mapped, name)
            if signal is not None:
                tables.set(signal, value)
        tables.set(mapped.state, self._state_value(mapped.state, motion))
        if mapped.controller_time is not None:
            seconds = self._controller_clock.ticks_at(due_ns) / self._controller_clock.ticks_per_s
            tables.set(mapped.controller_time, seconds / mapped.controller_time.tick_s)
        for interlock in mapped.interlock:
            is_open = interlock.name in self.open_interlocks
            tables.set(interlock, float(not interlock.must_be) if is_open else interlock.must_be)
        self._show_vectors(motion)

    def _own_beat(self) -> int:
        signal = self._map.heartbeat_in
        if signal is None or not self.beats:
            return 0
        return self._clock.now_ns() // patience_ns(self._clock, signal.max_age_s / BEATS_PER_AGE) % 2

    def _state_value(self, signal: StateSignal, motion: Motion) -> float:
        values, state = signal.values, self.program.state
        if self.fault_code and values.fault:
            return values.fault[0]
        if state == "PAUSED" and values.paused:
            return values.paused[0]
        if state == "STOPPED":
            return values.stopped[0]
        return values.running[0] if motion.cycle_running or not values.waiting else values.waiting[0]

    def _show_vectors(self, motion: Motion) -> None:
        turns = [math.floor(q / (2 * math.pi)) for q in motion.q_rad]
        with_turns = self._map.joint_turns is not None
        joints = [q - 2 * math.pi * n if with_turns else q for q, n in zip(motion.q_rad, turns, strict=True)]
        vectors: dict[str, tuple[float, ...] | list[float] | list[int]] = {
            "joints": joints,
            "joint_turns": turns,
            "joint_speeds": motion.qd_rad_s,
            "tcp_position": motion.tcp_pose[:3],
            "tcp_rotation": motion.tcp_pose[3:],
        }
        for name, values in vectors.items():
            signal = getattr(self._map, name)
            if signal is not None:
                for i, value in enumerate(values):
                    self._tables.set(signal, value, i)
