from __future__ import annotations

import socket
import sys

import pytest

from bench.drivers.robot import make_program_control
from bench.drivers.robot.ur.effect import EffectLimits
from bench.drivers.robot.ur.program import UrDashboardProgram
from bench.errors import ConnectError, DeviceError, DeviceStateError, DeviceTimeoutError, LinkLostError

HOST = "127.0.31.4"
SCRIPTED = "127.0.31.5"
PROGRAM = "bend_test.urp"
CONTROL = UrDashboardProgram


@pytest.fixture(autouse=True, params=["ur_rtde", "own socket"])
def client(request, monkeypatch):
    """Every test holds for ur_rtde's client and for ours."""
    if request.param == "ur_rtde":
        pytest.importorskip("dashboard_client", reason="ur_rtde has no build for this Python")
    else:
        monkeypatch.setitem(sys.modules, "dashboard_client", None)


HANG_UP = object()


class Dashboard:
    """A dashboard that answers as a table says; a reply of None is never sent."""

    def __init__(self, replies):
        self.replies = {"polyscopeversion": "URSoftware 5.15.0.126652 (Aug 30 2023)"} | replies
        self.asked = []

    def __call__(self, link):
        link.sendall(b"Connected: Universal Robots Dashboard Server\n")
        for line in link.makefile("r"):
            self.asked.append(line.strip())
            reply = self.replies.get(line.strip().lower(), f"could not understand: '{line.strip()}'")
            if reply is HANG_UP:
                link.shutdown(socket.SHUT_RDWR)
            elif reply is not None:
                link.sendall(f"{reply}\n".encode())


READY = {
    "is in remote control": "true",
    "safetystatus": "Safetystatus: NORMAL",
    "robotmode": "Robotmode: RUNNING",
    "programstate": "STOPPED bend_test.urp",
}


def test_a_program_is_loaded_played_and_stopped_and_each_effect_is_seen(start_controller, open_program):
    controller = start_controller(HOST)
    program = open_program()
    assert program.version == (5, 15, 0, 126652)
    assert program.check(PROGRAM) == []
    program.load(PROGRAM)
    assert controller.machine.loaded
    program.play()
    assert controller.machine.program.state == "PLAYING"
    program.stop()
    assert controller.machine.program.state == "STOPPED"
    program.stop()
    program.play()
    assert controller.machine.program.state == "PLAYING"


def test_a_program_the_controller_does_not_have_is_named(start_controller, open_program):
    start_controller(HOST)
    with pytest.raises(DeviceStateError, match=r"controller 127\.0\.31\.4 has no program 'x\.urp'") as caught:
        open_program().load("x.urp")
    assert "/programs" in caught.value.hint


def test_the_loaded_program_is_told_with_its_folder(start_controller, open_program):
    start_controller(HOST)
    program = open_program()
    program.load(PROGRAM)
    assert program.tell_loaded() == {"loaded": "/programs/bend_test.urp"}


def test_a_play_without_a_program_is_refused(start_controller, open_program):
    start_controller(HOST)
    with pytest.raises(DeviceStateError, match="refuses 'play'"):
        open_program().play()


def test_local_control_is_found_by_the_check_and_by_each_command(start_controller, open_program):
    start_controller(HOST, remote_control=False)
    program = open_program()
    (sentence,) = program.check(PROGRAM)
    assert "not in remote control" in sentence
    with pytest.raises(DeviceStateError, match=r"not in remote control and does not allow 'load bend_test\.urp'"):
        program.load(PROGRAM)


def test_every_reason_against_a_program_is_told_at_once(start_controller, open_program):
    controller = start_controller(HOST, remote_control=False)
    controller.machine.load(0)
    controller.machine.emergency_stop(0)
    sentences = open_program().check(PROGRAM)
    assert len(sentences) == 3
    assert "ROBOT_EMERGENCY_STOP" in sentences[1]
    assert "POWER_OFF" in sentences[2]


