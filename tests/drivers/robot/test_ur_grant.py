"""A grant is there for the cycle it is given to, and for no other: not for a program that somebody starts again."""

from __future__ import annotations

import time

import pytest

from bench.drivers.robot.ur.grant import Grant
from bench.drivers.robot.ur.state import UrStateStream
from bench.model import RobotState

HOST = "127.0.67.11"
REGISTER = "input_int_register_24"


def state(count: int, running: int, runtime_state: int = 2) -> RobotState:
    return RobotState(0, 0, 0, 0, 0.0, runtime_state=runtime_state, cycle_count=count, cycle_running=running)


def wait_until(is_so):
    deadline = time.monotonic() + 20.0
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.002)


@pytest.fixture
def controller(start_controller):
    return start_controller(HOST)


@pytest.fixture
def stream(controller, make_config, clock, sink):
    stream = UrStateStream(make_config(HOST), clock)
    stream.open(sink)
    yield stream
    stream.close()


def begin_cycle_2(controller, stream, sink):
    """Play, drive one cycle, and leave when the second is on its way and its grant is taken back."""
    controller.act(controller.machine.load)
    controller.act(controller.machine.play)
    stream.grant_cycles(1)
    sink.wait_for(lambda: sink.samples and sink.samples[-1].cycle_count == 1)
    stream.grant_cycles(2)
    sink.wait_for(lambda: sink.samples[-1].cycle_running == 1)
    wait_until(lambda: controller.machine.values[REGISTER] == 0)


def test_a_cycle_whose_grant_is_taken_back_is_driven_to_its_end_and_the_next_needs_another(controller, stream, sink):
    begin_cycle_2(controller, stream, sink)
    sink.wait_for(lambda: sink.samples[-1].cycle_count == 2)
    n = len(sink.samples)
    sink.wait_for(lambda: len(sink.samples) > n + 60)  # longer than a cycle
    assert {(sample.cycle_count, sample.cycle_running) for sample in sink.samples[n:]} == {(2, 0)}
    stream.grant_cycles(3)
    sink.wait_for(lambda: sink.samples[-1].cycle_count == 3)


@pytest.mark.parametrize("bench_is_there", [True, False])
def test_a_program_that_somebody_starts_again_stands(controller, stream, sink, bench_is_there):
    begin_cycle_2(controller, stream, sink)
    if not bench_is_there:
        stream.close()
    machine = controller.machine
    controller.act(machine.stop)
    wait_until(lambda: machine.values["runtime_state"] == 1)
    controller.act(machine.play)
    wait_until(lambda: machine.values["runtime_state"] == 2)
    wait_until(lambda: machine.values["output_int_register_24"] == 0)
    began_s = machine.values["timestamp"]
    seen = set()

    def has_stood_for_five_cycles():
        seen.add((machine.values["output_int_register_24"], machine.values["output_int_register_25"]))
        return machine.values["timestamp"] > began_s + 2.0

    wait_until(has_stood_for_five_cycles)
    assert seen == {(0, 0)}


def test_the_grant_is_used_when_the_last_granted_cycle_has_begun():
    grant = Grant()
    assert not grant.note_state(state(0, 0))
    grant.note_written(2, 0)
    assert [grant.note_state(sample) for sample in (state(0, 1), state(1, 0), state(1, 1))] == [False, False, True]


def test_a_mark_that_outlives_its_count_is_not_taken_for_the_next_cycle():
    grant = Grant()
    grant.note_state(state(0, 0))
    grant.note_written(1, 0)
    grant.note_state(state(0, 1))
    grant.note_written(2, 0)
    assert [grant.note_state(sample) for sample in (state(1, 1), state(1, 0), state(1, 1))] == [False, False, True]


def test_a_cycle_of_which_only_the_end_was_seen_has_used_its_grant():
    grant = Grant()
    grant.note_written(1, 0)
    assert grant.note_state(state(1, 0))


def test_a_program_that_does_not_count_keeps_its_grant():
    grant = Grant()
    grant.note_written(1, 0)
    assert not any(grant.note_state(state(-1, -1)) for _ in range(3))


@pytest.mark.parametrize(
    ("shown", "n_runs", "is_the_same"),
    [
        (state(1, 1), 0, True),
        (state(1, 1), 1, False),
        (state(1, 0, runtime_state=1), 0, False),
        (state(3, 0), 0, False),
        (None, 0, False),
    ],
)
def test_a_grant_belongs_to_the_run_of_the_program_it_was_given_to(shown, n_runs, is_the_same):
    grant = Grant()
    grant.note_written(2, 0)
    assert grant.is_for(shown, n_runs) is is_the_same
