from __future__ import annotations

import socket

import pytest

from bench.simulation.outbox import Outbox
from bench.simulation.program import PathProgram
from bench.simulation.ur.machine import CycleRegisters, Machine
from bench.simulation.ur.script import ControlScript, ScriptSession

LOWER = "def any():\n  global reg_offset_int = # comment\n0\n  x = 1"
UPPER = LOWER.replace("\n0\n", "\n24\n")
PERIOD_NS = 2_000_000


@pytest.fixture
def machine():
    made = Machine(PathProgram(), CycleRegisters(), 500.0)
    made.load(0)
    return made


@pytest.fixture
def session():
    ours, theirs = socket.socketpair()
    scripts = []
    with ours, theirs:
        made = ScriptSession(Outbox(ours, 10**10), scripts.append)
        made.scripts = scripts
        yield made


def test_a_program_may_come_in_pieces_and_two_at_once(session):
    for piece in (b"def a():\n  if True:\n  end\ne", b"nd\ndef b():\nend\nde", b"f c"):
        assert session.receive(piece)
    assert session.scripts == ["def a():\n  if True:\n  end", "def b():"]


def test_a_program_that_never_ends_is_cut_off(session):
    assert session.receive(b"x" * 1_048_577) is False


@pytest.mark.parametrize(("text", "offset"), [(LOWER, 0), (UPPER, 24)])
def test_the_control_script_takes_commands_and_says_when_it_is_ready(text, offset):
    script = ControlScript.of(text)
    values = {f"input_int_register_{offset}": 0, f"output_int_register_{offset}": 0}
    assert script.tick(values)
    assert values[f"output_int_register_{offset}"] == 1
    assert not script.tick(values | {f"input_int_register_{offset}": 255})
    assert not script.tick(values | {f"input_int_register_{offset}": 1})


def test_a_script_that_is_sent_replaces_the_program(machine):
    machine.play(0)
    machine.run_script(LOWER)
    machine.tick(1, PERIOD_NS)
    assert (machine.program.state, machine.state, machine.values["runtime_state"]) == ("STOPPED", "PLAYING", 2)
    machine.write_inputs({"input_int_register_0": 255})
    machine.tick(2, 2 * PERIOD_NS)
    assert (machine.state, machine.values["runtime_state"]) == ("STOPPED", 1)


@pytest.mark.parametrize("end", ["stop", "emergency_stop", "load", "reboot"])
def test_a_script_ends_as_a_program_does(machine, end):
    machine.run_script(LOWER)
    getattr(machine, end)(0)
    assert machine.state == "STOPPED"


def test_another_script_ends_the_program_and_nothing_runs(machine):
    machine.play(0)
    machine.run_script("def hello():\n  textmsg(1)")
    assert machine.state == "STOPPED"


def test_a_robot_that_is_off_runs_no_script(machine):
    machine.power_off(0)
    machine.run_script(LOWER)
    assert machine.state == "STOPPED"
