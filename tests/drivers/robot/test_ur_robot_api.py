from __future__ import annotations

import hashlib
import json
import threading
from typing import ClassVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.drivers.robot import make_program_control
from bench.drivers.robot.ur.effect import EffectLimits
from bench.drivers.robot.ur.program import UrDashboardProgram
from bench.drivers.robot.ur.rest_link import LARGEST_ANSWER
from bench.drivers.robot.ur.robot_api import ROOT, RobotApiProgram
from bench.errors import (
    ConnectError,
    DeviceError,
    DeviceStateError,
    DeviceTimeoutError,
    LinkLostError,
    ProtocolError,
)
from bench.simulation.path import JointPath
from bench.simulation.ur.kinds import POLYSCOPE_X

HOST = "127.0.63.4"
SCRIPTED = "127.0.63.5"
PROGRAM = "bend_test.urp"
CONTROL = RobotApiProgram
MANY = 200


class Api:
    """A Robot API that answers as a table says, one request for each connection."""

    READY: ClassVar = {
        "GET openapi.json": {"info": {"version": "3.1.6"}},
        "GET system/v1/controlmode": {"mode": "REMOTE"},
        "GET robotstate/v1/safetymode": {"mode": "NORMAL"},
        "GET robotstate/v1/robotmode": {"mode": "RUNNING"},
        "GET program/v1/state": {"state": "STOPPED"},
        "GET program/v1/loaded": {"name": "bend_test"},
    }

    def __init__(self, **answers):
        self.answers = self.READY | {" ".join(key.split("__")): value for key, value in answers.items()}
        self.asked = []
        self._wait = threading.Event()

    def __call__(self, link):
        with link.makefile("rwb") as stream:
            method, target, _ = stream.readline().decode().split()
            length = 0
            while line := stream.readline().strip():
                if line.lower().startswith(b"content-length:"):
                    length = int(line.partition(b":")[2])
            path = target.removeprefix(f"/{ROOT}/")
            self.asked.append((f"{method} {path}", stream.read(length).decode()))
            stream.write(self._reply(self.answers.get(f"{method} {path}", (404, b"{}"))))
        link.shutdown(2)

    def _reply(self, answer):
        if isinstance(answer, bytes):
            return answer
        status, body = answer if isinstance(answer, tuple) else (200, answer)
        body = body if isinstance(body, bytes) else json.dumps(body).encode()
        return b"HTTP/1.1 %d X\r\nContent-Length: %d\r\n\r\n%s" % (status, len(body), body)

    @property
    def requests(self):
        return [request for request, _ in self.asked]


@pytest.fixture
def serve(scripted):
    """Serve a Robot API on the usual port."""

    def start(api):
        scripted(SCRIPTED, *[api] * MANY, port=80)
        return api

    return start


def with_answers(**table):
    api = Api()
    api.answers |= table
    return api


def test_a_program_is_loaded_played_and_stopped_and_each_effect_is_seen(start_controller, open_program):
    controller = start_controller(HOST, kind=POLYSCOPE_X)
    program = open_program()
    assert program.version == (3, 1, 6)
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


def test_the_loaded_program_is_told_with_the_hash_of_what_the_controller_gives_out(start_controller, open_program):
    controller = start_controller(HOST, kind=POLYSCOPE_X)
    program = open_program()
    program.load(PROGRAM)
    told = program.tell_loaded()
    assert told["loaded"] == "bend_test"
    assert len(told["loaded_sha256"]) == 64
    assert int(told["loaded_bytes"]) > 100
    assert program.tell_loaded() == told
    controller.machine.program.path = JointPath(0.9)
    assert program.tell_loaded()["loaded_sha256"] != told["loaded_sha256"]


def test_the_hash_is_that_of_the_bytes_whatever_the_programs_name_and_content(serve, open_program):
    content = bytes(range(256))
    asked = "GET programs/v1/bend%201%2F%C3%BC%3F"
    api = serve(with_answers(**{"GET program/v1/loaded": {"name": "bend 1/ü?"}, asked: (200, content)}))
    told = open_program(SCRIPTED).tell_loaded()
    assert told["loaded_sha256"] == hashlib.sha256(content).hexdigest()
    assert api.requests[-1] == asked


