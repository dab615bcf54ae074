from __future__ import annotations

import math
import threading
from dataclasses import replace
from functools import partial

import pytest

from bench.config import CycleConfig
from bench.drivers.receive import KERNEL, KERNEL_STAMPS, PROGRAM, StampedSocket
from bench.drivers.robot import make_state_stream
from bench.drivers.robot.ur import link as ur_link
from bench.drivers.robot.ur.codec import PackageType, TextMessage, encode_frame, encode_text
from bench.drivers.robot.ur.recipe import Recipe
from bench.drivers.robot.ur.state import UrStateStream
from bench.errors import ConnectError, DeviceStateError, LinkLostError, ProtocolError
from bench.model import Severity
from bench.simulation.ur.kinds import E_SERIES
from bench.simulation.ur.variables import initial_values

FAULTY = "127.0.31.1"
TOO_OLD = "The controller 127.0.31.2:30004 has software 5.15.0, too old for control_step (since 5.26.0); left out."


def package(names, types, time_s):
    values = initial_values() | {"timestamp": time_s}
    return encode_frame(PackageType.DATA, Recipe(names, types, 1).encode([values[name] for name in names]))


@pytest.fixture
def open_stream(clock, sink, losses):
    """Open streams that are closed at the end whatever happens."""
    streams = []

    def start(config, **keys):
        stream = UrStateStream(config, clock, on_lost=losses, **keys)
        streams.append(stream)
        return stream, stream.open(sink)

    yield start
    for stream in streams:
        stream.close()


def test_every_tick_of_the_simulated_controller_arrives_in_order(start_controller, open_stream, make_config, sink):
    start_controller("127.0.31.2")
    _, info = open_stream(make_config("127.0.31.2"))
    sink.wait_for(lambda: len(sink.samples) >= 100)
    samples = sink.samples[:100]
    first = samples[0].sequence
    assert [sample.sequence for sample in samples] == list(range(first, first + 100))
    assert [sample.controller_time_s for sample in samples] == [sample.sequence / 125 for sample in samples]
    assert samples[0].controller_time_s > 61
    assert all(sample.capture_ns <= sample.arrival_ns for sample in samples)
    assert (samples[0].robot_mode, samples[0].safety_status, samples[0].runtime_state) == (7, 1, 1)
    assert (info.device, info.kind, info.address, info.rate_hz) == ("robot", "ur", "127.0.31.2:30004", 125.0)
    assert info.version.startswith("5.15.")
    assert [entry.text for entry in sink.logs] == [TOO_OLD]
    assert sink.logs[0].severity == Severity.INFO
    assert info.detail["left_out"] == "control_step"


@pytest.mark.parametrize(("option", "by"), [(KERNEL_STAMPS, KERNEL if KERNEL_STAMPS else PROGRAM), (None, PROGRAM)])
def test_the_device_says_who_stamps_its_arrivals(
    start_controller, open_stream, make_config, sink, monkeypatch, option, by
):
    monkeypatch.setattr(ur_link, "StampedSocket", partial(StampedSocket, option=option))
    start_controller("127.0.31.2")
    _, info = open_stream(make_config("127.0.31.2"))
    assert info.detail["stamped_by"] == by
    sink.wait_for(lambda: len(sink.samples) >= 20)
    arrivals = [sample.arrival_ns for sample in sink.samples]
    assert arrivals == sorted(arrivals)


def test_a_slower_rate_gives_each_nth_tick(start_controller, open_stream, make_config, sink):
    start_controller("127.0.31.2")
    open_stream(make_config("127.0.31.2", rate_hz=25.0))
    sink.wait_for(lambda: len(sink.samples) >= 10)
    assert [entry.text for entry in sink.logs] == [TOO_OLD]
    assert {round(sample.controller_time_s * 125) % 5 for sample in sink.samples} == {0}


