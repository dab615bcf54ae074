"""The simulated Modbus controller's sign of life: seen to change at whatever rate it is polled."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.config import ModbusRobotConfig, load_config
from bench.simulation.device_clock import DeviceClock
from bench.simulation.modbus.logic import PlcLogic
from bench.simulation.modbus.tables import Tables
from bench.simulation.program import PathProgram
from bench.timing import ManualClock

MAP = Path(__file__).parents[2] / "bench_configs" / "modbus_simulated.toml"
SCAN_NS = 10_000_000


@pytest.mark.parametrize("scans_per_poll", [1, 2, 3, 4, 10])
def test_the_heartbeat_changes_in_time_for_polls_in_step_with_the_scans(scans_per_poll: int) -> None:
    config = load_config(MAP).robot
    assert isinstance(config, ModbusRobotConfig)
    signal = config.map.heartbeat_in
    assert signal is not None
    clock = ManualClock()
    tables = Tables(config.map)
    controller_clock = DeviceClock(clock.now_ns(), 0, 1e9, 0.0)
    logic = PlcLogic(config, PathProgram(cycle_s=1.0), tables, clock, controller_clock, 0)
    values, changed_ns, longest_ns = [], clock.now_ns(), 0
    for number in range(1000):
        clock.advance_ns(SCAN_NS)
        logic.scan(clock.now_ns())
        if number % scans_per_poll == 0:
            values.append(tables.get(signal))
            if values[-1] != values[-2:][0]:
                longest_ns, changed_ns = max(longest_ns, clock.now_ns() - changed_ns), clock.now_ns()
    assert len(set(values)) > 1
    assert longest_ns < signal.max_age_s * 0.5e9