def test_a_program_that_is_not_given_out_is_an_error_of_ours(serve, open_program):
    serve(with_answers())
    with pytest.raises(DeviceStateError, match="does not give out its program 'bend_test': status 404"):
        open_program(SCRIPTED).tell_loaded()


def test_software_10_11_tells_nothing_of_its_program(serve, open_program):
    api = serve(with_answers(**{"GET openapi.json": {"info": {"version": "3.0.0"}}}))
    assert open_program(SCRIPTED).tell_loaded() == {}
    assert api.requests == ["GET openapi.json"]


def test_a_paused_program_is_resumed_by_play(start_controller, open_program):
    controller = start_controller(HOST, kind=POLYSCOPE_X)
    program = open_program()
    program.load("bend_test.urpx")
    program.play()
    controller.machine.pause(0)
    program.play()
    assert controller.machine.program.state == "PLAYING"


def test_a_program_the_controller_does_not_have_is_named(start_controller, open_program):
    start_controller(HOST, kind=POLYSCOPE_X)
    with pytest.raises(
        DeviceStateError, match=r"controller 127\.0\.63\.4 has no program 'x': Program not found"
    ) as caught:
        open_program().load("x.urpx")
    assert "screen" in caught.value.hint


def test_a_play_without_a_program_is_refused(start_controller, open_program):
    start_controller(HOST, kind=POLYSCOPE_X)
    with pytest.raises(DeviceStateError, match="refuses 'play': Conflict play is not possible now"):
        open_program().play()


def test_local_control_is_found_by_the_check_and_by_each_command(start_controller, open_program):
    start_controller(HOST, kind=POLYSCOPE_X, remote_control=False)
    program = open_program()
    (sentence,) = program.check(PROGRAM)
    assert "not in remote control" in sentence
    with pytest.raises(DeviceStateError, match="not in remote control and does not allow 'load bend_test'"):
        program.load(PROGRAM)
    with pytest.raises(DeviceStateError, match="not in remote control and does not allow 'play'"):
        program.play()


def test_every_reason_against_a_program_is_told_at_once(start_controller, open_program):
    controller = start_controller(HOST, kind=POLYSCOPE_X, remote_control=False)
    controller.machine.load(0)
    controller.machine.emergency_stop(0)
    sentences = open_program().check(PROGRAM)
    assert len(sentences) == 3
    assert "EMERGENCY_STOP" in sentences[1]
    assert "POWER_OFF" in sentences[2]


def test_a_protective_stop_is_found_by_the_check_with_the_paused_program(start_controller, open_program):
    controller = start_controller(HOST, kind=POLYSCOPE_X)
    program = open_program()
    program.load(PROGRAM)
    program.play()
    controller.machine.protective_stop(0)
    stop, paused = program.check(PROGRAM)
    assert "PROTECTIVE_STOP" in stop
    assert "'bend_test' is paused already" in paused


def test_another_program_that_runs_is_named(serve, open_program):
    serve(with_answers(**{"GET program/v1/state": {"state": "PLAYING"}, "GET program/v1/loaded": {"name": "weld"}}))
    (sentence,) = open_program(SCRIPTED).check(PROGRAM)
    assert "'weld', another program, is playing already" in sentence


def test_software_10_11_is_asked_only_what_it_knows_and_loads_by_its_own_path(serve, open_program):
    api = serve(with_answers(**{"GET openapi.json": {"info": {"version": "3.0.2"}}, "PUT program/v1/load": {}}))
    program = open_program(SCRIPTED)
    assert program.check(PROGRAM) == []
    program.load(PROGRAM)
    assert api.requests == ["GET openapi.json", "GET program/v1/state", "PUT program/v1/load"]
    assert json.loads(api.asked[-1][1]) == {"programName": "bend_test"}
    api.answers["GET program/v1/state"] = {"state": "PAUSED"}
    (sentence,) = program.check(PROGRAM)
    assert "a program is paused already" in sentence


