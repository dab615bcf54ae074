"""NatNet 2, as Motive 1.9 and 1.10 speak it: no stamps, no clock questions, markers inside of rigid bodies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from natnet_bench import RawClient, StillTracker, still_tracker

from bench.drivers.tracker.natnet.frame import NO_STAMP, decode_frame
from bench.drivers.tracker.natnet.messages import (
    ConnectRequest,
    decode_server_info,
    encode_connect,
    encode_echo_request,
)
from bench.drivers.tracker.natnet.models import RigidBodyModel, decode_models
from bench.drivers.tracker.natnet.wire import Message, encode_packet

HOST = "127.0.32.61"


@pytest.fixture(params=["2.9", "2.10"])
def version(request: pytest.FixtureRequest) -> tuple[int, int]:
    major, minor = request.param.split(".")
    return int(major), int(minor)


@pytest.fixture
def tracker(version: tuple[int, int]) -> Iterator[StillTracker]:
    with still_tracker(HOST, natnet_version=f"{version[0]}.{version[1]}") as still:
        yield still


@pytest.fixture
def client(tracker: StillTracker) -> Iterator[RawClient]:
    with RawClient(tracker.server.address) as raw:
        yield raw


def test_the_server_tells_its_version_and_no_clock(client: RawClient, version: tuple[int, int]) -> None:
    message, payload = client.ask(encode_connect(ConnectRequest("test")))
    assert (message, len(payload)) == (Message.SERVERINFO, 264)
    info = decode_server_info(payload)
    assert info.natnet_version == (*version, 0, 0)
    assert info.app_version == (1, version[1], 0, 0)
    assert info.clock_hz == 0


def test_frames_hold_all_points_and_no_stamp(
    tracker: StillTracker, client: RawClient, version: tuple[int, int]
) -> None:
    client.ask(encode_connect(ConnectRequest("test")))
    tracker.let_pass(0.1)
    frame = decode_frame(client.receive()[1], version)
    shown = tracker.scene.exposures[frame.frame_number]
    assert np.array_equal(frame.labeled["position_m"], shown.points_m)
    assert np.array_equal(frame.labeled["id"], shown.ids)
    assert frame.mid_exposure == frame.data_received == frame.transmit == NO_STAMP
    assert 0.0003 < frame.latency_s < 0.0015
    assert frame.timestamp_s == pytest.approx((frame.frame_number - 1042) * 0.01)


def test_a_bodys_markers_are_inside_of_it(tracker: StillTracker, client: RawClient, version: tuple[int, int]) -> None:
    client.ask(encode_connect(ConnectRequest("test")))
    tracker.let_pass(0.1)
    frame = decode_frame(client.receive()[1], version)
    shown = tracker.scene.exposures[frame.frame_number]
    (markers,) = frame.body_markers
    assert markers.count == 3
    assert np.array_equal(np.frombuffer(markers.body, "<f4", 9).reshape(3, 3), shown.points_m[:3])
    assert np.frombuffer(markers.body, "<i4", 3, 36).tolist() == [1, 2, 3]
    assert np.array_equal(np.frombuffer(markers.body, "<f4", 3, 48), shown.size_m[:3])


def test_models_are_in_the_layout_of_the_version(client: RawClient, version: tuple[int, int]) -> None:
    models = decode_models(client.ask(encode_packet(Message.REQUEST_MODELDEF))[1], version)
    assert [model.name for model in models if isinstance(model, RigidBodyModel)] == ["clamp"]


def test_the_clock_cannot_be_asked(client: RawClient) -> None:
    assert client.ask(encode_echo_request(5))[0] == Message.UNRECOGNIZED_REQUEST
