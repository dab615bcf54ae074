"""Runs of programs that do not count: over real sockets, from the first sample to the report."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from bench_command import bench, simulated_file

from bench.recording import open_run

COUNTER = """source = "counter"
register = 24
running_register = 25
grant_register = 24
phase_register = 24
"""
SOURCES = {
    "pulse": 'source = "digital_output"\ndigital_output = 3\ndigital_output_mode = "pulse"\n',
    "level": 'source = "digital_output"\ndigital_output = 3\ngrant = true\n',
    "joints": 'source = "joint_return"\n',
}


@pytest.mark.parametrize("name", SOURCES)
def test_a_program_that_does_not_count_is_run_for_exactly_so_many_cycles(name: str, tmp_path: Path) -> None:
    config = simulated_file(tmp_path, (COUNTER, SOURCES[name]), ("cycle_s = 2.0", "cycle_s = 1.0"))
    run = bench("run", config, "--cycles", "6", "--speed", "4", "--output", tmp_path / "a.mcap")
    assert run.returncode == 0, run.stderr + run.stdout
    assert "6 of 6 cycles completed" in run.stdout
    report = bench("report", tmp_path / "a.mcap", "--output", tmp_path / "a")
    assert report.returncode == 0, report.stderr + report.stdout
    cycles = pq.read_table(tmp_path / "a" / "cycles.parquet").to_pydict()
    assert cycles["cycle_index"] == list(range(6))
    assert cycles["verdict"] == ["ok"] * 6
    assert cycles["start_from"] == ["motion"] * 6
    summary = json.loads((tmp_path / "a" / "summary.json").read_text())
    assert ("not granted one by one" in summary["run_facts"]["Cycle source"]) == (name != "level")
    assert set(open_run(tmp_path / "a.mcap")["/robot/state"]["cycle_count"].tolist()) == {-1}