def test_an_effect_that_never_comes_is_a_timeout(serve, open_program):
    serve(with_answers(**{"PUT program/v1/state": {}}))
    program = open_program(SCRIPTED, limits=EffectLimits(command_s=0.1))
    with pytest.raises(DeviceTimeoutError, match=r"accepted to play but has not done so after 0\.1 s"):
        program.play()


def test_a_load_that_outlasts_the_limit_of_one_answer_is_waited_for(serve, open_program):
    api = serve(with_answers(**{"PUT program/v1/loaded": (504, {"message": "Gateway Timeout"})}))
    open_program(SCRIPTED).load(PROGRAM)
    assert api.requests[-1] == "GET program/v1/loaded"


def test_a_command_that_times_out_on_the_controller_is_a_timeout(serve, open_program):
    serve(with_answers(**{"PUT program/v1/state": (408, {"message": "busy."})}))
    with pytest.raises(DeviceTimeoutError, match=r"could not do 'play' in its own time: busy\.$"):
        open_program(SCRIPTED).play()


def test_a_program_that_cannot_be_loaded_is_told_with_the_controllers_words(serve, open_program):
    serve(with_answers(**{"PUT program/v1/loaded": (500, {"message": "no screen", "details": "none\nconnected."})}))
    with pytest.raises(DeviceStateError, match=r"cannot load program 'bend_test': no screen none connected\. "):
        open_program(SCRIPTED).load(PROGRAM)


def test_a_controller_that_answers_nothing_is_given_up_in_time(scripted, open_program):
    stop = threading.Event()
    scripted(SCRIPTED, lambda link: stop.wait(10.0), port=80)
    with pytest.raises(ConnectError, match=r"did not answer 'GET openapi\.json' in 0\.2 s"):
        open_program(SCRIPTED, answer_limit_s=0.2)
    stop.set()


def test_an_answer_that_drips_does_not_outlast_the_limit(scripted, open_program):
    def drip(link):
        link.sendall(b"HTTP/1.1 200 OK\r\n")
        while True:
            link.sendall(b"X")
            threading.Event().wait(0.02)

    scripted(SCRIPTED, drip, port=80)
    with pytest.raises(ConnectError, match=r"in 0\.3 s"):
        open_program(SCRIPTED, answer_limit_s=0.3)


@pytest.mark.parametrize(
    ("answer", "sentence"),
    [
        ((404, b"<html>nginx</html>"), r"no Robot API on controller 127\.0\.63\.5 \(port 80\): status 404"),
        ((200, {"info": "none"}), "no Robot API"),
        (b"SSH-2.0-OpenSSH_9.2\r\n", "no HTTP"),
        (b"HTTP/1.1 302 X\r\nLocation: /login\r\nContent-Length: 0\r\n\r\n", "status 302"),
        (b"HTTP/1.1 307 X\r\nLocation: http://host.invalid/\r\nContent-Length: 0\r\n\r\n", "to another host"),
        (b"HTTP/1.1 307 X\r\nLocation: openapi.json\r\nContent-Length: 0\r\n\r\n", "more than 3 times"),
        ((200, b" " * (LARGEST_ANSWER + 1)), "more than"),
        (b"", "no HTTP"),
    ],
)
def test_a_port_that_is_no_robot_api_cannot_be_opened(serve, open_program, answer, sentence):
    serve(with_answers(**{"GET openapi.json": answer}))
    with pytest.raises(ConnectError, match=sentence) as caught:
        open_program(SCRIPTED)
    assert "10.11" in caught.value.hint


def test_a_controller_without_a_web_server_cannot_be_opened(open_program):
    with pytest.raises(ConnectError, match=r"controller 127\.0\.63\.4 \(port 80\) cannot be reached"):
        open_program()


def test_an_address_that_is_none_cannot_be_opened(clock, make_config):
    for host in ("a b", "x" * 300, "[::1"):
        program = RobotApiProgram(make_config(host), clock)
        with pytest.raises(ConnectError):
            program.open()
        program.close()


