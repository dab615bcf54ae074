"""What every `ProgramControl` must do, whatever controller is behind it."""

from __future__ import annotations

import pytest

from bench.errors import DeviceStateError


def test_a_robot_that_is_ready_has_nothing_against_its_program(rig):
    rig.open()
    assert rig.control.check(rig.program) == []


def test_what_is_asked_of_the_robot_is_said_in_the_words_of_its_kind(rig, request):
    rig.open()
    asked = rig.control.ready_when
    kind = request.node.callspec.params["rig"]
    if kind in ("e-series", "polyscope-x", "cb3"):
        assert asked.endswith("safety normal, powered on, program stopped")
        assert ("remote control" in asked) == (kind != "cb3")
    else:
        assert asked
        assert "remote control" not in asked or kind == "real"


def test_a_program_the_controller_does_not_have_is_a_state_error_that_names_it(rig):
    if rig.is_register_map:
        pytest.skip("a register map chooses a program by its number, not by its name")
    rig.open()
    with pytest.raises(DeviceStateError, match="bench_conformance_missing"):
        rig.control.load("bench_conformance_missing.urp")


def test_loading_may_be_repeated(rig):
    rig.open()
    rig.control.load(rig.program)
    rig.control.load(rig.program)


def test_play_and_stop_return_when_their_effect_is_seen(rig):
    rig.open()
    rig.start()
    assert {state.runtime_state for state in rig.next_states(5)} == {2}
    rig.control.stop()
    rig.wait_for_state(lambda state: state.runtime_state == 1)
    assert {state.runtime_state for state in rig.next_states(5)} == {1}


def test_stopping_what_is_stopped_is_nothing(rig):
    rig.open()
    rig.control.load(rig.program)
    rig.control.stop()
    rig.control.stop()
    assert rig.control.check(rig.program) == []


def test_a_program_that_is_played_again_counts_from_zero(rig):
    rig.open()
    rig.start()
    rig.stream.grant_cycles(1)
    rig.wait_for_state(lambda state: state.cycle_count == 1)
    rig.control.stop()
    rig.start()
    assert {(state.cycle_count, state.cycle_running) for state in rig.next_states(5)} == {(0, 0)}


def test_it_can_be_closed_twice_and_opened_again(rig):
    rig.open()
    rig.control.close()
    rig.control.close()
    rig.control.open()
    assert rig.control.check(rig.program) == []
