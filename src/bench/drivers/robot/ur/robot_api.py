"""Load, play and stop the robot's own program, by the Robot API of PolyScope X.

PolyScope X has no dashboard server; from software 10.11 on it has a REST interface in its place. Paths, bodies and
answers: the Robot API's own description (``/universal-robots/robot-api/docs`` on the controller) as used by Universal
Robots' client library (dashboard client for PolyScope X, github.com/UniversalRobots/Universal_Robots_Client_Library),
whose table of versions says which came with 10.12.
"""

from __future__ import annotations

import hashlib
import re
import threading
from collections.abc import Callable
from contextlib import suppress
from urllib.parse import quote

from bench.config import RobotConfig
from bench.drivers.robot.ur.effect import USUAL_LIMITS, EffectLimits, wait_for_effect
from bench.drivers.robot.ur.readiness import mode_reason, running_reason, safety_reason
from bench.drivers.robot.ur.rest_link import Answer, RestLink
from bench.drivers.robot.ur.words import one_line
from bench.errors import ConnectError, DeviceError, DeviceStateError, DeviceTimeoutError, LinkLostError, ProtocolError
from bench.timing import Clock

__all__ = ["ROOT", "RobotApiProgram"]

ROOT = "universal-robots/robot-api"
"""Path of the Robot API on the controller's web server."""
ANSWER_LIMIT_S = 5.0
"""A controller answers in milliseconds; this is for one that is busy loading."""
MODES_SINCE = (3, 1, 4)
"""Robot API of software 10.12, the first that tells modes and the loaded program, gives out programs, and loads by this
path."""
REMOTE_HINT = "Choose Automatic and Remote in the safety overview of PolyScope X, then start again."
NO_API_HINT = (
    "PolyScope X has a Robot API from software 10.11 on; other robots need [robot] program_control = 'dashboard'."
)
TIMEOUT_STATUSES = (408, 504)
FORBIDDEN, NOT_FOUND = 403, 404
SCREEN_HINT = (
    "PolyScope X loads a program by way of its screen: that must be on, or open in a browser. [robot] program is "
    "the name shown there."
)