def test_a_protective_stop_is_found_by_the_check_with_the_paused_program(start_controller, open_program):
    controller = start_controller(HOST)
    program = open_program()
    program.load(PROGRAM)
    program.play()
    controller.machine.protective_stop(0)
    stop, paused = program.check(PROGRAM)
    assert "PROTECTIVE_STOP" in stop
    assert f"'{PROGRAM}' is paused already" in paused


def test_another_program_that_runs_is_named(scripted, open_program):
    scripted(SCRIPTED, Dashboard(READY | {"programstate": "PLAYING weld.urp"}), port=29999)
    (sentence,) = open_program(SCRIPTED).check(PROGRAM)
    assert "'weld.urp', another program, is playing already" in sentence


def test_a_cb3_controller_is_asked_only_what_it_knows(scripted, open_program):
    cb3 = Dashboard(
        {
            "polyscopeversion": "URSoftware 3.5.1.10661 (Mar 20 2018)",
            "safetymode": "Safetymode: NORMAL",
            "robotmode": "Robotmode: RUNNING",
            "programstate": "STOPPED bend_test.urp",
        }
    )
    scripted(SCRIPTED, cb3, port=29999)
    assert open_program(SCRIPTED).check(PROGRAM) == []
    assert "is in remote control" not in [line.lower() for line in cb3.asked]


def test_an_effect_that_never_comes_is_a_timeout(scripted, open_program):
    scripted(SCRIPTED, Dashboard(READY | {"play": "Starting program"}), port=29999)
    program = open_program(SCRIPTED, limits=EffectLimits(command_s=0.1))
    with pytest.raises(DeviceTimeoutError, match=r"accepted to play but has not done so after 0\.1 s"):
        program.play()


def test_a_load_that_outlasts_the_limit_of_one_answer_is_waited_for(scripted, open_program):
    slow = Dashboard({f"load {PROGRAM}": None})
    done = Dashboard({"get loaded program": f"Loaded program: /programs/{PROGRAM}"})
    scripted(SCRIPTED, slow, done, port=29999)
    open_program(SCRIPTED).load(PROGRAM)
    assert done.asked == ["get loaded program"]


def test_a_controller_that_cannot_load_its_program_is_told(scripted, open_program):
    scripted(SCRIPTED, Dashboard({f"load {PROGRAM}": f"Error while loading program: {PROGRAM}"}), port=29999)
    with pytest.raises(DeviceStateError, match="cannot load program"):
        open_program(SCRIPTED).load(PROGRAM)


def test_a_lost_dashboard_is_a_lost_link_for_every_call(start_controller, open_program):
    controller = start_controller(HOST)
    program = open_program()
    controller.close()
    with pytest.raises(LinkLostError, match="did not take 'play'"):
        program.play()
    for call in (program.stop, lambda: program.check(PROGRAM), lambda: program.load(PROGRAM)):
        with pytest.raises(ConnectError, match="does not answer"):
            call()
    program.close()
    program.close()


def test_a_stop_gets_through_after_the_dashboard_has_hung_up(scripted, open_program):
    scripted(SCRIPTED, Dashboard({"play": HANG_UP}), Dashboard(READY), port=29999)
    program = open_program(SCRIPTED)
    with pytest.raises(LinkLostError, match="did not take 'play'"):
        program.play()
    program.stop()
    assert program.check(PROGRAM) == []


def test_a_controller_without_a_dashboard_cannot_be_connected(open_program):
    with pytest.raises(ConnectError, match=r"controller 127\.0\.31\.4 \(port 29999\) does not answer"):
        open_program()


def test_a_port_that_is_no_dashboard_cannot_be_connected(scripted, open_program):
    scripted(SCRIPTED, lambda link: link.close(), port=29999)
    with pytest.raises(ConnectError):
        open_program(SCRIPTED)


def test_calls_before_opening_are_errors_of_ours(make_config, clock):
    program = make_program_control(make_config(HOST), clock)
    with pytest.raises(DeviceError):
        program.play()
    program.close()
