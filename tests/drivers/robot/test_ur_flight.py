"""The bytes that a UR controller sent last are kept when its link ends badly."""

from __future__ import annotations

import pytest

from bench.drivers.flight import FlightRecorder
from bench.drivers.robot.ur.state import UrStateStream
from bench.errors import ProtocolError
from bench.model import Severity

HOST = "127.0.61.31"
GARBAGE = b"\x00\x01\xffHTTP/1.1 400 Bad Request\r\n"


@pytest.fixture
def make_stream(make_config, clock, losses, tmp_path):
    streams = []

    def make(port):
        flight = FlightRecorder("robot", clock, tmp_path / "run-1")
        stream = UrStateStream(make_config(HOST, rtde_port=port), clock, on_lost=losses, flight=flight)
        streams.append(stream)
        return stream

    yield make
    for stream in streams:
        stream.close()


def test_garbage_in_the_stream_ends_up_in_a_file_that_the_message_names(
    scripted, rtde_script, make_stream, sink, losses, tmp_path
):
    server = scripted(HOST, rtde_script(after=lambda link, *_: link.sendall(GARBAGE)))
    make_stream(server.port).open(sink)
    error = losses.wait()
    path = tmp_path / "run-1.robot-packets-1.txt"
    assert f"packets of the link are in {path}." in str(error)
    assert [entry.text for entry in sink.logs if entry.severity == Severity.ERROR] == [str(error)]
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# The controller 127.0.61.31:")
    packets = [line.split(" ")[1:] for line in lines[2:]]
    assert b"".join(bytes.fromhex(data) for direction, data in packets if direction == "<").endswith(GARBAGE)
    assert bytes.fromhex(next(data for direction, data in packets if direction == ">")) == b"\x00\x05V\x00\x02"


def test_garbage_instead_of_an_answer_is_kept_too(scripted, make_stream, sink, tmp_path):
    def answer(link):
        link.recv(100)
        link.sendall(GARBAGE)
        link.recv(100)

    server = scripted(HOST, answer)
    with pytest.raises(ProtocolError) as caught:
        make_stream(server.port).open(sink)
    (path,) = tmp_path.iterdir()
    assert caught.value.hint.endswith(f"The last 2 packets of the link are in {path}.")
    assert f" < {GARBAGE.hex()}\n" in path.read_text(encoding="utf-8")


def test_a_link_that_is_closed_on_purpose_leaves_no_file(start_controller, make_config, clock, sink, tmp_path):
    start_controller(HOST)
    flight = FlightRecorder("robot", clock, tmp_path / "run-1")
    stream = UrStateStream(make_config(HOST), clock, flight=flight)
    stream.open(sink)
    sink.wait_for(lambda: sink.samples)
    stream.close()
    assert not list(tmp_path.iterdir())
