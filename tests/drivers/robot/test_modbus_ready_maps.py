"""The register maps to copy: each drives the simulated controller through cycles, as it stands."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from modbus_bench import LOOPBACK, SPEED, Rig, controller_of, wait_until

from bench.config import ModbusRobotConfig, load_config
from bench.drivers.robot.modbus import ModbusSignalWatch
from bench.timing import RunClock

CONFIGS = Path(__file__).parents[3] / "bench_configs"


@pytest.mark.parametrize(("name", "last"), [("modbus_ur_port502", 221), ("modbus_generic_plc", 222)])
def test_a_map_to_copy_drives_cycles(name: str, last: int) -> None:
    robot = load_config(CONFIGS / f"{name}.toml").robot
    assert isinstance(robot, ModbusRobotConfig)
    config = robot.model_copy(update={"host": f"{LOOPBACK}.{last}", "port": 5020})
    clock = RunClock.start(SPEED)
    with controller_of(config, clock) as controller:
        bench = Rig(config, clock, controller)
        with bench.streaming() as stream, bench.commanding() as program:
            if config.map.heartbeat_in is not None:
                wait_until(lambda: len(bench.seen.states) > 3, "states")
            assert program.check(config.program) == []
            program.load(config.program)
            stream.grant_cycles(0)
            program.play()
            for total in (1, 2, 3):
                stream.grant_cycles(total)
                wait_until(lambda n=total: bench.seen.states[-1].cycle_count == n, f"cycle {total}")  # type: ignore[misc]
            program.stop()
        states = bench.seen.states
    assert not bench.seen.lost
    assert {state.cycle_count for state in states} == {0, 1, 2, 3}
    assert {state.cycle_running for state in states} == {0, 1}
    assert {state.safety_status for state in states} == {1}


@pytest.mark.parametrize(("name", "last"), [("modbus_ur_port502", 224), ("modbus_generic_plc", 225)])
def test_every_signal_of_a_map_to_copy_can_be_watched(name: str, last: int) -> None:
    robot = load_config(CONFIGS / f"{name}.toml").robot
    assert isinstance(robot, ModbusRobotConfig)
    config = robot.model_copy(update={"host": f"{LOOPBACK}.{last}", "port": 5020})
    clock = RunClock.start(SPEED)
    with controller_of(config, clock):
        watch = ModbusSignalWatch(config, clock)
        watch.open()
        shown = {signal.name: signal for signal in watch.read()}
        watch.close()
    assert list(shown) == list(config.map.signals)
    assert shown["state"].value == "0 (stopped)"
    assert all("in order" in signal.value for key, signal in shown.items() if key.startswith("interlock"))


def test_a_urs_own_registers_are_where_its_manual_has_them() -> None:
    robot = load_config(CONFIGS / "modbus_ur_port502.toml").robot
    assert isinstance(robot, ModbusRobotConfig)
    places = {name: (signal.table, signal.address, signal.span) for name, signal in robot.map.signals.items()}
    assert places["interlock.robot power"] == ("holding", 260, 1)
    assert places["interlock.security stop"] == ("holding", 261, 1)
    assert places["interlock.emergency stop"] == ("holding", 262, 1)
    for name, first, count in (
        ("joints", 270, 6),
        ("joint_speeds", 280, 6),
        ("joint_turns", 320, 6),
        ("tcp_position", 400, 3),
        ("tcp_rotation", 403, 3),
    ):
        assert places.pop(name) == ("holding", first, count)
    ours = {address for _, address, _ in places.values()} - {260, 261, 262}
    assert all(128 <= address <= 255 for address in ours)  # general purpose


def test_a_urs_joint_angles_are_put_together_from_turns_and_milliradians() -> None:
    robot = load_config(CONFIGS / "modbus_ur_port502.toml").robot
    assert isinstance(robot, ModbusRobotConfig)
    config = robot.model_copy(update={"host": f"{LOOPBACK}.223", "port": 5020})
    clock = RunClock.start(SPEED)
    with controller_of(config, clock) as controller:
        bench = Rig(config, clock, controller)
        with bench.streaming():
            wait_until(lambda: bench.seen.states, "a state")
        truth = controller.logic.program.motion_at(clock.now_ns()).q_rad
        state = bench.seen.states[0]
    assert min(truth) < 0 < max(truth)
    assert state.q_rad == pytest.approx(truth, abs=0.001)
    assert not any(math.isnan(value) for value in (*state.qd_rad_s, *state.tcp_pose))
