from __future__ import annotations

import json
import socket

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.drivers.robot.ur.robot_api import ROOT
from bench.simulation.outbox import Outbox
from bench.simulation.program import PathProgram
from bench.simulation.ur.http import HttpSession
from bench.simulation.ur.kinds import POLYSCOPE_X
from bench.simulation.ur.machine import CycleRegisters, Machine
from bench.simulation.ur.rest import RobotApi


class Web:
    """A robot and its Robot API, with effects that wait until they are let happen."""

    def __init__(self):
        self.machine = Machine(PathProgram(), CycleRegisters(), 500.0, POLYSCOPE_X)
        self.is_remote = True
        self.now_ns = 0
        self.effects = []
        self.ours, self.theirs = socket.socketpair()
        self.ours.setblocking(False)
        self.api = RobotApi(
            self.machine,
            lambda delay_ns, effect: self.effects.append(effect),
            lambda: self.now_ns,
            lambda: self.is_remote,
        )
        self.session = HttpSession(Outbox(self.ours, 10**10), self.api.answer)

    def ask(self, method, path, fields=None):
        body = b"" if fields is None else json.dumps(fields).encode()
        head = f"{method} /{ROOT}/{path} HTTP/1.1\r\nHost: robot\r\nContent-Length: {len(body)}\r\n\r\n"
        assert self.session.receive(head.encode() + body)
        return self.read_answer()

    def read_answer(self):
        head, _, body = self.theirs.recv(10_000).partition(b"\r\n\r\n")
        return int(head.split()[1]), json.loads(body)

    def do(self, path, fields):
        status, _ = self.ask("PUT", path, fields)
        for effect in self.effects:
            effect(self.now_ns)
        self.effects.clear()
        return status

    def act(self, action):
        return self.do("program/v1/state", {"action": action})

    def set_robot(self, action):
        return self.do("robotstate/v1/state", {"action": action})

    @property
    def state(self):
        return self.ask("GET", "program/v1/state")[1]["state"]

    def close(self):
        self.ours.close()
        self.theirs.close()


@pytest.fixture
def web():
    made = Web()
    yield made
    made.close()


def test_questions_are_answered_in_the_words_of_polyscope_x(web):
    assert web.ask("GET", "openapi.json")[1]["info"]["version"] == "3.1.6"
    assert web.ask("GET", "robotstate/v1/robotmode")[1]["mode"] == "RUNNING"
    assert web.ask("GET", "robotstate/v1/safetymode")[1]["mode"] == "NORMAL"
    assert web.ask("GET", "system/v1/controlmode") == (200, {"mode": "REMOTE"})
    assert web.ask("GET", "system/v1/operationalmode") == (200, {"mode": "AUTOMATIC"})
    assert web.ask("GET", "program/v1/loaded")[1]["name"] == ""
    assert web.ask("GET", "coffee")[0] == web.ask("DELETE", "program/v1/loaded")[0] == 404


def test_a_program_is_loaded_played_paused_resumed_and_stopped(web):
    assert web.act("play") == 409
    assert web.do("program/v1/loaded", {"name": "other"}) == 404
    assert web.do("program/v1/loaded", {"name": "bend_test"}) == 200
    assert web.ask("GET", "program/v1/loaded")[1]["name"] == "bend_test"
    assert [web.act("resume"), web.act("pause"), web.act("stop")] == [409] * 3
    assert (web.act("play"), web.state) == (200, "PLAYING")
    assert web.do("program/v1/loaded", {"name": "bend_test"}) == 409
    assert (web.act("pause"), web.state) == (200, "PAUSED")
    assert web.act("play") == 409
    assert (web.act("resume"), web.state) == (200, "PLAYING")
    assert (web.act("stop"), web.state) == (200, "STOPPED")


def test_another_program_that_a_person_loads_is_the_one_that_is_told(web):
    web.do("program/v1/loaded", {"name": "bend_test"})
    web.machine.load_foreign("weld.urpx")
    assert web.ask("GET", "program/v1/loaded")[1]["name"] == "weld"
    assert web.act("play") == 409


