"""Start and stop of a Modbus controller's program: commands, acknowledges, interlocks, and refusals."""

from __future__ import annotations

import threading

import pytest
from modbus_bench import make_config, rig, wait_until

from bench.drivers.robot.modbus import ModbusProgram
from bench.errors import ConnectError, DeviceError, DeviceStateError, DeviceTimeoutError, LinkLostError
from bench.timing import RunClock

START = (
    'start = { table = "coil", address = 0, type = "bool", ack = { table = "discrete", address = 0, type = "bool" } }'
)
LEVEL = (START, 'start = { table = "coil", address = 0, type = "bool", hold = "level" }')
NUMBER_TEXT = """\
program_number = { table = "holding", address = 5, type = "u16", value = 3, strobe = { table = "coil", address = 4, \
type = "bool", ack = { table = "discrete", address = 5, type = "bool" } } }
[robot.map.command]
reset = { table = "coil", address = 6, type = "bool", ack = { table = "discrete", address = 6, type = "bool" } }
"""
NUMBER = ("[robot.map.command]\n", NUMBER_TEXT)
SHORT = (
    'start = { table = "coil", address = 0, type = "bool", ack = {',
    'start = { table = "coil", address = 0, type = "bool", ack_timeout_s = 0.2, ack = {',
)


def test_the_program_starts_and_stops_and_each_call_returns_when_it_has() -> None:
    with rig() as bench, bench.commanding() as program:
        assert program.check("path 3") == []
        program.load("path 3")
        program.play()
        assert bench.controller.logic.program.state == "PLAYING"
        program.stop()
        assert bench.controller.logic.program.state == "STOPPED"
        assert bench.controller.tables.read_cells("coil")[:2] == [0, 0]


def test_a_start_that_is_a_level_stands_until_the_stop() -> None:
    with rig(LEVEL) as bench, bench.commanding() as program:
        program.play()
        assert bench.controller.tables.read_cells("coil")[:2] == [1, 0]
        program.stop()
        assert bench.controller.tables.read_cells("coil")[:2] == [0, 0]
        assert bench.controller.logic.program.state == "STOPPED"


def test_number_strobe_and_reset_are_given_and_acknowledged() -> None:
    with rig(NUMBER) as bench, bench.commanding() as program:
        given = []
        write = bench.controller.tables.write_cells

        def spy(table: str, first: int, values: object) -> None:
            if table in ("coil", "holding"):
                given.append((table, first, list(values)))  # type: ignore[call-overload]
            write(table, first, values)  # type: ignore[arg-type]

        bench.controller.tables.write_cells = spy  # type: ignore[method-assign]
        program.load("path 3")
        program.play()
    wanted = [("holding", 5, [3]), ("coil", 4, [1]), ("coil", 4, [0]), ("coil", 6, [1]), ("coil", 6, [0])]
    assert [entry for entry in given if entry in wanted] == wanted
    assert given.index(("coil", 6, [0])) < given.index(("coil", 0, [1]))


def test_a_controller_without_functions_5_and_6_is_written_by_15_and_16() -> None:
    functions: set[int] = set()
    with rig(("base = 0", 'base = 0\nwrite_with = "multiple"')) as bench:
        judge = bench.controller.server.judge

        def spy(function: int) -> int:
            functions.add(function)
            return 1 if function in (5, 6) else judge(function)

        bench.controller.server.judge = spy  # type: ignore[method-assign]
        with bench.streaming() as stream, bench.commanding() as program:
            stream.grant_cycles(1)
            program.play()
            program.stop()
    assert functions >= {2, 4, 15, 16}
    assert not functions & {5, 6}


def test_what_keeps_the_program_from_running_is_said_at_once() -> None:
    with rig(cycle_s=60.0) as bench, bench.commanding() as program:
        logic = bench.controller.logic
        logic.open_interlocks.add("guard door")
        logic.fault_code = 17
        wait_until(lambda: len(program.check("x")) == 2, "two reasons")
        fault, door = program.check("x")
        assert fault.endswith("is in a fault (state 9, fault code 17): clear it at the controller.")
        assert "The interlock 'guard door' of the Modbus controller" in door
        with pytest.raises(DeviceStateError, match=r"is in a fault.*guard door"):
            program.play()
        assert bench.controller.tables.read_cells("coil")[0] == 0


@pytest.mark.parametrize(("do", "word"), [("pause", "is paused"), ("play", "is in a cycle already")])
def test_a_program_that_is_under_way_is_not_started(do: str, word: str) -> None:
    with rig(cycle_s=60.0) as bench, bench.streaming() as stream, bench.commanding() as program:
        program.play()
        stream.grant_cycles(1)
        wait_until(lambda: bench.seen.states[-1].cycle_running == 1, "on the path")
        getattr(bench.controller.logic.program, do)()
        # the register follows at the controller's next scan
        wait_until(lambda: any(word in reason for reason in program.check("x")), word)


def test_a_state_that_is_not_listed_is_named() -> None:
    with rig() as bench, bench.commanding() as program:
        bench.controller.logic.scan = lambda _due_ns: None  # type: ignore[method-assign]
        bench.controller.tables.set(bench.config.map.state, 5)
        assert "shows state 5, which [robot.map.state] values does not list" in program.check("x")[0]


def test_a_command_that_is_not_acknowledged_is_taken_back_and_told() -> None:
    with rig(SHORT) as bench, bench.commanding() as program:
        bench.controller.logic.scan = lambda _due_ns: None  # type: ignore[method-assign]
        with pytest.raises(DeviceTimeoutError, match=r"did not acknowledge 'start' within 0.2 s"):
            program.play()
        assert bench.controller.tables.read_cells("coil")[0] == 0


def test_a_start_without_effect_is_told() -> None:
    with (
        rig((START, LEVEL[1].replace('"level"', '"level", ack_timeout_s = 0.2'))) as bench,
        bench.commanding() as program,
    ):
        bench.controller.logic.scan = lambda _due_ns: None  # type: ignore[method-assign]
        with pytest.raises(DeviceTimeoutError, match=r"did not obey 'start' within 0.2 s"):
            program.play()


def test_a_controller_that_refuses_every_write_is_one_sentence() -> None:
    with rig() as bench, bench.commanding() as program:
        bench.controller.server.exception_code = 4
        with pytest.raises(DeviceStateError, match="exception 4, device failure"):
            program.stop()
        assert "device failure" in program.check("x")[0]


def test_a_controller_that_is_only_observed_is_never_started() -> None:
    with rig(("unit_id = 1", "unit_id = 1\nobserve_only = true")) as bench, bench.commanding() as program:
        assert "is only observed" in program.check("path 3")[0]
        for command in (program.play, program.stop):
            with pytest.raises(DeviceStateError, match="only observed"):
                command()


def test_a_controller_that_closes_quiet_connections_is_none_the_worse() -> None:
    with rig() as bench, bench.commanding() as program:
        assert program.check("x") == []
        bench.controller.server.drop_connections()
        program.play()
        bench.controller.server.drop_connections()
        program.stop()


def test_nobody_there_and_nothing_open_are_sentences() -> None:
    program = ModbusProgram(make_config(), RunClock.start())
    with pytest.raises(ConnectError, match="cannot be reached"):
        program.open()
    with pytest.raises(LinkLostError, match="the connection is not open"):
        program.stop()
    program.close()


def test_the_controller_dies_during_a_start() -> None:
    with rig() as bench, bench.commanding() as program:
        program.play()
        closer = threading.Thread(target=bench.controller.server.close)
        closer.start()
        closer.join()
        with pytest.raises(DeviceError):
            program.stop()