def test_a_granted_cycle_is_run_once_and_counted(start_controller, open_stream, make_config, sink):
    controller = start_controller("127.0.31.2", phase_register=26)
    controller.machine.loaded = True
    stream, _ = open_stream(make_config("127.0.31.2", cycle=CycleConfig(phase_register=26)))
    controller.run_later(0, controller.machine.play)
    sink.wait_for(lambda: sink.samples and sink.samples[-1].runtime_state == 2)
    assert {sample.cycle_running for sample in sink.samples} == {0}
    stream.grant_cycles(1)
    sink.wait_for(lambda: sink.samples[-1].cycle_count == 1)
    stream.grant_cycles(2)
    sink.wait_for(lambda: sink.samples[-1].cycle_count == 2)
    running = [sample for sample in sink.samples if sample.cycle_running == 1]
    assert {sample.cycle_count for sample in running} == {0, 1}
    first = [sample.cycle_phase for sample in running if sample.cycle_count == 0]
    assert first == sorted(first)
    assert first[-1] > 0.9


def test_the_grant_of_an_earlier_run_is_withdrawn_at_opening(start_controller, open_stream, make_config):
    controller = start_controller("127.0.31.2")
    stream, _ = open_stream(make_config("127.0.31.2"))
    stream.grant_cycles(7)
    stream.close()
    _, _ = open_stream(make_config("127.0.31.2"))
    granted = threading.Event()
    controller.run_later(0, lambda _: granted.set() if controller.machine.values["input_int_register_24"] == 0 else 0)
    assert granted.wait(5)


def test_a_register_that_another_client_holds_is_named(start_controller, open_stream, make_config):
    start_controller("127.0.31.2")
    open_stream(make_config("127.0.31.2"))
    with pytest.raises(DeviceStateError, match=r"input_int_register_24 is in use .* fieldbus") as caught:
        open_stream(make_config("127.0.31.2"))
    assert "grant_register" in caught.value.hint


def test_a_released_register_can_be_claimed_again(start_controller, open_stream, make_config, sink):
    start_controller("127.0.31.2")
    first, _ = open_stream(make_config("127.0.31.2"))
    other = make_config("127.0.31.2", cycle=CycleConfig(grant_register=30))
    open_stream(other)
    first.close()
    n_before = len(sink.samples)
    sink.wait_for(lambda: len(sink.samples) > n_before + 5)
    open_stream(make_config("127.0.31.2"))


def test_a_refused_connection_is_one_sentence(open_stream, make_config):
    with pytest.raises(ConnectError, match=r"controller 127\.0\.31\.3:30004 refuses the connection"):
        open_stream(make_config("127.0.31.3"))


def test_a_host_that_cannot_be_is_one_sentence(open_stream, make_config):
    with pytest.raises(ConnectError, match="cannot be reached"):
        open_stream(make_config("x" * 70))


def test_a_controller_that_accepts_and_never_answers_is_given_up(scripted, open_stream, make_config):
    server = scripted(FAULTY, lambda link: link.recv(100))
    with pytest.raises(ConnectError, match=r"did not answer RTDE package 'V' in 0\.1 s"):
        open_stream(make_config(FAULTY, rtde_port=server.port), connect_timeout_s=0.1)


def test_a_controller_that_talks_of_other_things_for_ever_is_given_up(scripted, open_stream, make_config):
    text = encode_frame(PackageType.TEXT, encode_text(TextMessage("booting", "", 3)))

    def chatter(link):
        while True:
            link.sendall(text)

    server = scripted(FAULTY, chatter)
    with pytest.raises(ConnectError, match="did not answer RTDE package 'V'"):
        open_stream(make_config(FAULTY, rtde_port=server.port), connect_timeout_s=0.1)


def test_a_controller_that_hangs_up_in_the_handshake_is_told(scripted, open_stream, make_config):
    server = scripted(FAULTY, lambda link: (link.recv(100), link.shutdown(2)))
    with pytest.raises(ConnectError, match="closed the connection when asked for RTDE package 'V'"):
        open_stream(make_config(FAULTY, rtde_port=server.port))


