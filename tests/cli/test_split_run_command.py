"""A run that is split by size, end to end: recorded in parts, reported as one run."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from bench_command import bench, simulated_file

from bench.model import CycleEventKind
from bench.recording import open_run

SPLIT = ('name = "simulated"', 'name = "simulated"\nsplit_mb = 1')
N_CYCLES = 5
FAST = (("rate_hz = 125", "rate_hz = 500"), ("tracker_rate_hz = 100", "tracker_rate_hz = 240"))


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("split")
    config = simulated_file(folder, SPLIT, *FAST)
    run = bench("run", config, "--cycles", str(N_CYCLES), "--speed", "4", "--output", folder / "a.mcap")
    assert run.returncode == 0, run.stderr + run.stdout
    assert " parts, " in run.stdout
    return folder


def test_the_parts_are_one_run_with_every_sample_and_cycle(job: Path) -> None:
    run = open_run(job / "a.mcap")
    assert run.status.complete, run.status.lost
    assert len(run.parts) > 1
    assert all(part.bytes_total > 1_000_000 for part in run.parts[:-1])
    assert {path.name for path in job.glob("*.mcap*")} == {part.path.name for part in run.parts}
    numbers = run["/robot/state"]["sequence"]
    assert (numbers[1:] - numbers[:-1] == 1).all()
    events = run["/cycle/event"]
    assert events.cycle_index[events.kind == CycleEventKind.COMPLETED].tolist() == list(range(N_CYCLES))
    assert len(run.devices) == len(open_run(run.parts[-1].path).devices) == 2


def test_its_report_has_every_cycle(job: Path) -> None:
    report = bench("report", *sorted(job.glob("*.mcap")))  # as a shell gives it RUNS/*.mcap
    assert report.returncode == 0, report.stderr + report.stdout
    assert pq.read_table(job / "a" / "cycles.parquet")["verdict"].to_pylist() == ["ok"] * N_CYCLES
    assert json.loads((job / "a" / "summary.json").read_text())["outcome"] == "PASS"
    assert f"{job / 'a.2.mcap'} is a part of the run of {job / 'a.mcap'}, and in its report." in report.stdout
    assert not (job / "a.2").exists()
