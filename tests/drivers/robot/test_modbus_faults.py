"""What the Modbus driver reports of each fault that the admin channel of a simulated controller makes, at the wire."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
from modbus_bench import PATIENCE_S, Rig, rig, wait_until

from bench.simulation.admin import AdminServer

ADMIN_PORT = 30098
QUICK = ("unit_id = 1", "unit_id = 1\ntimeout_s = 0.25\nretries = 0")
COUNTS_ON = ('cycle_counter = { table = "input"', 'cycle_counter = { restarts = false, table = "input"')
WRAPS = (('restarts = false, table = "input"', 'wrap = 10_000, restarts = false, table = "input"'),)
Say = Callable[[str], str]


@contextmanager
def person(bench: Rig) -> Iterator[Say]:
    """Serve the admin port and give the way to say something there; a `help` comes whole."""
    tracker = SimpleNamespace(stall=lambda _seconds: None)
    server = AdminServer(bench.config.host, ADMIN_PORT, bench.controller, tracker, bench.clock)  # type: ignore[arg-type]
    server.open()
    try:
        with socket.create_connection((bench.config.host, ADMIN_PORT), PATIENCE_S) as link, link.makefile("r") as lines:

            def say(command: str) -> str:
                link.sendall(f"{command}\n".encode())
                answer = [lines.readline().strip()]
                while command == "help" and answer[-1] != "ok":
                    answer.append(lines.readline().strip())
                return "\n".join(answer)

            yield say
    finally:
        server.close()


@contextmanager
def on_the_path(*changes: tuple[str, str]) -> Iterator[tuple[Rig, Say]]:
    """Have a long cycle under way, a stream that watches it, and a person at the admin port."""
    with rig(*changes, cycle_s=60.0) as bench, bench.streaming(reconnect_s=60.0) as stream, person(bench) as say:
        with bench.commanding() as program:
            program.play()
        stream.grant_cycles(1)
        wait_until(lambda: bench.seen.states[-1].cycle_running == 1, "on the path")
        yield bench, say


def test_the_commands_are_listed_and_what_is_none_is_told() -> None:
    with rig() as bench, person(bench) as say:
        listed = say("help")
        for command in ("late SECONDS", "open_interlock NAME", "show_state N|off", "tracker_stall SECONDS"):
            assert command in listed
        assert "protective_stop" not in listed
        assert "there is no 'protective_stop'" in say("protective_stop")
        assert say("exception 9") == "error: there is no exception 9; 1, 2, 3, 4, 5, 6, 7, 8, 10, 11 exist, 0 ends it"
        assert say("open_interlock cellar door") == "error: there is no interlock 'cellar door'; guard door are mapped"
        assert say("close_interlock x").startswith("error: there is no interlock 'x'")
        assert say("show_state blue") == "error: 'blue' is not a number from 0 to 1000000"
        assert say("open_interlock") == "error: 'open_interlock NAME' is expected"


@pytest.mark.parametrize(
    ("fault", "remedy", "words"),
    [
        ("late 0.6", "late 0", "did not answer within 0.25 s"),
        ("exception 6", "exception 0", "exception 6, device busy"),
        ("frozen on", "frozen off", "did not answer within 0.25 s"),
    ],
)
def test_a_server_that_serves_badly_is_a_lost_link_until_it_serves_well(fault: str, remedy: str, words: str) -> None:
    with on_the_path(QUICK) as (bench, say):
        assert say(fault) == "ok"
        wait_until(lambda: bench.seen.lost, "a lost link")
        assert words in str(bench.seen.lost[0])
        assert say(remedy) == "ok"
        wait_until(lambda: bench.seen.restored == 1, "restored")
        wait_until(lambda: sum(bench.seen.missed) > 0, "missed polls are counted")
    assert len(bench.seen.lost) == 1


def test_connections_that_are_closed_are_made_again() -> None:
    with on_the_path() as (bench, say):
        for _ in range(3):
            assert say("fin") == "ok"
            n = len(bench.seen.states)
            wait_until(lambda n=n: len(bench.seen.states) > n + 5, "states again")  # type: ignore[misc]
    assert not bench.seen.lost


def test_an_interlock_is_opened_and_closed_by_its_name() -> None:
    with on_the_path() as (bench, say):
        assert say("open_interlock guard door") == "ok"
        wait_until(lambda: bench.seen.states[-1].safety_status == 5, "open")
        assert say("close_interlock guard door") == "ok"
        wait_until(lambda: bench.seen.states[-1].safety_status == 1, "in order")


def test_a_fault_stops_the_program_and_stays_stopped_when_it_is_cleared() -> None:
    with on_the_path() as (bench, say):
        assert say("fault 17") == "ok"
        wait_until(lambda: bench.seen.states[-1].safety_status == 9, "fault")
        assert say("fault 0") == "ok"
        wait_until(lambda: bench.seen.states[-1].safety_status == 1, "cleared")
        assert bench.seen.states[-1].runtime_state == 1
    assert any(text.endswith("shows fault code 17.") for text in bench.seen.texts)


def test_a_heartbeat_that_stands_still_is_a_lost_link_with_states() -> None:
    with on_the_path(("max_age_s = 2.0", "max_age_s = 0.2")) as (bench, say):
        assert say("heartbeat off") == "ok"
        wait_until(lambda: bench.seen.lost, "lost")
        assert "heartbeat" in str(bench.seen.lost[0])
        assert say("heartbeat on") == "ok"
        wait_until(lambda: bench.seen.restored == 1, "restored")


def test_a_person_at_the_panel_pauses_resumes_and_stops_and_only_what_is_paused_resumes() -> None:
    with on_the_path() as (bench, say):
        for command, state in (("pause", 4), ("resume", 2), ("stop", 1)):
            assert say(command) == "ok"
            wait_until(lambda state=state: bench.seen.states[-1].runtime_state == state, command)  # type: ignore[misc]
        assert say("resume") == "ok"
        n = len(bench.seen.states)
        wait_until(lambda: len(bench.seen.states) > n + 5, "more states")
        assert {state.runtime_state for state in bench.seen.states[n:]} == {1}


def test_the_speed_override_of_the_panel_is_seen() -> None:
    with on_the_path() as (bench, say):
        assert say("override 0.5") == "ok"
        wait_until(lambda: bench.seen.states[-1].speed_fraction == pytest.approx(0.5), "half")


def test_a_state_the_map_does_not_list_is_told_and_the_cycle_goes_on() -> None:
    with on_the_path() as (bench, say):
        assert say("show_state 7") == "ok"
        wait_until(lambda: bench.seen.states[-1].runtime_state == -1, "unknown")
        assert bench.seen.states[-1].cycle_running == 1
        assert say("show_state off") == "ok"
        wait_until(lambda: bench.seen.states[-1].runtime_state == 2, "as before")
    assert any("shows state 7, which [robot.map.state] values does not list" in text for text in bench.seen.texts)


def test_a_controller_that_is_switched_off_and_on_begins_a_segment_and_forgets_its_program() -> None:
    with on_the_path() as (bench, say):
        before = bench.seen.states[-1]
        assert say("reboot") == "ok"
        wait_until(lambda: bench.seen.states[-1].segment > before.segment, "a new segment")
        after = bench.seen.states[-1]
        assert (after.runtime_state, after.cycle_count, after.cycle_running) == (1, 0, 0)
        assert after.controller_time_s < 60.0 < before.controller_time_s
        assert bench.controller.tables.read_cells("holding")[0] == 0


@pytest.mark.parametrize(("changes", "end"), [((), 65_536), (WRAPS, 10_000)])
def test_a_counter_that_wraps_in_the_run_counts_on(changes: tuple[tuple[str, str], ...], end: int) -> None:
    with rig(COUNTS_ON, *changes) as bench, person(bench) as say:
        assert say(f"counter {end - 2}") == "ok"
        with bench.streaming() as stream, bench.commanding() as program:
            stream.grant_cycles(0)
            program.play()
            for total in (1, 2, 3):
                stream.grant_cycles(total)
                wait_until(lambda n=total: bench.seen.states[-1].cycle_count == n, f"cycle {total}")  # type: ignore[misc]
        assert bench.controller.tables.read_cells("input")[1] == 1
        assert bench.controller.tables.read_cells("holding")[0] == 1


@pytest.mark.parametrize("changes", [(), (COUNTS_ON,)])
def test_a_counter_that_another_client_writes_is_no_cycle(changes: tuple[tuple[str, str], ...]) -> None:
    with on_the_path(*changes) as (bench, say):
        wait_until(lambda: bench.seen.states[-1].cycle_count == 0, "nothing counted")
        assert say("counter 40000") == "ok"
        wait_until(lambda: bench.seen.states[-1].cycle_count not in (0, 1), "a jump")


def test_a_restart_where_the_counter_would_seem_to_wrap_is_no_cycle() -> None:
    with rig(COUNTS_ON) as bench, person(bench) as say:
        assert say("counter 65530") == "ok"
        with bench.streaming(reconnect_s=60.0) as stream, bench.commanding() as program:
            stream.grant_cycles(0)
            program.play()
            stream.grant_cycles(5)
            wait_until(lambda: bench.seen.states[-1].cycle_count == 5, "at the end of the register")
            n = len(bench.seen.states)
            assert say("reboot") == "ok"
            wait_until(lambda: bench.seen.states[-1].segment > 0, "a new segment")
        assert {state.cycle_count for state in bench.seen.states[n:]} <= {5, 0}
        assert bench.seen.states[-1].cycle_count == 0
