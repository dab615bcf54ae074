"""Whatever a server sends, the RTDE client ends with one of its own errors, and ends."""

from __future__ import annotations

import socket
import struct
import threading
from contextlib import suppress

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from bench.config import RobotConfig
from bench.drivers.robot.ur import codec
from bench.drivers.robot.ur.codec import FrameSplitter, PackageType, encode_frame
from bench.drivers.robot.ur.recipe import DATA_TYPES, Recipe
from bench.drivers.robot.ur.state import UrStateStream
from bench.errors import ConnectError, DeviceStateError, LinkLostError, ProtocolError
from bench.model import LogEntry, RobotState
from bench.recording.messages.topics import encode_record
from bench.simulation.ur.variables import INPUT_TYPES, OUTPUT_TYPES, initial_values
from bench.timing import RunClock

HOST = "127.0.61.21"
LIMIT_S = 0.15
ALLOWED = (ProtocolError, ConnectError, LinkLostError, DeviceStateError)
STAGES = "VvOISU"
"""The packages of a controller in order: five answers, then data."""
KINDS = [int(kind) for kind in PackageType]

garbage = st.binary(min_size=1, max_size=120)
types = st.sampled_from([*DATA_TYPES, codec.NOT_FOUND, codec.IN_USE, "", "LIST"])
payloads = st.one_of(
    garbage,
    st.just(b""),
    st.lists(types, max_size=60).map(lambda names: codec.encode_setup_reply(1, names)),
    st.tuples(st.integers(0, 255), garbage).map(lambda pair: bytes([pair[0]]) + pair[1]),
)
frames = st.tuples(st.sampled_from(KINDS), payloads).map(lambda pair: encode_frame(*pair))
oversize = st.tuples(st.integers(60_000, 65_535), st.sampled_from(KINDS), garbage).map(
    lambda parts: struct.pack(">HB", parts[0], parts[1]) + parts[2]
)
cut = st.tuples(frames, st.integers(1, 20)).map(lambda pair: pair[0][: -pair[1]] or b"\x00")
damages = st.lists(st.one_of(garbage, frames, oversize, cut), min_size=1, max_size=4).map(b"".join)


@pytest.mark.parametrize(
    "decode",
    [
        codec.decode_accepted,
        codec.decode_controller_version,
        codec.decode_protocol_version,
        codec.decode_setup_reply,
        codec.decode_text,
        codec.decode_input_setup,
        lambda payload: codec.decode_output_setup(payload, 2),
        Recipe(["timestamp", "payload_cog", "robot_mode"], ["DOUBLE", "VECTOR3D", "INT32"], 1).decode,
        lambda data: FrameSplitter().feed(data),
    ],
)
@given(data=st.one_of(st.binary(max_size=80), damages))
@settings(max_examples=60, deadline=None)
def test_every_decoder_returns_or_refuses(decode, data):
    with suppress(ProtocolError):
        decode(data)


class Damaged:
    """A controller that answers rightly up to a stage and then sends something else."""

    def __init__(self, stage, damage, *, hangs_up):
        self._stage, self._damage, self._hangs_up = stage, damage, hangs_up
        self._listener = socket.create_server((HOST, 0))
        self.port = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._listener.close()
        self._thread.join()

    def _serve(self):
        link, _ = self._listener.accept()
        with link, suppress(OSError):
            splitter = FrameSplitter()
            while data := link.recv(65536):
                for kind, payload in splitter.feed(data):
                    self._answer(link, chr(kind), payload)

    def _answer(self, link, kind, payload):
        if STAGES[self._stage] == kind:
            self._send_damage(link)
        elif kind == "U":
            return  # a grant
        elif kind == "V":
            link.sendall(encode_frame(ord(kind), codec.encode_accepted(True)))
        elif kind == "v":
            link.sendall(encode_frame(ord(kind), codec.encode_controller_version((5, 15, 0, 0))))
        elif kind == "O":
            _, self._names = codec.decode_output_setup(payload, 2)
            reply = codec.encode_setup_reply(1, [OUTPUT_TYPES[name] for name in self._names])
            link.sendall(encode_frame(ord(kind), reply))
        elif kind == "I":
            reply = codec.encode_setup_reply(1, [INPUT_TYPES[name] for name in codec.decode_input_setup(payload)])
            link.sendall(encode_frame(ord(kind), reply))
        elif kind == "S":
            link.sendall(encode_frame(ord(kind), codec.encode_accepted(True)) + self._data())
            self._send_damage(link)

    def _data(self):
        values = initial_values() | {"timestamp": 61.0}
        recipe = Recipe(self._names, [OUTPUT_TYPES[name] for name in self._names], 1)
        return encode_frame(PackageType.DATA, recipe.encode([values[name] for name in self._names]))

    def _send_damage(self, link):
        link.sendall(self._damage)
        if self._hangs_up:
            link.shutdown(socket.SHUT_WR)


@given(stage=st.integers(0, len(STAGES) - 1), damage=damages, hangs_up=st.booleans())
@example(stage=3, damage=encode_frame(ord("I"), codec.encode_setup_reply(1, ["VECTOR6D"])), hangs_up=True)
@example(stage=5, damage=b"\xff\xffU", hangs_up=False)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_a_client_of_a_damaged_controller_ends_with_an_error_of_its_own(stage, damage, hangs_up):
    records, losses, ended = [], [], threading.Event()

    def lose(error):
        losses.append(error)
        ended.set()

    with Damaged(stage, damage, hangs_up=hangs_up) as server:
        config = RobotConfig(host=HOST, program="x", rate_hz=125.0, rtde_port=server.port)
        stream = UrStateStream(config, RunClock.start(), on_lost=lose, connect_timeout_s=LIMIT_S, silence_s=LIMIT_S)
        try:
            stream.open(records.append)
            assert ended.wait(20.0), "the end of the stream is not told"
        except ALLOWED as error:
            losses.append(error)
        finally:
            stream.close()
    assert [type(error) in ALLOWED for error in losses] == [True]
    assert "fault of bench" not in str(losses[0])
    assert all(isinstance(record, (RobotState, LogEntry)) and encode_record(record) for record in records)