@pytest.mark.parametrize(
    ("answer", "error"),
    [
        ((500, {}), DeviceStateError),
        ((200, b"[1, 2"), ProtocolError),
        ((200, {"state": 7}), ProtocolError),
        ((200, b"[" * 100_000), ProtocolError),
        (b"garbage", ProtocolError),
    ],
)
def test_an_answer_without_its_state_is_an_error_of_ours(serve, open_program, answer, error):
    serve(with_answers(**{"GET program/v1/state": answer}))
    with pytest.raises(error):
        open_program(SCRIPTED).stop()


def test_a_path_that_has_moved_is_followed_with_the_command_itself(serve, open_program):
    moved = b"HTTP/1.1 307 X\r\nLocation: /universal-robots/robot-api/program/v2/loaded\r\nContent-Length: 0\r\n\r\n"
    api = serve(with_answers(**{"PUT program/v1/loaded": moved, "PUT program/v2/loaded": {}}))
    open_program(SCRIPTED).load(PROGRAM)
    assert ("PUT program/v2/loaded", '{"name":"bend_test"}') in api.asked


def test_a_stop_gets_through_after_the_controller_was_away(start_controller, open_program, clock):
    controller = start_controller(HOST, kind=POLYSCOPE_X)
    program = open_program()
    controller.close()
    for call in (program.play, program.stop, lambda: program.check(PROGRAM), lambda: program.load(PROGRAM)):
        with pytest.raises(ConnectError, match="cannot be reached"):
            call()
    again = start_controller(HOST, kind=POLYSCOPE_X)
    again.machine.load(0)
    again.machine.play(0)
    program.stop()
    assert again.machine.program.state == "STOPPED"
    program.close()
    program.close()


def test_calls_before_opening_are_errors_of_ours(make_config, clock):
    program = RobotApiProgram(make_config(HOST), clock)
    with pytest.raises(LinkLostError, match="not open"):
        program.play()
    program.close()


@pytest.mark.parametrize(
    ("wanted", "version", "kind"),
    [
        ("auto", "10.12.0.0", RobotApiProgram),
        ("auto", "5.15.0.126652", UrDashboardProgram),
        ("auto", "", UrDashboardProgram),
        ("dashboard", "10.12.0.0", UrDashboardProgram),
        ("robot_api", "", RobotApiProgram),
    ],
)
def test_the_controllers_version_decides_unless_the_configuration_does(make_config, clock, wanted, version, kind):
    control = make_program_control(make_config(HOST, program_control=wanted), clock, controller_version=version)
    assert isinstance(control, kind)
    control.close()


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
FIELDS = st.dictionaries(st.sampled_from(["info", "state", "mode", "name", "message", "details"]), JSON, max_size=4)
REPLIES = st.one_of(
    st.tuples(st.sampled_from([200, 204, 403, 404, 408, 422, 500, 504]), FIELDS | JSON | st.binary(max_size=60)),
    st.binary(max_size=60),
    st.binary(max_size=60).map(lambda data: b"HTTP/1.1 " + data),
    st.binary(max_size=60).map(lambda data: b"HTTP/1.1 200 OK\r\n" + data + b"\r\n\r\n{}"),
    st.binary(max_size=40).map(lambda data: b"HTTP/1.1 307 X\r\nLocation: " + data + b"\r\nContent-Length: 0\r\n\r\n"),
)


def test_whatever_a_server_answers_is_an_error_of_ours_and_in_time(scripted, make_config, clock):
    api = Api()
    scripted(SCRIPTED, *[api] * 100_000, port=80)
    keys = {"answer_limit_s": 0.5, "limits": EffectLimits(0.0, 0.0)}
    program = RobotApiProgram(make_config(SCRIPTED), clock, **keys)
    calls = (program.play, program.stop, lambda: program.check(PROGRAM), lambda: program.load(PROGRAM))

    def attempt(call):
        try:
            call()
        except DeviceError as error:
            assert str(error).isprintable()

    @settings(max_examples=60, deadline=None)
    @given(st.dictionaries(st.sampled_from([*Api.READY, "PUT program/v1/state", "PUT program/v1/loaded"]), REPLIES))
    def fuzz(table):
        api.answers = Api.READY | table
        attempt(program.open)
        for call in calls:
            attempt(call)

    try:
        fuzz()
    finally:
        program.close()
