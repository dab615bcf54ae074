"""The dashboard server: one line in, one line out; the reply comes before the effect.

Replies are those of PolyScope 5 (Universal Robots, Dashboard Server e-Series).
"""

from __future__ import annotations

from collections.abc import Callable

from bench.simulation.outbox import Outbox
from bench.simulation.ur.machine import Machine

__all__ = ["EFFECT_DELAY_NS", "DashboardSession", "Effect"]

Effect = Callable[[int], None]

BANNER = "Connected: Universal Robots Dashboard Server"
NOT_REMOTE = (
    "Command is not allowed due to safety reasons, "
    "please switch robot to Remote Control mode and reconnect to port 29999"
)
UNLOCK_TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
)
PROGRAM_FOLDER = "/programs/"
SERIAL_NUMBER = "20235500042"
EFFECT_DELAY_NS = 40_000_000
"""From a reply to its effect. A real controller takes 20 to 200 ms; 40 ms is 20 ticks."""
LONGEST_LINE = 4096


class DashboardSession:
    """One client of the dashboard.

    Parameters
    ----------
    machine : Machine
        The robot.
    outbox : Outbox
        Takes the replies.
    has_control : bool
        Whether the robot was in remote control when the client connected; that decides for the whole connection.
    schedule : callable
        Runs an effect on the scheduler's thread after a delay (ns).
    now_ns : callable
        Host time.
    is_remote : callable
        Whether the robot is in remote control now.
    """

    def __init__(
        self,
        machine: Machine,
        outbox: Outbox,
        schedule: Callable[[int, Effect], None],
        now_ns: Callable[[], int],
        is_remote: Callable[[], bool],
    ) -> None:
        self._machine = machine
        self._outbox = outbox
        self._schedule = schedule
        self._now_ns = now_ns
        self._is_remote = is_remote
        self._has_control = is_remote() or not machine.kind.has_remote_control
        self._line = b""
        self._queries = self._make_queries()
        self._commands = self._make_commands()
        self._say(BANNER)

    def receive(self, data: bytes) -> bool:
        """Answer each whole line; False when the client quits or speaks no dashboard. The network's thread."""
        *lines, self._line = (self._line + data).split(b"\n")
        for line in lines:
            text = line.decode(errors="replace").strip()
            if text.lower() in ("quit", "exit"):
                self._say("Disconnected")
                return False
            self._say(self._answer(text))
        return len(self._line) <= LONGEST_LINE

    def close(self) -> None:
        """Forget the client, for which nothing is kept."""

    def _say(self, text: str) -> None:
        self._outbox.send(f"{text}\n".encode())

    def _answer(self, text: str) -> str:
        command = " ".join(text.lower().split())
        if command in self._queries:
            return self._queries[command]()
        is_load = command.startswith("load ")
        if not is_load and command not in self._commands:
            return f"could not understand: '{text}'"
        if not self._has_control:
            return NOT_REMOTE
        self._machine.told.append(text)
        return self._load(text.split(maxsplit=1)[1]) if is_load else self._commands[command]()

    def _make_queries(self) -> dict[str, Callable[[], str]]:
        machine = self._machine
        major, minor, bugfix, build = machine.kind.version
        queries: dict[str, Callable[[], str]] = {
            "running": lambda: f"Program running: {str(machine.state == 'PLAYING').lower()}",
            "programstate": self._program_state,
            "robotmode": lambda: f"Robotmode: {machine.robot_mode.name}",
            "safetymode": lambda: f"Safetymode: {machine.safety_status.name}",
            "safetystatus": lambda: f"Safetystatus: {machine.safety_status.name}",
            "get loaded program": self._loaded_program,
            "is in remote control": lambda: str(self._is_remote()).lower(),
            "polyscopeversion": lambda: f"URSoftware {major}.{minor}.{bugfix}.{build} (Aug 30 2023)",
            "get serial number": lambda: SERIAL_NUMBER,
            "get robot model": lambda: "UR5",
        }
        if not machine.kind.has_remote_control:
            del queries["is in remote control"]
        return queries

    def _make_commands(self) -> dict[str, Callable[[], str]]:
        machine = self._machine
        return {
            "play": self._play,
            "pause": self._pause,
            "stop": self._stop,
            "power on": lambda: self._later(machine.power_on, "Powering on"),
            "power off": lambda: self._later(machine.power_off, "Powering off"),
            "brake release": lambda: self._later(machine.release_brakes, "Brake releasing"),
            "unlock protective stop": self._unlock,
            "close safety popup": lambda: "closing safety popup",
            "close popup": lambda: "closing popup",
            "restart safety": lambda: self._later(machine.restart_safety, "Restarting safety"),
        }

    def _later(self, effect: Effect, reply: str) -> str:
        self._schedule(EFFECT_DELAY_NS, effect)
        return reply

    def _program_state(self) -> str:
        return f"{self._machine.state} {self._machine.loaded_name or '<unnamed>'}"

    def _loaded_program(self) -> str:
        if not self._machine.loaded_name:
            return "No program loaded"
        return f"Loaded program: {PROGRAM_FOLDER}{self._machine.loaded_name}"

    def _load(self, name: str) -> str:
        if name.removeprefix(PROGRAM_FOLDER) != self._machine.program.name:
            return f"File not found: {name}"
        if self._machine.state != "STOPPED":
            return f"Error while loading program: {name}"
        return self._later(self._machine.load, f"Loading program: {name}")

    def _play(self) -> str:
        if not self._machine.can_play:
            return "Failed to execute: play"
        return self._later(self._machine.play, "Starting program")

    def _pause(self) -> str:
        if self._machine.program.state != "PLAYING":
            return "Failed to execute: pause"
        return self._later(self._machine.pause, "Pausing program")

    def _stop(self) -> str:
        if self._machine.state == "STOPPED":
            return "Failed to execute: stop"
        return self._later(self._machine.stop, "Stopped")

    def _unlock(self) -> str:
        if not self._machine.can_unlock(self._now_ns()):
            return UNLOCK_TOO_EARLY
        return self._later(self._machine.unlock, "Protective stop releasing")
