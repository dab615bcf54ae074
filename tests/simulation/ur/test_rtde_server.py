from __future__ import annotations

import math
import socket
import struct
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bench.drivers.robot.ur.codec import (
    FrameSplitter,
    PackageType,
    TextMessage,
    decode_accepted,
    decode_controller_version,
    decode_setup_reply,
    decode_text,
    encode_frame,
    encode_input_setup,
    encode_output_setup,
    encode_protocol_version,
    encode_text,
)
from bench.drivers.robot.ur.recipe import Recipe
from bench.drivers.robot.ur.versions import SINCE
from bench.simulation.program import PathProgram
from bench.simulation.ur.kinds import E_SERIES
from bench.simulation.ur.machine import CycleRegisters, Machine
from bench.simulation.ur.outbox import Outbox
from bench.simulation.ur.rtde import RtdeServer, RtdeSession

RATE_HZ = 500.0
PERIOD_NS = 2_000_000
PROGRAM = PathProgram(cycle_s=0.1)


class Client:
    """One connected client, without a network: what it sends is answered at once."""

    def __init__(self, server):
        ours, self._theirs = socket.socketpair()
        ours.setblocking(False)
        self._theirs.setblocking(False)
        self.outbox = Outbox(ours, 10**10)
        self.session = RtdeSession(server, self.outbox)
        server.add(self.session)
        self._splitter = FrameSplitter()

    def close(self):
        self.session.close()
        self.outbox.close()
        self._theirs.close()

    def read(self):
        try:
            return self._splitter.feed(self._theirs.recv(1 << 20))
        except BlockingIOError:
            return []

    def ask(self, kind, payload=b""):
        assert self.session.receive(encode_frame(kind, payload))
        ((answered, reply),) = self.read()
        assert answered == kind
        return reply

    def outputs(self, names, rate_hz=RATE_HZ):
        return decode_setup_reply(self.ask(PackageType.SETUP_OUTPUTS, encode_output_setup(names, rate_hz)))

    def inputs(self, *names):
        return decode_setup_reply(self.ask(PackageType.SETUP_INPUTS, encode_input_setup(names)))

    def version_2(self):
        assert decode_accepted(self.ask(PackageType.PROTOCOL_VERSION, encode_protocol_version(2)))
        return self

    def start(self, names, rate_hz=RATE_HZ):
        recipe_id, types = self.version_2().outputs(names, rate_hz)
        assert decode_accepted(self.ask(PackageType.START))
        return Recipe(names, types, recipe_id)


class World:
    def __init__(self):
        self.machine = Machine(PROGRAM, CycleRegisters(phase=26), RATE_HZ)
        self.server = RtdeServer(self.machine, RATE_HZ)
        self.clients = []
        self.tick_number = 30625

    def connect(self):
        self.clients.append(Client(self.server))
        return self.clients[-1]

    def tick(self, count=1):
        for _ in range(count):
            self.machine.tick(self.tick_number, self.tick_number * PERIOD_NS)
            self.server.send_packages(self.tick_number, self.tick_number * PERIOD_NS)
            self.tick_number += 1

    def close(self):
        for client in self.clients:
            client.close()


@pytest.fixture
def world():
    made = World()
    yield made
    PROGRAM.stop()
    made.close()


def test_versions_1_and_2_are_spoken_and_no_other(world):
    client = world.connect()
    answers = [client.ask(PackageType.PROTOCOL_VERSION, encode_protocol_version(version)) for version in (0, 1, 2, 3)]
    assert [decode_accepted(answer) for answer in answers] == [False, True, True, False]
    assert decode_controller_version(client.ask(PackageType.CONTROLLER_VERSION))[:2] == (5, 15)


def test_the_time_is_the_tick_count_times_the_period_exactly(world):
    client = world.connect()
    recipe = client.start(["timestamp"])
    world.tick(5)
    times = [recipe.decode(payload)["timestamp"] for _, payload in client.read()]
    assert times == [tick / RATE_HZ for tick in range(30625, 30630)]
    assert times[0] == 61.25


def test_a_lower_rate_gives_each_nth_tick_and_a_higher_one_every_tick(world):
    slow, fast, odd = world.connect(), world.connect(), world.connect()
    for client, rate_hz in ((slow, 125.0), (fast, 1000.0), (odd, math.nan)):
        client.start(["timestamp"], rate_hz)
    received = [0, 0, 0]
    for _ in range(10):
        world.tick(50)
        received = [n + len(client.read()) for n, client in zip(received, (slow, fast, odd), strict=True)]
    assert received == [125, 500, 1]


def test_nothing_is_sent_before_start_nor_while_paused(world):
    client = world.connect().version_2()
    assert not decode_accepted(client.ask(PackageType.START))
    client.outputs(["timestamp"])
    world.tick(3)
    assert client.read() == []
    assert decode_accepted(client.ask(PackageType.START))
    world.tick(2)
    assert len(client.read()) == 2
    assert decode_accepted(client.ask(PackageType.PAUSE))
    world.tick(3)
    assert client.read() == []


def test_an_unknown_output_is_marked_in_its_place_and_refuses_the_recipe(world):
    client = world.connect().version_2()
    assert client.outputs(["timestamp", "no_such", "actual_q"]) == (0, ["DOUBLE", "NOT_FOUND", "VECTOR6D"])
    assert not decode_accepted(client.ask(PackageType.START))
    assert client.outputs(["timestamp", "robot_mode"]) == (1, ["DOUBLE", "INT32"])


