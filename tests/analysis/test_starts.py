"""The start of a cycle is where the joints begin to move, to one sample of the controller."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bench.analysis import CounterColumns, RobotSigns, count_cycles, find_cycles, make_cycle_source, refine_starts
from bench.config import CycleConfig
from bench.simulation.program import PathProgram
from bench.simulation.ur.machine import CycleRegisters, Machine

PERIOD_NS = 2_000_000
T0_NS = 1_700_000_000_000_000_000
SOURCES = {
    "counter": CycleConfig(),
    "level": CycleConfig(source="digital_output", digital_output=3),
    "pulse": CycleConfig(source="digital_output", digital_output=3, digital_output_mode="pulse"),
    "joints": CycleConfig(source="joint_return"),
}


def drive(config: CycleConfig, n_cycles: int, cycle_s: float = 0.6) -> tuple[dict[str, Any], np.ndarray]:
    """Let the simulated program run at 500 Hz; return what it shows and when its cycles truly begin."""
    program = PathProgram(cycle_s=cycle_s, rest_s=0.05)
    registers = CycleRegisters(None, 24, 25, None, config.digital_output, config.digital_output_mode == "pulse")
    machine = Machine(program, registers, 500.0)
    rows, truth, before = [], [], 0
    for k in range(round((n_cycles * (cycle_s + 0.06) + 0.2) / 0.002)):
        if k == 10:
            program.play()
        machine.tick(k, T0_NS + k * PERIOD_NS)
        v = machine.values
        rows.append([v["actual_q"], v["actual_qd"], v["actual_digital_output_bits"], v["runtime_state"],
                     v["output_int_register_24"], v["output_int_register_25"]])  # fmt: skip
        running = v["output_int_register_25"]
        if running == 1 and before != 1:
            truth.append(T0_NS + k * PERIOD_NS)
        before = running
    names = ("q", "qd", "outputs", "runtime", "count", "running")
    return {name: np.array(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}, np.array(
        truth
    )


def find(config: CycleConfig, shown: dict[str, Any]) -> Any:
    source = make_cycle_source(config)
    count, running = shown["count"], shown["running"]
    if source is not None:
        count, running = count_cycles(source, shown["runtime"], RobotSigns(shown["outputs"], shown["q"], shown["qd"]))
    n = len(count)
    host = T0_NS + PERIOD_NS * np.arange(n)
    return host, find_cycles(CounterColumns(host, count, running, np.full(n, np.nan), shown["runtime"]))


@pytest.mark.parametrize("name", SOURCES)
@pytest.mark.parametrize("noise_rad_s", [0.0, 1e-3])
def test_the_start_is_known_to_one_controller_period_by_every_source(name: str, noise_rad_s: float) -> None:
    shown, truth = drive(SOURCES[name], 15)
    rng = np.random.default_rng(5)
    shown["qd"] = shown["qd"] + noise_rad_s * rng.standard_normal(shown["qd"].shape)
    host, table = find(SOURCES[name], shown)
    refined_table, refined = refine_starts(table, host, np.abs(shown["qd"]).max(axis=1))
    n = len(table.start_ns)
    assert n >= 15
    assert refined.all()
    error = (refined_table.start_ns - truth[:n]) / PERIOD_NS
    allowed = 1.0 if noise_rad_s == 0.0 else 3.0  # 3 mrad/s are reached 3 periods after this path's start
    assert np.abs(error).max() <= allowed
    if name == "joints":
        assert ((table.start_ns - truth[:n]) / PERIOD_NS).min() > 5  # what the tolerance alone would give


def test_a_start_told_long_before_the_motion_is_moved_to_it_and_a_dwell_is_not() -> None:
    for dwell, moved in ((100, True), (1000, False)):
        speed = np.concatenate([np.zeros(50 + dwell), np.full(200, 0.5), np.zeros(50)])
        n = len(speed)
        count = np.where(np.arange(n) < n - 20, 0, 1)
        running = ((np.arange(n) >= 50) & (np.arange(n) < n - 20)).astype(int)
        host = T0_NS + PERIOD_NS * np.arange(n)
        table = find_cycles(CounterColumns(host, count, running, np.full(n, np.nan), np.full(n, 2)))
        after, refined = refine_starts(table, host, speed)
        assert refined.tolist() == [moved]
        assert after.start_ns[0] == host[49 + dwell if moved else 50]


def test_without_speeds_or_without_rest_the_shown_start_stays() -> None:
    shown, _ = drive(SOURCES["counter"], 3)
    host, table = find(SOURCES["counter"], shown)
    for speed in (np.full(len(host), np.nan), np.full(len(host), 0.3)):
        after, refined = refine_starts(table, host, speed)
        assert not refined.any()
        assert after.start_ns.tolist() == table.start_ns.tolist()


def test_no_cycles_have_no_starts() -> None:
    none = np.zeros(0, dtype=np.int64)
    table = find_cycles(CounterColumns(none, none, none, np.zeros(0), none))
    assert len(refine_starts(table, none, np.zeros(0))[0].start_ns) == 0
