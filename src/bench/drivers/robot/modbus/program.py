"""Start and stop of the controller's own program, by commands that are acknowledged."""

from __future__ import annotations

from collections.abc import Callable

from bench.config import Command, ModbusRobotConfig, Signal
from bench.drivers.robot.modbus.link import ModbusLink
from bench.drivers.robot.modbus.samples import is_open, name_state, read_signals
from bench.drivers.robot.modbus.signals import Reading, SignalReader, write_signal
from bench.errors import BenchError, DeviceError, DeviceStateError, DeviceTimeoutError, LinkLostError
from bench.timing import Clock, patience_ns

__all__ = ["ModbusProgram"]

POLL_S = 0.05
"""Machine time between two looks at whether a command has had its effect."""
USUAL_LIMIT_S = 10.0
"""Where no command is mapped whose ack_timeout_s could tell."""


class ModbusProgram:
    """`ProgramControl` of a controller with a Modbus TCP server, over a connection of its own.

    Parameters
    ----------
    config : ModbusRobotConfig
        Address and register map.
    clock : Clock
        Paces waiting; all limits are in the machine's own seconds.
    """

    def __init__(self, config: ModbusRobotConfig, clock: Clock) -> None:
        self._config = config
        self._map = config.map
        self._clock = clock
        self._link = ModbusLink(config)
        self._reader = SignalReader(config.map, read_signals(config.map))
        self._is_open = False

    def open(self) -> None:
        """Connect. `ConnectError` if the controller cannot be reached."""
        self._link.connect()
        self._is_open = True

    def close(self) -> None:
        """Close the connection. May be called twice."""
        self._is_open = False
        self._link.close()

    @property
    def ready_when(self) -> str:
        """What `check` asks: the state, and the interlocks that are mapped."""
        interlocks = "".join(f", {interlock.name}" for interlock in self._map.interlock)
        return f"state stopped or waiting{interlocks}"

    def check(self, program: str) -> list[str]:
        """Return one sentence for each reason why `program` cannot be run now; empty if it can."""
        if self._config.observe_only:
            return [f"The {self._link.peer} is only observed ([robot] observe_only), so {program} cannot be started."]
        try:
            reading = self._read()
        except BenchError as error:
            return [str(error)]
        return [*self._state_reasons(reading), *self._interlock_reasons(reading)]

    def load(self, program: str) -> None:
        """Tell the controller the program's number, where one is mapped.

        Raises
        ------
        DeviceError
            It does not take the number.
        """
        number = self._map.program_number
        if number is None:
            return
        self._verify_driven(f"choose {program}")
        write_signal(self._link, self._map, number, number.value)
        if number.strobe is not None:
            self._give(number.strobe, f"program number {number.value}")

    def play(self) -> None:
        """Start the program, from its beginning; returns when it runs.

        Raises
        ------
        DeviceStateError
            bench only observes, an interlock is open, or the controller is in a fault.
        DeviceTimeoutError
            The command is not acknowledged, or has no effect in time.
        """
        self._verify_driven("start the program")
        reasons = self.check(self._config.program)
        if reasons:
            raise DeviceStateError(" ".join(reasons))
        commands = self._map.command
        if commands.stop is not None and commands.stop.hold == "level":
            write_signal(self._link, self._map, commands.stop, commands.stop.idle)
        if commands.reset is not None:
            self._give(commands.reset, "reset")
        if commands.start is not None:
            self._give(commands.start, "start")
        limit_s = commands.start.ack_timeout_s if commands.start else USUAL_LIMIT_S
        self._await(lambda reading: self._state(reading) in ("running", "waiting"), "start", limit_s)

    def stop(self) -> None:
        """Stop the program; returns when it has stopped. Raises like `play`."""
        self._verify_driven("stop the program")
        start, stop = self._map.command.start, self._map.command.stop
        if start is not None and start.hold == "level":
            write_signal(self._link, self._map, start, start.idle)
        if stop is not None:
            self._give(stop, "stop")
        limit_s = stop.ack_timeout_s if stop else USUAL_LIMIT_S
        self._await(lambda reading: self._state(reading) in ("stopped", "fault"), "stop", limit_s)

    def _verify_driven(self, what: str) -> None:
        if self._config.observe_only:
            raise DeviceStateError(f"The {self._link.peer} is only observed: bench cannot {what}.")
        if not self._is_open:
            raise LinkLostError(f"The {self._link.peer} cannot be told to {what}: the connection is not open.")

    def _read(self) -> Reading:
        return self._reader.read(self._link, self._clock)

    def _state(self, reading: Reading) -> str:
        return name_state(self._map, reading)

    def _state_reasons(self, reading: Reading) -> list[str]:
        state, peer = self._state(reading), self._link.peer
        code = f", fault code {reading.raw['fault_code']:g}" if "fault_code" in reading.raw else ""
        reasons = {
            "fault": f"The {peer} is in a fault (state {reading.raw['state']}{code}): clear it at the controller.",
            "paused": f"The program of the {peer} is paused: stop it at the controller.",
            "running": f"The program of the {peer} is in a cycle already: stop it at the controller.",
            "unknown": f"The {peer} shows state {reading.raw['state']}, which [robot.map.state] values does not list.",
        }
        return [reasons[state]] if state in reasons else []

    def _interlock_reasons(self, reading: Reading) -> list[str]:
        found = [(one, reading.values[f"interlock.{one.name}"]) for one in self._map.interlock]
        return [
            f"The interlock '{one.name}' of the {self._link.peer} is open: {value:g} where {one.must_be:g} is needed."
            for one, value in found
            if is_open(one.must_be, value)
        ]

    def _give(self, command: Command, name: str) -> None:
        """Write the command, wait for its acknowledge, and take a pulse back whatever happens."""
        write_signal(self._link, self._map, command, command.value)
        try:
            if command.hold == "pulse":
                self._pause(command.pulse_s)
            if command.ack is not None:
                self._await_value(command.ack, command.ack.value, name, command.ack_timeout_s)
        finally:
            if command.hold == "pulse":
                write_signal(self._link, self._map, command, command.idle)

    def _await_value(self, signal: Signal, value: float, name: str, limit_s: float) -> None:
        reader = SignalReader(self._map, {"ack": signal})
        self._wait(
            lambda: not is_open(value, reader.read(self._link, self._clock).values["ack"]), "acknowledge", name, limit_s
        )

    def _await(self, has_effect: Callable[[Reading], bool], name: str, limit_s: float) -> None:
        self._wait(lambda: has_effect(self._read()), "obey", name, limit_s)

    def _wait(self, is_done: Callable[[], bool], verb: str, name: str, limit_s: float) -> None:
        """Look until it is done; an answer that fails on the way is forgiven until the limit."""
        limit_ns = self._clock.now_ns() + patience_ns(self._clock, limit_s)
        last: DeviceError | None = None
        while self._clock.now_ns() < limit_ns:
            try:
                if is_done():
                    return
                last = None
            except DeviceError as error:
                last = error
            self._pause(POLL_S)
        if last is not None:
            raise last
        raise DeviceTimeoutError(
            f"The {self._link.peer} did not {verb} '{name}' within {limit_s:g} s.",
            hint="Look at the controller: is it in the mode in which it takes remote commands?",
        )

    def _pause(self, seconds: float) -> None:
        self._clock.sleep_until_ns(self._clock.now_ns() + patience_ns(self._clock, seconds))
