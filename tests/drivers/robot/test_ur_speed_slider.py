"""The speed slider of a UR controller, moved over RTDE: by one client alone, and given back."""

from __future__ import annotations

import pytest

from bench.config import CycleConfig
from bench.drivers.robot.ur.state import UrStateStream
from bench.errors import DeviceStateError, LinkLostError

HOST = "127.0.66.11"


@pytest.fixture
def controller(start_controller):
    return start_controller(HOST)


@pytest.fixture
def connect(controller, clock, make_config, sink):
    streams = []

    def open_stream(*, moves_slider=True, **keys):
        streams.append(UrStateStream(make_config(HOST, **keys), clock, moves_slider=moves_slider))
        streams[-1].open(sink)
        return streams[-1]

    yield open_stream
    for stream in streams:
        stream.close()


def test_the_slider_goes_where_it_is_asked_to_and_the_samples_say_so(connect, sink):
    stream = connect()
    for fraction in (0.2, 1.0, 0.02):
        stream.move_slider(fraction)
        sink.wait_for(lambda wanted=fraction: sink.samples and sink.samples[-1].speed_fraction == wanted)


def test_a_slider_that_is_let_go_stays_and_a_person_can_move_it(connect, sink, controller):
    stream = connect()
    stream.move_slider(0.2)
    sink.wait_for(lambda: sink.samples and sink.samples[-1].speed_fraction == 0.2)
    stream.move_slider(None)
    controller.act(lambda _: controller.machine.move_slider(0.5))
    sink.wait_for(lambda: sink.samples[-1].speed_fraction == 0.5)
    stream.grant_cycles(1)  # what is written next moves the grant alone
    sink.wait_for(lambda: controller.machine.values["input_int_register_24"] == 1)
    assert sink.samples[-1].speed_fraction == 0.5


def test_a_slider_that_another_client_holds_is_told_in_one_sentence(connect):
    connect(cycle=CycleConfig(source="joint_return"))  # claims the slider and no register
    with pytest.raises(DeviceStateError, match="speed_slider_mask and speed_slider_fraction is in use by") as caught:
        connect()
    assert "leave [run] first_cycle_speed out" in str(caught.value)


def test_nobody_is_kept_from_the_slider_where_it_is_not_wanted(connect):
    stream = connect(moves_slider=False)
    with pytest.raises(DeviceStateError, match="was not asked for its speed slider"):
        stream.move_slider(0.5)
    connect(cycle=CycleConfig(source="joint_return")).move_slider(0.5)


def test_a_slider_is_not_moved_over_a_link_that_is_closed(connect):
    stream = connect()
    stream.close()
    with pytest.raises(LinkLostError, match="cannot be told a speed"):
        stream.move_slider(0.5)
