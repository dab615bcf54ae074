"""The Robot API of PolyScope X: the program, the modes and the safety over HTTP; the reply comes before the effect.

Paths, bodies, statuses and the words in them: Robot API 3.1 (PolyScope X 10.12) as its clients use it, see
`bench.drivers.robot.ur.robot_api`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from http import HTTPStatus
from typing import Any
from urllib.parse import unquote

from bench.drivers.robot.ur.robot_api import ROOT
from bench.simulation.ur.dashboard import EFFECT_DELAY_NS, Effect
from bench.simulation.ur.http import Reply, Request
from bench.simulation.ur.machine import Machine, RobotMode, SafetyStatus

__all__ = ["RobotApi"]

API_VERSION = "3.1.6"
"""Of PolyScope X 10.12."""
SAFETY_WORDS = {SafetyStatus.SAFEGUARD_STOP: "PROTECTIVE_STOP", SafetyStatus.ROBOT_EMERGENCY_STOP: "EMERGENCY_STOP"}
"""Where the Robot API, which knows five safety modes, has another word than RTDE."""
NOT_REMOTE = Reply(
    {"message": "Forbidden - Operation Not Allowed", "details": "The robot must be in remote mode."},
    HTTPStatus.FORBIDDEN,
)
PROGRAMS = "programs/v1/"
N_WAYPOINTS = 8
UNKNOWN_PATH = Reply({"message": "Not Found"}, HTTPStatus.NOT_FOUND)
NO_SUCH_PROGRAM = Reply({"message": "Program not found"}, HTTPStatus.NOT_FOUND)
UNREADABLE = Reply({"message": "Validation Error"}, HTTPStatus.UNPROCESSABLE_ENTITY)


class RobotApi:
    """Answers any client's requests; the network's thread.

    Parameters
    ----------
    machine : Machine
        The robot.
    schedule : callable
        Runs an effect on the scheduler's thread after a delay (ns).
    now_ns : callable
        Host time.
    is_remote : callable
        Whether the robot is in remote control now; unlike the dashboard's, a permission that can come and go.
    """

    def __init__(
        self,
        machine: Machine,
        schedule: Callable[[int, Effect], None],
        now_ns: Callable[[], int],
        is_remote: Callable[[], bool],
    ) -> None:
        self._machine = machine
        self._schedule = schedule
        self._now_ns = now_ns
        self._is_remote = is_remote
        self._questions = self._make_questions()
        self._commands: dict[str, Callable[[dict[str, Any]], Reply]] = {
            "program/v1/state": self._act_on_program,
            "program/v1/loaded": self._load,
            "robotstate/v1/state": self._act_on_robot,
        }

    @property
    def program_name(self) -> str:
        """The program's name as PolyScope X has it: without a suffix."""
        return _without_suffix(self._machine.program.name)

    def answer(self, request: Request) -> Reply:
        path = unquote(request.path).removeprefix(f"/{ROOT}/")
        if request.method == "GET" and path.startswith(PROGRAMS):
            return self._give_out(path.removeprefix(PROGRAMS))
        if request.method == "GET" and path in self._questions:
            return Reply(self._questions[path]())
        if request.method != "PUT" or path not in self._commands:
            return UNKNOWN_PATH
        if request.fields is None:
            return UNREADABLE
        if not self._is_remote():
            return NOT_REMOTE
        self._machine.told.append(f"{path} {json.dumps(request.fields)}")
        return self._commands[path](request.fields)

    def _make_questions(self) -> dict[str, Callable[[], dict[str, Any]]]:
        machine = self._machine
        return {
            "openapi.json": lambda: {"openapi": "3.1.0", "info": {"title": "Robot API", "version": API_VERSION}},
            "program/v1/state": lambda: {"state": machine.state, "message": "", "details": ""},
            "program/v1/loaded": lambda: {"name": _without_suffix(machine.loaded_name), "message": ""},
            "robotstate/v1/robotmode": lambda: {"mode": machine.robot_mode.name, "message": ""},
            "robotstate/v1/safetymode": lambda: {"mode": self._safety_word(), "message": ""},
            "system/v1/controlmode": lambda: {"mode": "REMOTE" if self._is_remote() else "LOCAL"},
            "system/v1/operationalmode": lambda: {"mode": "AUTOMATIC"},
        }

    def _safety_word(self) -> str:
        status = self._machine.safety_status
        return SAFETY_WORDS.get(status, status.name)

    def _give_out(self, name: str) -> Reply:
        # what is in a real one is not documented; here, where it goes
        if name != self.program_name:
            return NO_SUCH_PROGRAM
        path = self._machine.program.path
        return Reply({"name": name, "waypoints_rad": [path.at(i / N_WAYPOINTS).q_rad for i in range(N_WAYPOINTS)]})

    def _later(self, effect: Effect) -> Reply:
        self._schedule(EFFECT_DELAY_NS, effect)
        return Reply({"message": "OK"})

    def _load(self, fields: dict[str, Any]) -> Reply:
        name = fields.get("name")
        if not isinstance(name, str):
            return UNREADABLE
        if name != self.program_name:
            return NO_SUCH_PROGRAM
        if self._machine.state != "STOPPED":
            return _refused("A program is running")
        return self._later(self._machine.load)

    def _act_on_program(self, fields: dict[str, Any]) -> Reply:
        machine, state = self._machine, self._machine.state
        actions: dict[object, tuple[bool, Effect]] = {
            "play": (machine.can_play and state == "STOPPED", machine.play),
            "resume": (machine.can_play and state == "PAUSED", machine.play),
            "pause": (state == "PLAYING", machine.pause),
            "stop": (state != "STOPPED", machine.stop),
        }
        return self._act(actions, fields.get("action"))

    def _act_on_robot(self, fields: dict[str, Any]) -> Reply:
        machine = self._machine
        is_stopped = machine.safety_status == SafetyStatus.PROTECTIVE_STOP
        actions: dict[object, tuple[bool, Effect]] = {
            "POWER_ON": (machine.robot_mode == RobotMode.POWER_OFF, machine.power_on),
            "POWER_OFF": (True, machine.power_off),
            "BRAKE_RELEASE": (machine.robot_mode != RobotMode.RUNNING, machine.release_brakes),
            "UNLOCK_PROTECTIVE_STOP": (is_stopped and machine.can_unlock(self._now_ns()), machine.unlock),
            "RESTART_SAFETY": (True, machine.restart_safety),
        }
        return self._act(actions, fields.get("action"))

    def _act(self, actions: dict[object, tuple[bool, Effect]], action: object) -> Reply:
        if not isinstance(action, str) or action not in actions:
            return UNREADABLE
        is_possible, effect = actions[action]
        return self._later(effect) if is_possible else _refused(f"{action} is not possible now")


def _refused(details: str) -> Reply:
    return Reply({"message": "Conflict", "details": details}, HTTPStatus.CONFLICT)


def _without_suffix(name: str) -> str:
    return re.sub(r"\.urpx?$", "", name)