@pytest.mark.parametrize(
    ("version", "lacks"),
    [
        ((3, 10, 0, 0), {"tcp_offset", "payload", "payload_cog", "payload_inertia"}),
        ((5, 15, 0, 0), {"actual_current_as_torque", "control_step"}),
        ((5, 26, 0, 0), set()),
        ((10, 12, 0, 0), {"control_step"}),
    ],
)
def test_outputs_that_came_after_the_version_are_not_found(world, version, lacks):
    world.server.machine.kind = replace(E_SERIES, version=version)
    client = world.connect().version_2()
    for name in SINCE:
        recipe_id, types = client.outputs(["timestamp", name])
        assert (types[1] == "NOT_FOUND") == (name in lacks), name
        assert recipe_id == (0 if name in lacks else 1)


def test_protocol_version_1_has_neither_rate_nor_recipe_number(world):
    client = world.connect()
    reply = client.ask(PackageType.SETUP_OUTPUTS, encode_output_setup(["timestamp", "runtime_state"], None))
    assert reply == b"DOUBLE,UINT32"
    client.ask(PackageType.START)
    world.tick(4)
    ((_, payload),) = client.read()
    assert struct.unpack(">dI", payload)[1] == 1


def test_inputs_are_numbered_per_connection_and_belong_to_one_client(world):
    first, second = world.connect().version_2(), world.connect().version_2()
    assert first.inputs("input_int_register_24") == (1, ["INT32"])
    assert first.inputs("input_double_register_24", "input_bit_register_64") == (2, ["DOUBLE", "BOOL"])
    assert second.inputs("input_int_register_25", "input_int_register_24") == (0, ["INT32", "IN_USE"])
    assert second.inputs("input_int_register_25") == (1, ["INT32"])
    assert second.inputs("nothing") == (0, ["NOT_FOUND"])
    first.close()
    world.clients.remove(first)
    assert second.inputs("input_int_register_24") == (2, ["INT32"])


def test_inputs_are_kept_when_their_writer_is_gone(world):
    writer = world.connect().version_2()
    writer.inputs("input_int_register_24")
    writer.session.receive(encode_frame(PackageType.DATA, struct.pack(">Bi", 1, 7)))
    writer.close()
    world.clients.remove(writer)
    reader = world.connect()
    recipe = reader.start(["input_int_register_24"])
    world.tick()
    assert recipe.decode(reader.read()[0][1]) == {"input_int_register_24": 7}


def test_inputs_without_a_recipe_are_answered_by_a_text(world):
    client = world.connect().version_2()
    client.session.receive(encode_frame(PackageType.DATA, b"\x05\x00\x00\x00\x01"))
    ((kind, payload),) = client.read()
    assert kind == PackageType.TEXT
    assert decode_text(payload).level == 1


def test_a_list_of_names_beyond_the_limit_is_refused(world):
    client = world.connect().version_2()
    names = [f"output_double_register_{place}" for place in range(48)] * 2
    client.session.receive(encode_frame(PackageType.SETUP_OUTPUTS, encode_output_setup(names, 500.0)))
    (text, reply) = client.read()
    assert "2048" in decode_text(text[1]).text
    assert decode_setup_reply(reply[1])[0] == 0


def test_the_program_runs_granted_cycles_and_tells_them(world):
    names = [
        "output_int_register_24",
        "output_int_register_25",
        "output_double_register_26",
        "runtime_state",
        "actual_q",
    ]
    client = world.connect()
    recipe = client.start([*names, "actual_qd"])
    client.inputs("input_int_register_24")
    world.machine.load(0)
    world.machine.play(0)
    world.tick(20)
    waiting = [recipe.decode(payload) for _, payload in client.read()]
    assert {state["output_int_register_24"] for state in waiting} == {0}
    client.session.receive(encode_frame(PackageType.DATA, struct.pack(">Bi", 1, 1)))
    world.tick(100)
    states = [recipe.decode(payload) for _, payload in client.read()]
    assert states[-1]["output_int_register_24"] == 1
    assert {state["output_int_register_25"] for state in states} == {0, 1}
    assert max(state["output_double_register_26"] for state in states) > 0.9
    assert {state["runtime_state"] for state in states} == {2}
    turned = sum(state["actual_qd"][1] / RATE_HZ for state in states)
    assert turned == pytest.approx(states[-1]["actual_q"][1] - waiting[0]["actual_q"][1], abs=0.02)


def test_the_speed_slider_and_the_outputs_act(world):
    client = world.connect().version_2()
    client.inputs("speed_slider_mask", "speed_slider_fraction")
    client.inputs("standard_digital_output_mask", "standard_digital_output")
    client.session.receive(encode_frame(PackageType.DATA, struct.pack(">BId", 1, 1, 0.5)))
    client.session.receive(encode_frame(PackageType.DATA, struct.pack(">BBB", 2, 3, 1)))
    client.session.receive(encode_frame(PackageType.DATA, struct.pack(">BBB", 2, 1, 0)))
    client.session.receive(encode_frame(PackageType.DATA, struct.pack(">BBB", 2, 2, 2)))
    client.session.receive(encode_frame(PackageType.DATA, struct.pack(">BId", 1, 1, math.nan)))
    assert world.machine.values["target_speed_fraction"] == 0.5
    assert world.machine.values["actual_digital_output_bits"] == 2


def test_texts_of_a_client_are_taken_and_garbage_ends_the_connection(world):
    client = world.connect().version_2()
    assert client.session.receive(encode_frame(PackageType.TEXT, encode_text(TextMessage("hello", "me", 3))))
    assert not client.session.receive(b"GET / HTTP/1.1\r\n")


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.sampled_from(list(PackageType)), st.binary(max_size=30)), max_size=8))
def test_no_request_breaks_the_server(frames):
    world = World()
    try:
        client = world.connect()
        client.session.receive(b"".join(encode_frame(kind, payload) for kind, payload in frames))
        world.tick(2)
    finally:
        world.close()
