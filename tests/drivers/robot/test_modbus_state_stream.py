"""The state stream of a Modbus controller, at the wire: what it says, and what it says when things go wrong."""

from __future__ import annotations

import itertools
import math
import socket
import threading

import pytest
from modbus_bench import make_config, rig, wait_until

from bench.drivers.robot.modbus import ModbusStateStream
from bench.errors import ConnectError, DeviceStateError, DeviceTimeoutError, LinkLostError
from bench.timing import RunClock

QUICK = ("unit_id = 1", "unit_id = 1\ntimeout_s = 0.1\nretries = 0")


def test_every_poll_is_a_state_with_a_stamp_between_request_and_answer() -> None:
    with rig() as bench, bench.streaming():
        wait_until(lambda: len(bench.seen.states) >= 40, "40 states")
        states = bench.seen.states
    steps = [b.sequence - a.sequence for a, b in itertools.pairwise(states)]
    assert set(steps) == {1}
    assert not bench.seen.missed
    assert all(state.capture_ns <= state.arrival_ns for state in states)
    assert all(b.controller_time_s >= a.controller_time_s for a, b in itertools.pairwise(states))
    assert {state.segment for state in states} == {0}


def test_what_is_mapped_is_there_and_what_is_not_is_missing() -> None:
    with rig() as bench, bench.streaming():
        wait_until(lambda: bench.seen.states, "a state")
        state = bench.seen.states[0]
    assert 61.0 < state.controller_time_s < 100.0
    assert (state.cycle_count, state.cycle_running, state.runtime_state, state.safety_status) == (0, 0, 1, 1)
    assert state.cycle_phase == 0.0
    assert state.speed_fraction == pytest.approx(1.0)
    assert all(abs(q) < 7 for q in state.q_rad)
    assert all(abs(x) < 3 for x in state.tcp_pose[:3])
    assert all(math.isnan(r) for r in state.tcp_pose[3:])
    assert all(math.isnan(v) for v in state.qd_rad_s)
    assert state.robot_mode == -1


def test_the_controller_is_described_with_the_accuracy_of_its_cycles() -> None:
    with rig() as bench:
        stream = bench.make_stream()
        try:
            info = stream.open(bench.seen.records.append)
        finally:
            stream.close()
    assert (info.device, info.kind, info.rate_hz) == ("robot", "modbus", 50.0)
    assert info.detail["cycle_accuracy_s"] == "0.02"
    assert info.detail["requests"] == "discrete 2..2, input 0..17"
    assert info.detail["heartbeat_promise"] == "pauses the program after 2 s"


@pytest.mark.parametrize("restarts", ["true", "false"])
def test_cycles_are_granted_one_by_one_and_counted_from_zero(restarts: str) -> None:
    counter = ('cycle_counter = { table = "input"', f'cycle_counter = {{ restarts = {restarts}, table = "input"')
    with rig(counter) as bench, bench.streaming() as stream, bench.commanding() as program:
        seen = bench.seen
        stream.grant_cycles(0)
        program.play()
        wait_until(lambda: (seen.states[-1].cycle_count, seen.states[-1].cycle_running) == (0, 0), "waiting")
        for total in range(1, 9):  # over the end of a 16-bit counter that stands at 65530
            stream.grant_cycles(total)
            wait_until(lambda total=total: seen.states[-1].cycle_count == total, f"cycle {total}")  # type: ignore[misc]
        program.stop()
        wait_until(lambda: seen.states[-1].runtime_state == 1, "stopped")
    counts = [state.cycle_count for state in seen.states]
    assert set(counts[-1:]) == {8}
    assert all(b - a in (0, 1) for a, b in itertools.pairwise(counts))
    marks = [state.cycle_running for state in seen.states]
    assert sum(b > a for a, b in itertools.pairwise(marks)) == 8
    assert not seen.lost


