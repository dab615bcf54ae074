"""The main job with a Modbus controller, end to end over real sockets."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from bench_command import bench, run_and_report

from bench.recording import open_run

MAP = Path(__file__).parents[2] / "bench_configs" / "modbus_simulated.toml"
N_CYCLES = 5


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run 5 cycles and their report once; at twice real time 50 polls a second are 100."""
    folder = tmp_path_factory.mktemp("modbus")
    text = MAP.read_text(encoding="utf-8").replace("127.0.0.61", "127.0.62.201").replace("127.0.0.62", "127.0.62.202")
    (folder / "plc.toml").write_text(text, encoding="utf-8")
    said = run_and_report(folder, folder / "plc.toml", N_CYCLES, speed=2)
    assert "ready robot modbus 127.0.62.201 port=5020 program=path 3" in said
    return folder


def test_every_cycle_is_one_row_with_verdict_ok(job: Path) -> None:
    cycles = pq.read_table(job / "a" / "cycles.parquet").to_pydict()
    assert cycles["cycle_index"] == list(range(N_CYCLES))
    assert cycles["verdict"] == ["ok"] * N_CYCLES
    assert all(1.9 < duration < 2.2 for duration in cycles["duration_s"])
    assert json.loads((job / "a" / "summary.json").read_text())["outcome"] == "PASS"


def test_a_cycle_is_known_to_within_a_few_polls(job: Path) -> None:
    truth = pq.read_table(job / "truth.parquet").to_pydict()
    inside = np.array(truth["cycle_index"]) >= 0
    first = {c: t for c, t in sorted(zip(truth["cycle_index"], truth["time_ns"], strict=True), reverse=True) if c >= 0}
    cycles = pq.read_table(job / "a" / "cycles.parquet").to_pydict()
    late_ns = np.array([cycles["start_ns"][c] - first[c] for c in range(N_CYCLES)])
    assert inside.any()
    assert np.median(np.abs(late_ns)) < 60_000_000


def test_what_the_controller_said_is_in_the_file(job: Path) -> None:
    run = open_run(job / "a.mcap")
    device = next(device for device in run.devices if device.device == "robot")
    assert (device.kind, device.address) == ("modbus", "127.0.62.201:5020")
    assert device.detail["cycle_accuracy_s"] == "0.02"
    state = run["/robot/state"]
    assert set(np.unique(state.cycle_count)) == set(range(N_CYCLES + 1))
    assert np.nanmax(state.cycle_phase) > 0.9
    assert np.isnan(state.current_a).all()
    assert np.all(np.diff(state["controller_time_s"]) >= 0)


def test_a_controller_that_is_only_observed_cannot_be_driven(tmp_path: Path) -> None:
    text = MAP.read_text(encoding="utf-8").replace("127.0.0.61", "127.0.62.203").replace("127.0.0.62", "127.0.62.204")
    (tmp_path / "plc.toml").write_text(
        text.replace("unit_id = 1", "unit_id = 1\nobserve_only = true"), encoding="utf-8"
    )
    refused = bench("check", tmp_path / "plc.toml")
    assert refused.returncode == 3, refused.stderr + refused.stdout
    assert "is only observed ([robot] observe_only), so path 3 cannot be started." in refused.stderr
