"""From polls to `RobotState`: what the run understands of a register map, NaN and -1 for what is not mapped."""

from __future__ import annotations

import math

from bench.config import RegisterMap, Signal, TimeSignal
from bench.drivers.base import RecordSink
from bench.drivers.robot.modbus.codec import wrap_to_type
from bench.drivers.robot.modbus.counters import CounterUnwrapper, TimeUnwrapper
from bench.drivers.robot.modbus.signals import Reading
from bench.model import NAN6, NO_BITS, LogEntry, RobotState, Severity, Vector6

__all__ = ["SampleMaker", "is_open", "name_state", "read_signals"]

RUNTIME_STATES = {"running": 2, "waiting": 2, "paused": 4, "stopped": 1, "fault": 1}
"""As a UR says it (see `RobotState.runtime_state`), which is what the run understands."""
NORMAL, SAFEGUARD, FAULT = 1, 5, 9
"""Safety states in the same words."""
INTERLOCK_TOLERANCE = 1e-6
NAN = float("nan")


def read_signals(register_map: RegisterMap) -> dict[str, Signal]:
    """Return the signals that every poll reads, by name."""
    written = ("grant", "program_number", "heartbeat_out", "command.")
    return {name: signal for name, signal in register_map.signals.items() if not name.startswith(written)}


def name_state(register_map: RegisterMap, reading: Reading) -> str:
    """Return `running`, `waiting`, `stopped`, `paused`, `fault` or `unknown`."""
    signal, raw = register_map.state, reading.raw["state"]
    value = int(raw) & signal.mask if signal.mask else raw
    return signal.values.names.get(int(value), "unknown") if value == int(value) else "unknown"


def is_open(must_be: float, value: float) -> bool:
    """Tell whether an interlock forbids the run."""
    return not math.isclose(value, must_be, abs_tol=INTERLOCK_TOLERANCE)