class RobotApiProgram:
    """`ProgramControl` of a Universal Robots controller with PolyScope X, by its Robot API.

    Parameters
    ----------
    config : RobotConfig
        Address of the controller and port of its web server.
    clock : Clock
        Paces the polling; limits are in the machine's own seconds.
    limits : EffectLimits, optional
        How long the effect of a command, and of loading, may take.
    answer_limit_s : float
        How long one answer may take.
    """

    def __init__(
        self,
        config: RobotConfig,
        clock: Clock,
        limits: EffectLimits = USUAL_LIMITS,
        *,
        answer_limit_s: float = ANSWER_LIMIT_S,
    ) -> None:
        self._peer = f"controller {config.host}"
        self._config = config
        self._clock = clock
        self._limits = limits
        self._answer_limit_s = answer_limit_s
        self._lock = threading.RLock()
        self._link: RestLink | None = None
        self.version: tuple[int, ...] = ()
        """Version of the Robot API, such as (3, 1, 6)."""

    def open(self) -> None:
        """Ask for the API's version; there is no connection to be kept.

        Raises
        ------
        ConnectError
            There is no Robot API at this address.
        """
        with self._lock:
            self.close()
            peer = f"Robot API of {self._peer} (port {self._config.robot_api_port})"
            self._link = RestLink(
                self._config.host, self._config.robot_api_port, ROOT, peer=peer, limit_s=self._answer_limit_s
            )
            try:
                self.version = self._ask_version()
            except BaseException:
                self.close()
                raise

    def _ask_version(self) -> tuple[int, ...]:
        try:
            answer = self._send("GET", "openapi.json")
        except ConnectError:
            raise
        except DeviceError as error:
            raise ConnectError(str(error.args[0]), hint=NO_API_HINT) from error
        info = answer.fields.get("info")
        version = info.get("version") if answer.is_ok and isinstance(info, dict) else None
        if not isinstance(version, str):
            raise ConnectError(
                f"There is no Robot API on {self._peer} (port {self._config.robot_api_port}): {answer.said}.",
                hint=NO_API_HINT,
            )
        return tuple(int(part) for part in re.findall(r"[0-9]{1,9}", version)[:4])

    @property
    def _tells_modes(self) -> bool:
        return self.version >= MODES_SINCE

    @property
    def ready_when(self) -> str:
        """What `check` asks; software 10.11 tells no modes."""
        usual = "program stopped"
        return f"remote control, safety normal, powered on, {usual}" if self._tells_modes else usual

    def check(self, program: str) -> list[str]:
        """Return one sentence for each reason why `program` cannot be run now; empty if it can.

        The Robot API of software 10.11 tells no modes: there the controller's refusal is what one gets to know.

        Raises
        ------
        ConnectError, LinkLostError, DeviceTimeoutError, ProtocolError
            The controller does not answer, or not as it should.
        """
        with self._lock:
            found = [self._check_running(program)]
            if self._tells_modes:
                found = [self._check_remote(), self._check_safety(), self._check_mode(), *found]
        return [sentence for sentence in found if sentence]

    def _check_remote(self) -> str:
        is_remote = self._get("system/v1/controlmode", "mode").upper() == "REMOTE"
        return "" if is_remote else f"The {self._peer} is not in remote control. {REMOTE_HINT}"

    def _check_safety(self) -> str:
        return safety_reason(self._peer, "mode", self._get("robotstate/v1/safetymode", "mode").upper())

    def _check_mode(self) -> str:
        return mode_reason(self._peer, self._get("robotstate/v1/robotmode", "mode").upper())

    def _check_running(self, program: str) -> str:
        state = self._program_state()
        if state == "STOPPED":
            return ""
        name = self._get("program/v1/loaded", "name") if self._tells_modes else ""
        return running_reason(self._peer, state, name, is_ours=name == _name(program))

    def load(self, program: str) -> None:
        """Load a program and wait until the controller has it.

        Raises
        ------
        DeviceStateError
            The controller has no such program, or does not allow it.
        DeviceTimeoutError
            It is not loaded within the limit.
        """
        name = _name(program)
        with self._lock:
            path, key = ("program/v1/loaded", "name") if self._tells_modes else ("program/v1/load", "programName")
            # The reply may come when everything is loaded, which can outlast the limit on an answer.
            with suppress(DeviceTimeoutError):
                answer = self._put(path, {key: name}, f"load {name}")
                if not answer.is_ok:
                    raise self._cannot_load(name, answer)
            self._wait(lambda: self._has_loaded(name), f"load '{name}'", self._limits.load_s)

    def _cannot_load(self, name: str, answer: Answer) -> DeviceStateError:
        what = "has no program" if answer.status == NOT_FOUND else "cannot load program"
        return DeviceStateError(f"The {self._peer} {what} '{name}': {answer.said}.", hint=SCREEN_HINT)

    def _has_loaded(self, name: str) -> bool:
        return not self._tells_modes or self._get("program/v1/loaded", "name") == name

    def tell_loaded(self) -> dict[str, str]:
        """Return name, size and SHA-256 of the loaded program; nothing from software 10.11, which does not tell them.

        The hash is of what the controller gives out: the file that its clients save as ``.urpx``.
        """
        if not self._tells_modes:
            return {}
        with self._lock:
            name = self._get("program/v1/loaded", "name")
            answer = self._send("GET", f"programs/v1/{quote(name, safe='')}")
            if not answer.is_ok:
                raise DeviceStateError(f"The {self._peer} does not give out its program '{name}': {answer.said}.")
        digest = hashlib.sha256(answer.content).hexdigest()
        return {"loaded": name, "loaded_bytes": str(len(answer.content)), "loaded_sha256": digest}

    def play(self) -> None:
        """Start the loaded program, or resume it after a pause, and wait until it plays."""
        with self._lock:
            self._act("resume" if self._program_state() == "PAUSED" else "play")
            self._wait(lambda: self._program_state() == "PLAYING", "play", self._limits.command_s)

    def stop(self) -> None:
        """Stop the program, if it is not stopped already, and wait until it is."""
        with self._lock:
            if self._program_state() == "STOPPED":
                return
            self._act("stop")
            self._wait(lambda: self._program_state() == "STOPPED", "stop", self._limits.command_s)

    def close(self) -> None:
        """Free the HTTP client. May be called twice, and after an error."""
        with self._lock:
            link, self._link = self._link, None
            if link is not None:
                link.close()

    def _program_state(self) -> str:
        return self._get("program/v1/state", "state").upper()

    def _act(self, action: str) -> None:
        answer = self._put("program/v1/state", {"action": action}, action)
        if not answer.is_ok:
            raise DeviceStateError(
                f"The {self._peer} refuses '{action}': {answer.said}.",
                hint="Look at the teach pendant: the robot must be on, its brakes released, no stop active.",
            )

    def _put(self, path: str, body: dict[str, str], command: str) -> Answer:
        """Return the answer to a command, unless it is one that every command may get."""
        answer = self._send("PUT", path, body)
        if answer.status == FORBIDDEN:
            raise DeviceStateError(
                f"The {self._peer} is not in remote control and does not allow '{command}': {answer.said}.",
                hint=REMOTE_HINT,
            )
        if answer.status in TIMEOUT_STATUSES:
            raise DeviceTimeoutError(f"The {self._peer} could not do '{command}' in its own time: {answer.said}.")
        return answer

    def _get(self, path: str, key: str) -> str:
        answer = self._send("GET", path)
        if not answer.is_ok:
            raise DeviceStateError(
                f"The {self._peer} does not tell '{path}': {answer.said}.",
                hint="Wait until the robot has started; if it has, restart it.",
            )
        value = answer.fields.get(key)
        if not isinstance(value, str):
            raise ProtocolError(f"The {self._peer} answers '{path}' without a '{key}'.", hint="Check robot_api_port.")
        return one_line(value)

    def _send(self, method: str, path: str, body: dict[str, str] | None = None) -> Answer:
        if self._link is None:
            raise LinkLostError(f"The Robot API of {self._peer} is not open, so '{method} {path}' is not sent.")
        return self._link.ask(method, path, body)

    def _wait(self, is_reached: Callable[[], bool], command: str, limit_s: float) -> None:
        wait_for_effect(self._clock, self._peer, command, is_reached, limit_s)


def _name(program: str) -> str:
    """Return the name by which PolyScope X knows a program: without folder and suffix."""
    return re.sub(r"\.urpx?$", "", program.rpartition("/")[2])
