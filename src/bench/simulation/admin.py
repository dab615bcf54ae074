"""The admin channel of the simulated bench: faults on command, one a line, apart from the robot's own ports."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import get_args

from bench.config import SimulationConfig
from bench.simulation.modbus import ModbusController
from bench.simulation.natnet import NatNetServer
from bench.simulation.ur import UrController
from bench.simulation.ur.network import ServerThread
from bench.simulation.ur.outbox import Outbox
from bench.timing import Clock, patience_ns

__all__ = ["AdminServer"]

PATIENCE_S = 10.0
"""An admin who does not read the answers is cut off after it."""
LONGEST_LINE = 1000
LONGEST_S = 3600.0
MOST_TICKS = 1_000_000


@dataclass(frozen=True, slots=True)
class _Command:
    arguments: str
    """As `help` shows them; none or one, of which a NAME may have spaces."""
    meaning: str
    act: Callable[[str], Sequence[str] | None]
    """Returns the lines of an answer that has some."""

    def takes(self, n_words: int) -> bool:
        """Whether so many words may follow the command."""
        return n_words >= 1 if self.arguments == "NAME" else n_words == bool(self.arguments)


class AdminServer:
    """Serves the admin port. `open` and `close` as the devices have it.

    Parameters
    ----------
    host, port : str, int
        Where to listen: the robot's address, and a port that is none of the robot's.
    robot, tracker : UrController or ModbusController, NatNetServer
        What obeys.
    clock : Clock
        For the limits.
    """

    def __init__(
        self, host: str, port: int, robot: UrController | ModbusController, tracker: NatNetServer, clock: Clock
    ) -> None:
        self._address = (host, port)
        self._clock = clock
        robot_commands = _ur_commands(robot) if isinstance(robot, UrController) else _plc_commands(robot)
        self._commands = robot_commands | _tracker_commands(tracker)
        self._network: ServerThread | None = None

    def open(self) -> None:
        """Listen. `ConnectError` if the port is in use."""
        network = ServerThread(patience_ns(self._clock, PATIENCE_S))
        try:
            network.listen(*self._address, lambda outbox: _AdminSession(outbox, self._commands))
        except BaseException:
            network.close()
            raise
        self._network = network
        network.start()

    def close(self) -> None:
        """Stop listening. May be called twice."""
        if self._network is not None:
            self._network.close()


class _AdminSession:
    """One admin."""

    def __init__(self, outbox: Outbox, commands: dict[str, _Command]) -> None:
        self._outbox = outbox
        self._commands = commands
        self._line = b""

    def receive(self, data: bytes) -> bool:
        """Obey each whole line; False when the line never ends."""
        *lines, self._line = (self._line + data).split(b"\n")
        for line in lines:
            self._outbox.send(f"{self._answer(line.decode(errors='replace').split())}\n".encode())
        return len(self._line) <= LONGEST_LINE

    def close(self) -> None:
        """Forget the admin, for whom nothing is kept; what was commanded stays."""

    def _answer(self, words: list[str]) -> str:
        if words == ["help"]:
            return "\n".join([*(_describe(name, command) for name, command in self._commands.items()), "ok"])
        command = self._commands.get(words[0]) if words else None
        if command is None:
            return f"error: there is no '{' '.join(words)[:80]}'; 'help' lists the commands"
        if not command.takes(len(words) - 1):
            return f"error: '{f'{words[0]} {command.arguments}'.strip()}' is expected"
        try:
            lines = command.act(" ".join(words[1:]))
        except (ValueError, RuntimeError, TimeoutError) as error:
            return f"error: {error or 'the simulated bench does not run'}"
        return "\n".join([*(lines or ()), "ok"])


def _describe(name: str, command: _Command) -> str:
    return f"{f'{name} {command.arguments}'.strip():<24} {command.meaning}"


def _ur_commands(robot: UrController) -> dict[str, _Command]:
    return _link_commands(robot) | _machine_commands(robot)


def _link_commands(robot: UrController) -> dict[str, _Command]:
    return {
        "stall": _Command(
            "SECONDS",
            "nothing is sent, answered or accepted; the samples never come",
            lambda text: robot.faults.stall(_seconds(text)),
        ),
        "burst": _Command(
            "SECONDS", "samples are held back, then delivered at once", lambda text: robot.faults.burst(_seconds(text))
        ),
        "delay": _Command(
            "SECONDS", "every sample comes so much later; 0 ends it", lambda text: robot.faults.delay(_seconds(text))
        ),
        "skip": _Command(
            "N", "the next N samples of the controller never come", lambda text: robot.faults.skip(_count(text))
        ),
        "fin": _Command("", "close all connections", lambda _: robot.faults.drop(abruptly=False)),
        "rst": _Command("", "break all connections", lambda _: robot.faults.drop(abruptly=True)),
        "half_open": _Command(
            "on|off", "accept new clients and never answer them", lambda text: robot.faults.set_half_open(_switch(text))
        ),
        "hold_register": _Command(
            "N", "input_int_register_N belongs to another client", lambda text: robot.faults.hold_register(_count(text))
        ),
        "release_register": _Command("N", "end that", lambda text: robot.faults.release_register(_count(text))),
        "reboot": _Command("", "as switched off and on: time 0, powered off, nothing loaded", lambda _: robot.reboot()),
    }


def _machine_commands(robot: UrController) -> dict[str, _Command]:
    machine = robot.machine

    def set_local(text: str) -> None:
        robot.remote_control = not _switch(text)

    def set_safeguard(text: str) -> None:
        robot.act(machine.safeguard_stop if _switch(text) else machine.safeguard_release)

    def move_slider(text: str) -> None:
        fraction = _fraction(text)
        robot.act(lambda _: machine.move_slider(fraction))

    return {
        "protective_stop": _Command("", "as after a collision", lambda _: robot.act(machine.protective_stop)),
        "safeguard_stop": _Command("on|off", "open or close the door", set_safeguard),
        "emergency_stop": _Command("", "press the red button", lambda _: robot.act(machine.emergency_stop)),
        "slider": _Command("FRACTION", "move the speed slider, 0 to 1", move_slider),
        "local": _Command("on|off", "local mode, on; remote control, off", set_local),
        "foreign_program": _Command(
            "NAME",
            "load another program at the pendant; ours ends",
            lambda name: robot.act(lambda _: machine.load_foreign(name)),
        ),
        "pause": _Command("", "pause the program at the pendant", lambda _: robot.act(machine.pause)),
        "resume": _Command("", "let it go on", lambda _: robot.act(machine.resume)),
        "told": _Command("", "list what clients commanded and granted so far", lambda _: list(machine.told)),
    }


def _plc_commands(robot: ModbusController) -> dict[str, _Command]:
    return _server_commands(robot) | _plc_machine_commands(robot)


def _server_commands(robot: ModbusController) -> dict[str, _Command]:
    faults = robot.faults
    return {
        "late": _Command(
            "SECONDS", "every answer comes so much late; 0 ends it", lambda text: faults.set_late(_seconds(text))
        ),
        "exception": _Command(
            "CODE", "every request is answered by this exception; 0 ends it", lambda text: faults.refuse(_count(text))
        ),
        "frozen": _Command(
            "on|off", "accept clients and requests, answer none", lambda text: faults.freeze(_switch(text))
        ),
        "fin": _Command("", "close all connections", lambda _: faults.drop()),
        "reboot": _Command(
            "", "as switched off and on: time and registers 0, program stopped", lambda _: faults.reboot()
        ),
    }


def _plc_machine_commands(robot: ModbusController) -> dict[str, _Command]:
    faults = robot.faults
    return {
        "fault": _Command(
            "CODE", "show this fault, program stopped; 0 clears it", lambda text: faults.set_fault(_count(text))
        ),
        "open_interlock": _Command("NAME", "open an interlock of the map", faults.open_interlock),
        "close_interlock": _Command("NAME", "put it in order", faults.close_interlock),
        "heartbeat": _Command(
            "on|off", "let the controller's heartbeat go on or stand", lambda text: faults.set_heartbeat(_switch(text))
        ),
        "override": _Command(
            "FRACTION", "change the speed override, 0 to 1", lambda text: faults.set_override(_fraction(text))
        ),
        "show_state": _Command(
            "N|off",
            "show this in the state register, whatever the program does",
            lambda text: faults.show_state(None if text == "off" else _count(text)),
        ),
        "counter": _Command("N", "the cycle counter goes on from N", lambda text: faults.set_counter(_count(text))),
        "pause": _Command("", "pause the program at the panel", lambda _: faults.pause()),
        "resume": _Command("", "let it go on", lambda _: faults.resume()),
        "stop": _Command("", "stop it at the panel", lambda _: faults.stop()),
    }


def _tracker_commands(tracker: NatNetServer) -> dict[str, _Command]:
    def restart(_text: str) -> None:
        tracker.act(tracker.restart)

    def change_version(name: str) -> None:
        known = get_args(SimulationConfig.model_fields["natnet_version"].annotation)
        if name not in known:
            raise ValueError(f"'{name}' is none of {', '.join(known)}")
        tracker.act(lambda: tracker.change_version(name))

    def jump(text: str) -> None:
        n_numbers = _count(text)
        tracker.act(lambda: tracker.jump(n_numbers))

    def lose(text: str) -> None:
        tracker.delivery.lose_next = _count(text)

    def double(text: str) -> None:
        tracker.delivery.double_next = _count(text)

    return {
        "tracker_stall": _Command(
            "SECONDS",
            "the tracker sends and answers nothing; the frames never come",
            lambda text: tracker.stall(_seconds(text)),
        ),
        "tracker_restart": _Command("", "as switched off and on: another clock and other frame numbers", restart),
        "tracker_version": _Command("X.Y", "speak another NatNet version, to everyone at once", change_version),
        "tracker_body": _Command(
            "NAME", "define a rigid body that no camera sees", lambda name: tracker.act(lambda: tracker.add_body(name))
        ),
        "tracker_jump": _Command("N", "leave out N frame numbers", jump),
        "tracker_lose": _Command("N", "the next N frames get lost on their way", lose),
        "tracker_double": _Command("N", "the next N frames come twice", double),
    }


def _seconds(text: str) -> float:
    return _number(text, 0.0, LONGEST_S, "seconds of the machine's own time")


def _fraction(text: str) -> float:
    return _number(text, 0.0, 1.0, "a fraction")


def _number(text: str, low: float, high: float, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not low <= value <= high:
        raise ValueError(f"'{text}' is not {what} from {low:g} to {high:g}")
    return value


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) > MOST_TICKS:
        raise ValueError(f"'{text}' is not a number from 0 to {MOST_TICKS}")
    return int(text)


def _switch(text: str) -> bool:
    if text not in ("on", "off"):
        raise ValueError(f"'{text}' is neither 'on' nor 'off'")
    return text == "on"
