"""The register maps to copy: each drives the simulated controller through cycles, as it stands."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from modbus_bench import LOOPBACK, SPEED, Rig, controller_of, wait_until

from bench.config import ModbusRobotConfig, load_config
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