class SampleMaker:
    """Makes one `RobotState` of each reading and says what is remarkable; belongs to the polling thread.

    Parameters
    ----------
    register_map : RegisterMap
    peer : str
        The controller, for messages.
    sink : RecordSink
        Where log entries go.
    origin_ns : int
        Host time from which the time of a controller without a clock of its own is counted.
    """

    def __init__(self, register_map: RegisterMap, peer: str, sink: RecordSink, origin_ns: int) -> None:
        self._map = register_map
        self._peer = peer
        self._sink = sink
        self._origin_ns = origin_ns
        self._counter = CounterUnwrapper(register_map.cycle_counter.n_counts)
        self._time = _make_time(register_map.controller_time)
        self._last_ns: int | None = None
        self._n_reconnects = 0
        self._base = 0
        self._on_path = 0
        self._count: int | None = None
        self._said: dict[str, object] = {"state": None, "fault_code": 0}

    def reconnected(self) -> None:
        """Begin a new clock segment."""
        self._n_reconnects += 1

    def count_from_here(self) -> None:
        """Let the cycles of a counter that counts on begin at 0 with the next one."""
        if not self._map.cycle_counter.restarts:
            self._base = self._counter.count

    def grant_value(self, total: int) -> int:
        """Return what is written so that `total` cycles may have begun: what the counter shows when they are over."""
        grant = self._map.grant
        value = (self._base + total) % self._map.cycle_counter.n_counts
        return value if grant is None or grant.type.startswith("f") else wrap_to_type(grant.type, value)

    def make(self, reading: Reading, number: int) -> RobotState:
        """Return the state that goes with one reading; `number` counts the polls, answered or not."""
        mapped = self._map
        state = name_state(mapped, reading)
        capture_ns = (reading.before_ns + reading.after_ns) // 2
        time_s = self._controller_time_s(reading, capture_ns)
        count = self._counter.take(int(reading.raw["cycle_counter"]))
        if not mapped.cycle_counter.restarts and count < self._base:
            self._base = 0  # the counter was set anew
        # Where the count went up, the next cycle has not been granted yet: what else the registers say is older.
        has_counted, self._count = self._count is not None and count > self._count, count
        self._on_path = 0 if has_counted else self._find_on_path(reading, state)
        open_names = self._find_open(reading)
        self._tell_changes(reading, state, open_names, capture_ns)
        return RobotState(
            arrival_ns=reading.after_ns,
            capture_ns=capture_ns,
            sequence=number,
            segment=self._n_reconnects + (self._time.n_restarts if self._time else 0),
            controller_time_s=time_s,
            q_rad=self._joints(reading),
            qd_rad_s=_vector(reading, "joint_speeds", 6),
            tcp_pose=_join(_numbers(reading, "tcp_position", 3), _numbers(reading, "tcp_rotation", 3)),
            speed_fraction=reading.values.get("speed_override", NAN),
            runtime_state=RUNTIME_STATES.get(state, -1),
            safety_status=FAULT if state == "fault" else SAFEGUARD if open_names else NORMAL,
            digital_inputs=self._interlock_bits(reading),
            cycle_count=count - self._base,
            cycle_running=self._on_path,
            cycle_phase=reading.values.get("phase", NAN),
        )

    def _controller_time_s(self, reading: Reading, capture_ns: int) -> float:
        before_ns, self._last_ns = self._last_ns, capture_ns
        if self._time is None:
            return (capture_ns - self._origin_ns) * 1e-9
        elapsed_s = 0.0 if before_ns is None else (capture_ns - before_ns) * 1e-9
        n_before = self._time.n_restarts
        time_s = self._time.take(reading.raw["controller_time"], elapsed_s)
        if self._time.n_restarts > n_before:
            self._counter.begin_anew()
        return time_s

    def _find_on_path(self, reading: Reading, state: str) -> int:
        if self._map.cycle_running is not None:
            return int(reading.raw["cycle_running"] != 0)
        return self._on_path if state in ("paused", "unknown") else int(state == "running")

    def _find_open(self, reading: Reading) -> list[str]:
        always = [interlock for interlock in self._map.interlock if interlock.when == "always"]
        return [i.name for i in always if is_open(i.must_be, reading.values[f"interlock.{i.name}"])]

    def _interlock_bits(self, reading: Reading) -> int:
        """Return one bit for each interlock in the map's order, set while it is as it must be."""
        if not self._map.interlock:
            return NO_BITS
        held = [not is_open(one.must_be, reading.values[f"interlock.{one.name}"]) for one in self._map.interlock]
        return sum(1 << bit for bit, holds in enumerate(held) if holds)

    def _joints(self, reading: Reading) -> Vector6:
        turns = _vector(reading, "joint_turns", 6) if self._map.joint_turns else (0.0,) * 6
        joints = _vector(reading, "joints", 6)
        q0, q1, q2, q3, q4, q5 = (q + 2 * math.pi * n for q, n in zip(joints, turns, strict=True))
        return q0, q1, q2, q3, q4, q5

    def _tell_changes(self, reading: Reading, state: str, open_names: list[str], host_ns: int) -> None:
        if self._is_news("state", state == "unknown" and reading.raw["state"]) and state == "unknown":
            text = f"shows state {reading.raw['state']}, which [robot.map.state] values does not list"
            self._say(Severity.WARN, text, host_ns)
        code = reading.raw.get("fault_code", 0)
        if self._is_news("fault_code", code):
            self._say(Severity.ERROR if code else Severity.INFO, f"shows fault code {code:g}", host_ns)
        for interlock in self._map.interlock:
            is_out = interlock.name in open_names
            if self._is_news(f"interlock {interlock.name}", is_out) and (is_out or interlock.when == "always"):
                said = "open" if is_out else "in order"
                severity = Severity.WARN if is_out else Severity.INFO
                self._say(severity, f"shows the interlock '{interlock.name}' {said}", host_ns)

    def _is_news(self, what: str, value: object) -> bool:
        before, self._said[what] = self._said.get(what), value
        return before != value

    def _say(self, severity: Severity, text: str, host_ns: int) -> None:
        self._sink(LogEntry(host_ns, severity, "robot", f"The {self._peer} {text}."))


def _make_time(signal: TimeSignal | None) -> TimeUnwrapper | None:
    if signal is None:
        return None
    return TimeUnwrapper(0 if signal.type.startswith("f") else int(signal.type[1:]), signal.tick_s)


def _numbers(reading: Reading, name: str, n: int) -> list[float]:
    return [reading.values.get(f"{name}.{i}", NAN) for i in range(n)]


def _vector(reading: Reading, name: str, n: int) -> Vector6:
    return _join(_numbers(reading, name, n), [])


def _join(first: list[float], second: list[float]) -> Vector6:
    a, b, c, d, e, f = first + second
    return (a, b, c, d, e, f) if not all(math.isnan(x) for x in (a, b, c, d, e, f)) else NAN6