def test_the_reply_comes_before_the_effect(web):
    assert web.ask("PUT", "program/v1/loaded", {"name": "bend_test"})[0] == 200
    assert web.ask("GET", "program/v1/loaded")[1]["name"] == ""


def test_nothing_is_done_for_a_client_while_the_robot_is_in_local_control(web):
    web.is_remote = False
    assert web.ask("GET", "system/v1/controlmode") == (200, {"mode": "LOCAL"})
    assert [web.do("program/v1/loaded", {"name": "bend_test"}), web.act("play"), web.set_robot("POWER_OFF")] == [
        403
    ] * 3
    web.is_remote = True
    assert web.set_robot("POWER_OFF") == 200


def test_a_protective_stop_is_released_after_five_seconds_only(web):
    web.do("program/v1/loaded", {"name": "bend_test"})
    web.act("play")
    web.machine.protective_stop(1_000)
    assert web.ask("GET", "robotstate/v1/safetymode")[1]["mode"] == "PROTECTIVE_STOP"
    assert web.state == "PAUSED"
    web.now_ns = 4_000_000_000
    assert web.set_robot("UNLOCK_PROTECTIVE_STOP") == 409
    web.now_ns = 5_000_001_000
    assert web.set_robot("UNLOCK_PROTECTIVE_STOP") == 200
    assert web.act("resume") == 200


def test_after_an_emergency_stop_the_robot_is_off_until_it_is_powered_and_released(web):
    web.machine.emergency_stop(0)
    assert web.ask("GET", "robotstate/v1/safetymode")[1]["mode"] == "EMERGENCY_STOP"
    assert [web.set_robot(word) for word in ("RESTART_SAFETY", "POWER_ON", "BRAKE_RELEASE")] == [200] * 3
    assert web.ask("GET", "robotstate/v1/robotmode")[1]["mode"] == "RUNNING"


@pytest.mark.parametrize("fields", [None, {}, {"action": 7}, {"action": "dance"}])
def test_a_body_that_says_nothing_known_is_unprocessable(web, fields):
    assert web.ask("PUT", "program/v1/state", fields)[0] == 422
    assert web.ask("PUT", "program/v1/loaded", fields)[0] == 422


def test_a_request_may_come_in_pieces_and_several_at_once(web):
    request = f"GET /{ROOT}/system/v1/controlmode HTTP/1.1\r\nHost: robot\r\n\r\n".encode()
    for place in range(len(request) - 1):
        assert web.session.receive(request[place : place + 1])
    web.session.receive(request[-1:] + request)
    assert web.theirs.recv(10_000).count(b"REMOTE") == 2


def test_a_client_that_asks_so_is_hung_up_on_after_its_answer(web):
    assert not web.session.receive(f"GET /{ROOT}/openapi.json HTTP/1.1\r\nConnection: close\r\n\r\n".encode())
    assert web.read_answer()[0] == 200


@pytest.mark.parametrize(
    "head",
    [
        "GET / SPDY/9",
        "GET",
        "PUT / HTTP/1.1\r\nContent-Length: many",
        "PUT / HTTP/1.1\r\nContent-Length: 99999999",
        "PUT / HTTP/1.1\r\nTransfer-Encoding: chunked",
    ],
)
def test_what_is_no_request_is_refused_and_hung_up_on(web, head):
    assert not web.session.receive(f"{head}\r\n\r\n".encode())
    assert web.read_answer()[0] == 400


@settings(max_examples=50, deadline=None)
@given(st.binary(max_size=100), st.binary(max_size=100))
def test_no_bytes_disturb_the_server(head, body):
    web = Web()
    web.session.receive(head)
    web.session.receive(b"PUT /%s/program/v1/state HTTP/1.1\r\nContent-Length: %d\r\n\r\n" % (ROOT.encode(), len(body)))
    web.session.receive(body)
    web.close()
