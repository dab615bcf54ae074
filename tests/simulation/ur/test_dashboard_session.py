from __future__ import annotations

import socket

import pytest

from bench.simulation.outbox import Outbox
from bench.simulation.program import PathProgram
from bench.simulation.ur.dashboard import DashboardSession
from bench.simulation.ur.machine import CycleRegisters, Machine

BANNER = "Connected: Universal Robots Dashboard Server"
FORBIDDEN = (
    "Command is not allowed due to safety reasons, "
    "please switch robot to Remote Control mode and reconnect to port 29999"
)


class Dashboard:
    """A robot and its dashboard, with effects that wait until they are let happen."""

    def __init__(self):
        self.machine = Machine(PathProgram(), CycleRegisters(), 500.0)
        self.is_remote = True
        self.now_ns = 0
        self.effects = []
        self._ends = []

    def connect(self):
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        self._ends += [ours, theirs]
        session = DashboardSession(
            self.machine,
            Outbox(ours, 10**10),
            lambda delay_ns, effect: self.effects.append(effect),
            lambda: self.now_ns,
            lambda: self.is_remote,
        )
        assert theirs.recv(100) == f"{BANNER}\n".encode()

        def ask(line):
            session.receive(line.encode() + b"\n")
            return theirs.recv(1000).decode().removesuffix("\n")

        ask.session, ask.link = session, theirs
        return ask

    def act(self):
        for effect in self.effects:
            effect(self.now_ns)
        self.effects.clear()

    def do(self, ask, *lines):
        replies = []
        for line in lines:
            replies.append(ask(line))
            self.act()
        return replies

    def close(self):
        for end in self._ends:
            end.close()


@pytest.fixture
def dashboard():
    made = Dashboard()
    yield made
    made.close()


def test_queries_are_answered_in_the_words_of_polyscope(dashboard):
    ask = dashboard.connect()
    assert ask("PolyscopeVersion").startswith("URSoftware 5.15.0.")
    assert ask("get serial number").isdigit()
    assert ask("robotmode") == "Robotmode: RUNNING"
    assert ask("safetymode") == "Safetymode: NORMAL"
    assert ask("safetystatus") == "Safetystatus: NORMAL"
    assert ask("is in remote control") == "true"
    assert ask("running") == "Program running: false"
    assert ask("get loaded program") == "No program loaded"
    assert ask("make coffee") == "could not understand: 'make coffee'"


def test_case_spaces_and_line_ends_do_not_matter(dashboard):
    ask = dashboard.connect()
    assert ask("  RobotMode \r") == "Robotmode: RUNNING"
    assert ask("IS  IN remote CONTROL") == "true"


def test_a_line_may_come_in_pieces_and_several_at_once(dashboard):
    ask = dashboard.connect()
    ask.session.receive(b"robot")
    ask.session.receive(b"mode\nrunning\nsafety")
    assert ask.link.recv(1000) == b"Robotmode: RUNNING\nProgram running: false\n"


def test_a_program_is_loaded_played_paused_resumed_and_stopped(dashboard):
    ask = dashboard.connect()
    assert ask("play") == "Failed to execute: play"
    assert ask("load other.urp") == "File not found: other.urp"
    assert dashboard.do(ask, "load bend_test.urp") == ["Loading program: bend_test.urp"]
    assert ask("get loaded program") == "Loaded program: /programs/bend_test.urp"
    assert dashboard.do(ask, "stop", "pause") == ["Failed to execute: stop", "Failed to execute: pause"]
    assert dashboard.do(ask, "play") == ["Starting program"]
    assert ask("programState") == "PLAYING bend_test.urp"
    assert ask("load bend_test.urp") == "Error while loading program: bend_test.urp"
    assert dashboard.do(ask, "pause") == ["Pausing program"]
    assert ask("programState") == "PAUSED bend_test.urp"
    assert dashboard.do(ask, "play") == ["Starting program"]
    assert ask("running") == "Program running: true"
    assert dashboard.do(ask, "stop") == ["Stopped"]
    assert ask("programState") == "STOPPED bend_test.urp"


def test_the_reply_comes_before_the_effect(dashboard):
    ask = dashboard.connect()
    assert ask("load bend_test.urp") == "Loading program: bend_test.urp"
    assert ask("get loaded program") == "No program loaded"
    dashboard.act()
    assert ask("get loaded program") == "Loaded program: /programs/bend_test.urp"


def test_the_permission_of_a_connection_is_fixed_when_it_is_made(dashboard):
    early = dashboard.connect()
    dashboard.is_remote = False
    late = dashboard.connect()
    assert late("is in remote control") == early("is in remote control") == "false"
    assert [late(line) for line in ("load bend_test.urp", "play", "power off")] == [FORBIDDEN] * 3
    assert late("robotmode") == "Robotmode: RUNNING"
    assert early("load bend_test.urp") == "Loading program: bend_test.urp"
    dashboard.is_remote = True
    assert late("play") == FORBIDDEN


def test_a_protective_stop_pauses_and_is_released_after_five_seconds_only(dashboard):
    ask = dashboard.connect()
    dashboard.do(ask, "load bend_test.urp", "play")
    dashboard.machine.protective_stop(1_000)
    assert ask("safetystatus") == "Safetystatus: PROTECTIVE_STOP"
    assert ask("programState") == "PAUSED bend_test.urp"
    dashboard.now_ns = 4_000_000_000
    assert ask("unlock protective stop").startswith("Cannot unlock protective stop until 5s after occurrence")
    assert ask("play") == "Failed to execute: play"
    dashboard.now_ns = 5_000_001_000
    replies = dashboard.do(ask, "unlock protective stop", "close safety popup", "play")
    assert replies == ["Protective stop releasing", "closing safety popup", "Starting program"]
    assert ask("safetymode") == "Safetymode: NORMAL"


def test_after_an_emergency_stop_the_robot_is_off_until_it_is_powered_and_released(dashboard):
    ask = dashboard.connect()
    dashboard.do(ask, "load bend_test.urp", "play")
    dashboard.machine.emergency_stop(0)
    assert ask("safetystatus") == "Safetystatus: ROBOT_EMERGENCY_STOP"
    assert dashboard.do(ask, "power on")[0] == "Powering on"
    assert ask("robotmode") == "Robotmode: POWER_OFF"
    assert dashboard.do(ask, "restart safety", "power on") == ["Restarting safety", "Powering on"]
    assert ask("robotmode") == "Robotmode: IDLE"
    assert dashboard.do(ask, "brake release") == ["Brake releasing"]
    assert ask("robotmode") == "Robotmode: RUNNING"
    assert ask("programState") == "STOPPED bend_test.urp"
    assert dashboard.do(ask, "power off") == ["Powering off"]
    assert ask("robotmode") == "Robotmode: POWER_OFF"


def test_quit_ends_the_connection_and_an_endless_line_too(dashboard):
    ask = dashboard.connect()
    assert ask.session.receive(b"quit\n") is False
    assert ask.link.recv(100) == b"Disconnected\n"
    assert dashboard.connect().session.receive(b"x" * 5000) is False
