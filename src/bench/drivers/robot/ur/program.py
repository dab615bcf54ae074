"""Load, play and stop the robot's own program, by the dashboard server of a UR controller.

ur_rtde's dashboard client does the talking (it refuses wrong replies and has time limits); it is imported here only.
Where it has no build (Python 3.13 and newer, other systems than Linux) a plain socket of our own speaks the same lines.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from bench.config import RobotConfig
from bench.drivers.robot.ur.dashboard_line import LONGEST_REPLY, LineDashboard
from bench.drivers.robot.ur.effect import USUAL_LIMITS, EffectLimits, wait_for_effect
from bench.drivers.robot.ur.readiness import mode_reason, running_reason, safety_reason
from bench.drivers.robot.ur.words import one_line
from bench.errors import ConnectError, DeviceError, DeviceStateError, DeviceTimeoutError, LinkLostError
from bench.timing import Clock

__all__ = ["UrDashboardProgram"]

CONNECT_TIMEOUT_MS = 2000
REMOTE_CONTROL_SINCE = (5, 6)
"""First software with remote control (dashboard server manual); CB3 has none."""
SAFETY_STATUS_SINCE = (5, 4)
REMOTE_HINT = "Switch the robot to Remote Control on the teach pendant, then start again."
# What ur_rtde's RuntimeError says when its own 2.5 s limit on an answer passes (measured with 1.6.5).
TIMED_OUT = "operation canceled"


class UrDashboardProgram:
    """`ProgramControl` of a Universal Robots controller, by its dashboard server.

    Parameters
    ----------
    config : RobotConfig
        Address of the controller.
    clock : Clock
        Paces the polling; limits are in the machine's own seconds.
    limits : EffectLimits, optional
        How long the effect of a command, and of loading, may take.
    """

    def __init__(self, config: RobotConfig, clock: Clock, limits: EffectLimits = USUAL_LIMITS) -> None:
        self._peer = f"controller {config.host}"
        self._host = config.host
        self._clock = clock
        self._limits = limits
        self._lock = threading.RLock()
        self._client: Any = None
        self._is_open = False
        self.version: tuple[int, ...] = ()
        """Version of the controller's software, such as (5, 15, 0, 126652)."""

    def open(self) -> None:
        """Connect to the dashboard server and ask for its version.

        Raises
        ------
        ConnectError
            The controller has no dashboard server that answers.
        """
        with self._lock:
            self._connect()
            self._is_open = True
            try:
                text = self._call("PolyscopeVersion", "polyscopeVersion")
            except DeviceError as error:
                self.close()
                raise ConnectError(
                    f"The dashboard server of {self._peer} does not tell its version.",
                    hint="Wait until the robot has started.",
                ) from error
            self.version = tuple(int(part) for part in re.findall(r"[0-9]{1,9}", str(text))[:4])

    def _connect(self) -> None:
        self._disconnect()
        client = _make_client(self._host, self._clock)
        try:
            client.connect(CONNECT_TIMEOUT_MS)
        except Exception as error:
            raise ConnectError(
                f"The dashboard server of {self._peer} (port 29999) does not answer: {_as_clause(error)}.",
                hint="Check that the robot has started; PolyScope X needs [robot] program_control = 'robot_api'.",
            ) from error
        self._client = client

    @property
    def ready_when(self) -> str:
        """What `check` asks; a controller without remote control cannot be asked for it."""
        usual = "safety normal, powered on, program stopped"
        return f"remote control, {usual}" if self.version >= REMOTE_CONTROL_SINCE else usual

    def check(self, program: str) -> list[str]:
        """Return one sentence for each reason why `program` cannot be run now; empty if it can.

        Raises
        ------
        LinkLostError, DeviceTimeoutError
            The controller does not answer any more.
        """
        with self._lock:
            found = [self._check_remote(), self._check_safety(), self._check_mode(), self._check_running(program)]
        return [sentence for sentence in found if sentence]

    def _check_remote(self) -> str:
        if self.version < REMOTE_CONTROL_SINCE or self._call("is in remote control", "isInRemoteControl"):
            return ""
        return f"The {self._peer} is not in remote control. {REMOTE_HINT}"

    def _check_safety(self) -> str:
        question = "safetystatus" if self.version >= SAFETY_STATUS_SINCE else "safetymode"
        return safety_reason(self._peer, "status", _after_colon(self._call(question, question)))

    def _check_mode(self) -> str:
        return mode_reason(self._peer, _after_colon(self._call("robotmode", "robotmode")))

    def _check_running(self, program: str) -> str:
        state, name = self._program_state()
        return running_reason(self._peer, state, name, is_ours=_is_same(name, program))

    def load(self, program: str) -> None:
        """Load a program and wait until the controller has it.

        Raises
        ------
        DeviceStateError
            The controller has no such program, or does not allow it.
        DeviceTimeoutError
            It is not loaded within the limit.
        """
        with self._lock:
            # The reply may come when everything is loaded, which can outlast ur_rtde's limit on an answer.
            with suppress(DeviceTimeoutError):
                self._call(f"load {program}", "loadURP", program)
            self._wait(lambda: self._has_loaded(program), f"load '{program}'", self._limits.load_s)

    def tell_loaded(self) -> dict[str, str]:
        """Return the path of the loaded program on the controller: the dashboard tells nothing of its content."""
        with self._lock:
            return {"loaded": self._loaded()}

    def play(self) -> None:
        """Start the loaded program, or resume it after a pause, and wait until it plays."""
        with self._lock:
            self._call("play", "play")
            self._wait_for("PLAYING", "play")

    def stop(self) -> None:
        """Stop the program, if it is not stopped already, and wait until it is."""
        with self._lock:
            if self._program_state()[0] == "STOPPED":
                return
            self._call("stop", "stop")
            self._wait_for("STOPPED", "stop")

    def close(self) -> None:
        """Disconnect. May be called twice, and after an error."""
        with self._lock:
            self._is_open = False
            self._disconnect()

    def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            with suppress(Exception):
                client.disconnect()

    def _program_state(self) -> tuple[str, str]:
        state, _, name = str(self._call("programState", "programState")).partition(" ")
        return state, name.strip()

    def _has_loaded(self, program: str) -> bool:
        return _is_same(self._loaded(), program)

    def _loaded(self) -> str:
        return _after_colon(self._call("get loaded program", "getLoadedProgram"))

    def _wait_for(self, state: str, command: str) -> None:
        self._wait(lambda: self._program_state()[0] == state, command, self._limits.command_s)

    def _wait(self, is_reached: Callable[[], bool], command: str, limit_s: float) -> None:
        wait_for_effect(self._clock, self._peer, command, is_reached, limit_s)

    def _call(self, command: str, method: str, *arguments: str) -> Any:
        """Ask the dashboard, and once more over a new connection where the old one turns out to be gone.

        A connection may have broken hours ago, unnoticed, and a stop must get through. `play` alone is not repeated: it
        may have been obeyed before the reply was lost.
        """
        try:
            return self._exchange(command, method, *arguments)
        except LinkLostError:
            if not self._is_open or command == "play":
                raise
        return self._exchange(command, method, *arguments)

    def _exchange(self, command: str, method: str, *arguments: str) -> Any:
        """Call ur_rtde and turn whatever it raises into one of our errors.

        After a failed exchange its connection is of no more use, so the next one makes a new one.
        """
        if not self._is_open:
            raise LinkLostError(f"The dashboard server of {self._peer} is not connected, so '{command}' is not sent.")
        if self._client is None:
            self._connect()
        try:
            reply = getattr(self._client, method)(*arguments)
        except Exception as error:
            fault = self._translate(command, one_line(str(error)))
            if not isinstance(fault, DeviceStateError):
                self._disconnect()
            raise fault from error
        return one_line(reply, LONGEST_REPLY) if isinstance(reply, str) else reply

    def _translate(self, command: str, said: str) -> DeviceError:
        text = said.lower()
        if "file not found" in text or "error while loading" in text:
            program = command.removeprefix("load ")
            what = f"has no program '{program}'" if "not found" in text else f"cannot load program '{program}'"
            return DeviceStateError(
                f"The {self._peer} {what}.", hint="Check [robot] program: a path below /programs on the controller."
            )
        if "remote control mode" in text or "not allowed" in text:
            return DeviceStateError(
                f"The {self._peer} is not in remote control and does not allow '{command}'.", hint=REMOTE_HINT
            )
        if "failed to execute" in text:
            return DeviceStateError(
                f"The {self._peer} refuses '{command}'.",
                hint="Look at the teach pendant: the robot must be on, its brakes released, no stop active.",
            )
        if "could not understand" in text:
            return DeviceStateError(
                f"The {self._peer} does not know the command '{command}'.", hint="Update the controller's software."
            )
        if TIMED_OUT in text:
            return DeviceTimeoutError(f"The dashboard server of {self._peer} did not answer '{command}' in 2.5 s.")
        return LinkLostError(
            f"The dashboard server of {self._peer} did not take '{command}': {_as_clause(said)}.",
            hint="Check the robot and its network cable.",
        )


def _make_client(host: str, clock: Clock) -> Any:
    try:
        from dashboard_client import DashboardClient
    except ImportError:
        return LineDashboard(host, clock)
    return DashboardClient(host)


def _after_colon(reply: object) -> str:
    text = str(reply)
    return text.partition(":")[2].strip() if ":" in text else text.strip()


def _is_same(loaded: str, program: str) -> bool:
    """Tell whether a path on the controller is the program: its folder may be left out."""
    return f"/{loaded}".endswith("/" + program.lstrip("/"))


def _as_clause(said: object) -> str:
    text = one_line(str(said)).rstrip(".")
    return text[:1].lower() + text[1:]
