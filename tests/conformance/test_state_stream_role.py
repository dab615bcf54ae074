"""What every `StateStream` must do, whatever robot is behind it."""

from __future__ import annotations

from itertools import pairwise

import pytest

N_STATES = 25


def test_it_names_itself(rig):
    info = rig.open()
    assert info.device == "robot"
    assert info.kind
    assert info.address
    assert info.rate_hz > 0


def test_states_arrive_in_order_and_gaps_are_counted(rig):
    rig.open()
    states = rig.next_states(N_STATES)
    assert all(earlier.arrival_ns <= later.arrival_ns for earlier, later in pairwise(states))
    assert all(earlier.controller_time_s <= later.controller_time_s for earlier, later in pairwise(states))
    steps = [later.sequence - earlier.sequence for earlier, later in pairwise(states)]
    assert min(steps) >= 1
    rig.wait_for(lambda: rig.n_missed >= sum(steps) - len(steps))
    assert {state.segment for state in states} == {states[0].segment}


def test_the_place_of_a_state_is_that_of_its_controller_time(rig):
    if rig.is_register_map:
        pytest.skip("a register map is polled: its states stand on the grid of the polls")
    info = rig.open()
    for state in rig.next_states(N_STATES):
        assert state.controller_time_s * info.rate_hz == pytest.approx(state.sequence, abs=0.05)


def test_a_program_that_is_granted_nothing_begins_nothing(rig):
    rig.open()
    rig.start()
    states = rig.next_states(N_STATES)
    assert {(state.cycle_count, state.cycle_running) for state in states} == {(0, 0)}


def test_a_grant_runs_exactly_that_many_cycles_and_a_larger_one_goes_on_from_there(rig):
    rig.open()
    rig.start()
    for total in (2, 3):
        rig.stream.grant_cycles(total)
        rig.wait_for_state(lambda state, total=total: state.cycle_count == total)
        after = rig.next_states(N_STATES)
        assert {(state.cycle_count, state.cycle_running) for state in after} == {(total, 0)}
    counts = [state.cycle_count for state in rig.states]
    begun = counts[len(counts) - 1 - counts[::-1].index(0) :]
    assert {later - earlier for earlier, later in pairwise(begun)} == {0, 1}


def test_it_can_be_closed_twice_and_opened_again(rig):
    rig.stream.close()
    rig.stream.open(rig.sink)
    rig.next_states(3)
    rig.stream.close()
    rig.stream.close()
    rig.stream.open(rig.sink)
    rig.next_states(3)
