"""The tracker's faults by way of the admin channel, with its scheduler running."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator

import pytest
from natnet_bench import PATIENCE_S, RawClient, SimulatedTracker, running_tracker

from bench.drivers.tracker.natnet.messages import ConnectRequest, decode_server_info, encode_connect, encode_request
from bench.drivers.tracker.natnet.models import RigidBodyModel, decode_models
from bench.drivers.tracker.natnet.wire import Message, encode_packet
from bench.simulation.admin import AdminServer
from bench.simulation.program import PathProgram
from bench.simulation.ur import UrController

HOST = "127.0.32.51"
PORT = 30_097


@pytest.fixture
def tracker() -> Iterator[SimulatedTracker]:
    with running_tracker(HOST) as running:
        yield running


@pytest.fixture
def tell(tracker: SimulatedTracker) -> Iterator[Callable[[str], str]]:
    robot = UrController(HOST, PathProgram(), tracker.scheduler, tracker.clock, controller_clock=tracker.tracker_clock)
    admin = AdminServer(HOST, PORT, robot, tracker.server, tracker.clock)
    admin.open()
    with socket.create_connection((HOST, PORT), PATIENCE_S) as link, link.makefile("r") as answers:

        def tell(command: str) -> str:
            link.sendall(f"{command}\n".encode())
            return answers.readline().strip()

        yield tell
    admin.close()


def test_a_restart_sets_the_clock_back(tracker: SimulatedTracker, tell: Callable[[str], str]) -> None:
    before = tracker.server._read_clock()
    assert tell("tracker_restart") == "ok"
    assert tracker.server._read_clock() < before


def test_a_version_is_changed_or_refused(tracker: SimulatedTracker, tell: Callable[[str], str]) -> None:
    assert tell("tracker_version 3.0") == "ok"
    with RawClient(tracker.server.address) as client:
        info = decode_server_info(client.ask(encode_connect(ConnectRequest("test")))[1])
    assert info.natnet_version == (3, 0, 0, 0)
    assert tell("tracker_version 5.0") == "error: '5.0' is none of 2.9, 2.10, 3.0, 3.1, 4.0, 4.1, 4.2, 4.3"


def test_a_body_is_defined(tracker: SimulatedTracker, tell: Callable[[str], str]) -> None:
    assert tell("tracker_body wand") == "ok"
    with RawClient(tracker.server.address) as client:
        models = decode_models(client.ask(encode_packet(Message.REQUEST_MODELDEF))[1], (4, 1))
    assert [model.name for model in models if isinstance(model, RigidBodyModel)] == ["clamp", "wand"]


def test_frames_are_lost_doubled_and_numbers_left_out(tracker: SimulatedTracker, tell: Callable[[str], str]) -> None:
    with RawClient(tracker.server.address) as client:
        client.ask(encode_connect(ConnectRequest("test")))
        assert client.receive()[0] == Message.FRAMEOFDATA
        assert [tell(f"tracker_{what} 2") for what in ("lose", "double", "jump")] == ["ok"] * 3
        for _ in range(40):
            assert client.receive()[0] == Message.FRAMEOFDATA
    assert tracker.server.delivery.n_lost == 2
    assert tracker.server.delivery.n_doubled == 2
    numbers = sorted(tracker.scene.exposures)
    assert numbers[-1] - numbers[0] + 1 - len(numbers) == 2


def test_a_number_that_is_none_is_refused(tell: Callable[[str], str]) -> None:
    assert tell("tracker_lose many") == "error: 'many' is not a number from 0 to 1000000"


def test_a_request_still_works_after_all_that(tracker: SimulatedTracker, tell: Callable[[str], str]) -> None:
    assert tell("tracker_restart") == "ok"
    with RawClient(tracker.server.address) as client:
        assert client.ask(encode_request("FrameRate"))[0] == Message.RESPONSE