def test_a_pause_a_fault_and_an_open_interlock_are_told_in_the_words_of_the_run() -> None:
    with rig(cycle_s=60.0) as bench, bench.streaming() as stream, bench.commanding() as program:
        seen, logic = bench.seen, bench.controller.logic
        program.play()
        stream.grant_cycles(1)
        wait_until(lambda: seen.states[-1].cycle_running == 1, "on the path")
        bench.controller.logic.program.pause()
        wait_until(lambda: seen.states[-1].runtime_state == 4, "paused")
        assert seen.states[-1].cycle_running == 1
        logic.open_interlocks.add("guard door")
        wait_until(lambda: seen.states[-1].safety_status == 5, "interlock")
        logic.open_interlocks.clear()
        wait_until(lambda: seen.states[-1].safety_status == 1, "closed")
        logic.fault_code = 17
        wait_until(lambda: (seen.states[-1].runtime_state, seen.states[-1].safety_status) == (1, 9), "fault")
    told = " ".join(seen.texts)
    assert "shows the interlock 'guard door' open." in told
    assert "shows the interlock 'guard door' in order." in told
    assert "shows fault code 17." in told


def test_a_refused_request_is_a_line_in_the_log_and_after_a_while_a_lost_link() -> None:
    with rig() as bench, bench.streaming():
        wait_until(lambda: bench.seen.states, "a state")
        bench.controller.server.exception_code = 6
        wait_until(lambda: bench.seen.lost, "a lost link")
    assert "refuses reading discrete 2..2: exception 6, device busy." in bench.seen.texts[-2]
    assert "gave no state for 0.4 s" in str(bench.seen.lost[0])
    assert "exception 6, device busy" in str(bench.seen.lost[0])
    assert len(bench.seen.lost) == 1


def test_a_frozen_controller_is_lost_without_a_hang_and_welcome_back() -> None:
    with rig(QUICK) as bench, bench.streaming(reconnect_s=20.0, silence_s=0.2) as stream:
        seen = bench.seen
        wait_until(lambda: seen.states, "a state")
        bench.controller.server.is_frozen = True
        wait_until(lambda: seen.lost, "a lost link")
        assert "did not answer within 0.1 s" in str(seen.lost[0])
        with pytest.raises(LinkLostError, match="did not take the grant of cycle 3"):
            stream.grant_cycles(3)
        n_before = len(seen.states)
        bench.controller.server.is_frozen = False
        wait_until(lambda: seen.restored == 1, "restored")
        wait_until(lambda: len(seen.states) > n_before + 5, "states again")
    assert seen.states[-1].segment == 1
    assert sum(seen.missed) > 0
    assert len(seen.lost) == 1


def test_late_answers_are_missed_polls_and_never_taken_for_another() -> None:
    with rig(QUICK) as bench, bench.streaming(silence_s=5.0):
        seen = bench.seen
        wait_until(lambda: len(seen.states) > 3, "states")
        bench.controller.server.delay_s = 0.15
        wait_until(lambda: any("did not answer" in text for text in seen.texts), "late")
        bench.controller.server.delay_s = 0.0
        n_before = len(seen.states)
        wait_until(lambda: len(seen.states) > n_before + 20, "states again")
    assert not seen.lost
    assert sum(seen.missed) >= 1
    assert {state.cycle_count for state in seen.states} == {0}


def test_a_dropped_connection_is_made_again_at_once() -> None:
    with rig(QUICK) as bench, bench.streaming(silence_s=2.0) as stream:
        seen = bench.seen
        for _ in range(3):
            n_before = len(seen.states)
            bench.controller.server.drop_connections()
            wait_until(lambda n=n_before: len(seen.states) > n + 10, "states again")  # type: ignore[misc]
        stream.grant_cycles(0)
    assert not seen.lost


def test_a_controller_that_dies_is_lost_for_good_unless_told_to_wait() -> None:
    with rig(QUICK) as bench, bench.streaming(silence_s=0.2) as stream:
        wait_until(lambda: bench.seen.states, "a state")
        bench.controller.server.close()
        wait_until(lambda: bench.seen.lost, "a lost link")
        with pytest.raises(LinkLostError, match=r"cannot be granted a cycle|did not take the grant"):
            stream.grant_cycles(1)
    assert len(bench.seen.lost) == 1