@pytest.mark.parametrize(
    "answer", [b"HTTP/1.1 400 Bad Request\r\n\r\n", bytes(40), b"\x00\x04S\x01", b"\x00\x05V\x01\x01"]
)
def test_a_server_that_speaks_something_else_is_told(scripted, open_stream, make_config, answer):
    server = scripted(FAULTY, lambda link: (link.recv(100), link.sendall(answer), link.recv(100)))
    with pytest.raises(ProtocolError, match=rf"controller {FAULTY}:{server.port} is not understood"):
        open_stream(make_config(FAULTY, rtde_port=server.port))


def test_a_controller_without_protocol_version_2_is_told(scripted, open_stream, make_config, rtde_script):
    server = scripted(FAULTY, rtde_script(protocol=False))
    with pytest.raises(ProtocolError, match="does not speak RTDE protocol version 2"):
        open_stream(make_config(FAULTY, rtde_port=server.port))


def test_unknown_outputs_are_left_out_and_told(scripted, open_stream, make_config, rtde_script, sink):
    script = rtde_script(unknown=("safety_status", "actual_TCP_force"), version=(3, 5, 0, 0))
    script.after = lambda link, names, types: link.sendall(package(names, types, 61.0))
    server = scripted(FAULTY, script)
    _, info = open_stream(make_config(FAULTY, rtde_port=server.port, rate_hz=500.0))
    sink.wait_for(lambda: sink.samples)
    assert info.detail["left_out"] == "actual_TCP_force,payload,payload_cog,safety_status,tcp_offset"
    assert "safety_mode" in info.detail["recipe"]
    assert info.rate_hz == script.rate_hz == 125.0
    too_new = (
        "software 3.5.0, too old for payload (since 3.11.0), payload_cog (since 3.11.0), tcp_offset (since 3.12.0)"
    )
    assert too_new in sink.logs[0].text
    assert "does not give actual_TCP_force, safety_status; left out." in sink.logs[1].text
    assert [entry.severity for entry in sink.logs] == [Severity.INFO, Severity.WARN]
    assert not {"payload", "payload_cog", "tcp_offset"}.intersection(*script.asked)
    assert sink.samples[0].safety_status == 1


@pytest.mark.parametrize(
    ("version", "left_out"),
    [
        ((5, 4, 2, 0), "control_step,payload,payload_cog,tcp_offset"),
        ((5, 26, 0, 0), ""),
        ((10, 12, 9, 0), "control_step"),
        ((10, 13, 0, 0), ""),
        ((11, 0, 0, 0), ""),
    ],
)
def test_what_a_version_is_known_to_lack_is_not_asked_for_and_the_rest_is(
    scripted, open_stream, make_config, rtde_script, version, left_out
):
    script = rtde_script(version=version)
    server = scripted(FAULTY, script)
    _, info = open_stream(make_config(FAULTY, rtde_port=server.port))
    assert info.detail["left_out"] == left_out
    (asked,) = script.asked
    assert {"control_step", "payload", "payload_cog", "tcp_offset"} - set(asked) == set(
        filter(None, left_out.split(","))
    )


def test_our_driver_agrees_with_a_simulated_controller_of_any_version(start_controller, open_stream, make_config, sink):
    start_controller("127.0.31.2", kind=replace(E_SERIES, version=(5, 4, 0, 0)))
    _, info = open_stream(make_config("127.0.31.2"))
    sink.wait_for(lambda: sink.samples)
    assert info.detail["left_out"] == "control_step,payload,payload_cog,tcp_offset"
    assert math.isnan(sink.samples[0].payload_kg)
    assert sink.samples[0].control_step == -1


@pytest.mark.parametrize("name", ["timestamp", "output_int_register_24", "output_int_register_25"])
def test_without_the_outputs_that_tell_the_cycles_nothing_starts(scripted, open_stream, make_config, rtde_script, name):
    server = scripted(FAULTY, rtde_script(unknown=(name,)))
    with pytest.raises(DeviceStateError, match=f"has no output {name}"):
        open_stream(make_config(FAULTY, rtde_port=server.port))


def test_a_fieldbus_that_holds_the_register_is_told(scripted, open_stream, make_config, rtde_script):
    server = scripted(FAULTY, rtde_script(in_use=True))
    with pytest.raises(DeviceStateError, match="EtherNet/IP"):
        open_stream(make_config(FAULTY, rtde_port=server.port))


def test_a_controller_that_refuses_to_start_is_told(scripted, open_stream, make_config, rtde_script):
    server = scripted(FAULTY, rtde_script(starts=False))
    with pytest.raises(DeviceStateError, match="refuses to start"):
        open_stream(make_config(FAULTY, rtde_port=server.port))


def test_packages_around_the_reply_to_start_are_all_kept(scripted, open_stream, make_config, rtde_script, sink):
    script = rtde_script()
    script.before_start = lambda link, names, types: link.sendall(package(names, types, 61.0))

    def after(link, names, types):
        text = encode_frame(PackageType.TEXT, encode_text(TextMessage("SafetySetup has not been confirmed yet", "", 2)))
        link.sendall(text + package(names, types, 61.008) + package(names, types, 61.016))

    script.after = after
    server = scripted(FAULTY, script)
    open_stream(make_config(FAULTY, rtde_port=server.port))
    sink.wait_for(lambda: len(sink.samples) == 3)
    assert [sample.controller_time_s for sample in sink.samples] == [61.0, 61.008, 61.016]
    assert "SafetySetup" in sink.logs[0].text


def test_a_closed_controller_is_a_lost_link(start_controller, open_stream, make_config, sink, losses):
    controller = start_controller("127.0.31.2")
    stream, _ = open_stream(make_config("127.0.31.2"))
    sink.wait_for(lambda: sink.samples)
    controller.close()
    error = losses.wait()
    assert isinstance(error, LinkLostError)
    assert "127.0.31.2:30004" in str(error)
    assert [entry.severity for entry in sink.logs] == [Severity.INFO, Severity.ERROR]
    stream.close()
    with pytest.raises(LinkLostError, match="not open"):
        stream.grant_cycles(1)
    assert len(losses.errors) == 1


def test_silence_is_a_lost_link(scripted, open_stream, make_config, rtde_script, losses, sink):
    server = scripted(FAULTY, rtde_script())
    open_stream(make_config(FAULTY, rtde_port=server.port), silence_s=0.1)
    assert "sent nothing for 0.1 s" in str(losses.wait())
    assert sink.logs[-1].severity == Severity.ERROR


@pytest.mark.parametrize("damage", [b"\x00\x01\x55", b"\x00\x05U\x01\x00", b"\x00\x0cU\x02" + bytes(8)])
def test_bytes_that_cannot_be_read_end_the_stream_loudly(
    scripted, open_stream, make_config, rtde_script, losses, damage
):
    script = rtde_script(after=lambda link, names, types: link.sendall(damage))
    server = scripted(FAULTY, script)
    open_stream(make_config(FAULTY, rtde_port=server.port))
    assert "not understood any more" in str(losses.wait())


def test_the_stream_may_be_closed_from_its_own_loss(scripted, make_config, rtde_script, clock, sink):
    closed = threading.Event()
    stream = None

    def close(_error):
        stream.close()
        closed.set()

    server = scripted(FAULTY, rtde_script(after=lambda link, *_: link.shutdown(2)))
    stream = make_state_stream(make_config(FAULTY, rtde_port=server.port), clock, on_lost=close)
    stream.open(sink)
    assert closed.wait(5)
    stream.close()


def test_closing_is_quiet_and_may_be_repeated(start_controller, open_stream, make_config, sink, losses, clock):
    UrStateStream(make_config("127.0.31.2"), clock).close()
    start_controller("127.0.31.2")
    stream, _ = open_stream(make_config("127.0.31.2"))
    sink.wait_for(lambda: sink.samples)
    stream.close()
    stream.close()
    assert not losses.errors
    assert [entry.text for entry in sink.logs] == [TOO_OLD]


def test_an_open_stream_cannot_be_opened_again(start_controller, open_stream, make_config, sink):
    start_controller("127.0.31.2")
    stream, _ = open_stream(make_config("127.0.31.2"))
    with pytest.raises(LinkLostError, match="open already"):
        stream.open(sink)