@pytest.mark.parametrize("on_loss", ["lost", "report"])
def test_a_controller_whose_heartbeat_stands_still_is_lost_or_reported(on_loss: str) -> None:
    beat = ("max_age_s = 2.0", f'max_age_s = 0.2, on_loss = "{on_loss}"')
    with rig(beat) as bench, bench.streaming(reconnect_s=20.0):
        seen = bench.seen
        wait_until(lambda: seen.states, "a state")
        bench.controller.logic.beats = False
        wait_until(lambda: any("heartbeat of the Modbus controller" in text for text in seen.texts), "told")
        n_before = len(seen.states)
        wait_until(lambda: len(seen.states) > n_before + 10, "states all the same")
        assert len(seen.lost) == (on_loss == "lost")
        bench.controller.logic.beats = True
        wait_until(lambda: seen.restored == (on_loss == "lost"), "restored")


def test_a_controller_that_answers_nothing_is_not_said_to_have_lost_its_heartbeat() -> None:
    beat = ("max_age_s = 2.0", 'max_age_s = 0.2, on_loss = "lost"')
    with rig(beat) as bench, bench.streaming(reconnect_s=20.0, silence_s=5.0):
        wait_until(lambda: bench.seen.states, "a state")
        bench.controller.server.exception_code = 6
        wait_until(lambda: bench.seen.lost, "a lost link")
    assert "gave no state for 0.2 s" in str(bench.seen.lost[0])
    assert "exception 6, device busy" in str(bench.seen.lost[0])
    assert not any("heartbeat" in text for text in bench.seen.texts)


def test_without_our_heartbeat_the_controller_does_what_it_promised() -> None:
    with rig(("period_s = 0.5", "period_s = 0.1"), cycle_s=60.0) as bench:
        with bench.streaming() as stream, bench.commanding() as program:
            program.play()
            stream.grant_cycles(1)
            wait_until(lambda: bench.seen.states[-1].cycle_running == 1, "on the path")
        wait_until(lambda: bench.controller.logic.program.state == "PAUSED", "paused by the controller")


def test_a_controller_that_is_only_observed_is_never_written() -> None:
    observe = ("unit_id = 1", "unit_id = 1\nobserve_only = true")
    with rig(observe) as bench, bench.streaming() as stream:
        wait_until(lambda: len(bench.seen.states) > 5, "states")
        with pytest.raises(DeviceStateError, match="only observed"):
            stream.grant_cycles(1)
        assert bench.controller.tables.read_cells("holding")[:2] == [0, 0]


def test_nobody_there_is_one_sentence() -> None:
    config = make_config()
    with pytest.raises(ConnectError, match=r"Modbus controller 127.\d+.62.\d+:5020 cannot be reached within 0.4 s"):
        ModbusStateStream(config, RunClock.start()).open(lambda _record: None)


def test_a_map_that_does_not_fit_is_told_when_it_is_opened() -> None:
    with rig() as bench:
        wrong = bench.config.map.model_copy(
            update={"phase": bench.config.map.phase.model_copy(update={"address": 300})}  # type: ignore[union-attr]
        )
        config = bench.config.model_copy(update={"map": wrong})
        stream = ModbusStateStream(config, bench.clock)
        with pytest.raises(
            DeviceStateError, match=r"refuses reading input 300..301: exception 2, illegal data address"
        ):
            stream.open(lambda _record: None)


@pytest.mark.parametrize(
    "answer", [b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\x00\x01\x00\x00\x00\x03\x01\x83", b"\x00" * 300]
)
def test_bytes_that_are_no_modbus_are_an_error_and_no_hang(answer: bytes) -> None:
    config = make_config(QUICK)
    with socket.create_server((config.host, config.port)) as server:
        thread = threading.Thread(target=_answer_all, args=(server, answer), daemon=True)
        thread.start()
        stream = ModbusStateStream(config, RunClock.start())
        with pytest.raises((DeviceTimeoutError, LinkLostError, DeviceStateError)):
            stream.open(lambda _record: None)
        server.shutdown(socket.SHUT_RDWR)
        thread.join()


def _answer_all(server: socket.socket, answer: bytes) -> None:
    while True:
        try:
            connection, _ = server.accept()
        except OSError:
            return
        with connection:
            connection.recv(300)
            connection.sendall(answer)
            connection.recv(300)
