"""The main job with a Qualisys system, end to end over real sockets."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from bench_command import run_and_report

from bench.config import simulated_config_text
from bench.recording import open_run

N_CYCLES = 4


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("qualisys")
    text = simulated_config_text().replace("natnet", "qualisys")
    text = text.replace("127.0.0.21", "127.0.71.201").replace("127.0.0.22", "127.0.71.202")
    (folder / "qtm.toml").write_text(text, encoding="utf-8")
    said = run_and_report(folder, folder / "qtm.toml", N_CYCLES, speed=5)
    assert "ready tracker qualisys 127.0.71.202 rt=22223 rate_hz=100" in said
    return folder


def test_every_marker_is_the_right_one(job: Path) -> None:
    truth = pq.read_table(job / "truth.parquet").to_pydict()
    markers = pq.read_table(job / "a" / "markers.parquet").to_pydict()
    true_source = dict(zip(truth["frame_number"], truth["source"], strict=True))
    assert [true_source[number] for number in markers["frame_number"]] == markers["source"]


def test_its_clock_is_mapped_by_the_arrivals(job: Path) -> None:
    summary = json.loads((job / "a" / "summary.json").read_text())
    (tracker,) = [clock for clock in summary["clocks"] if clock["device"] == "tracker"]
    assert tracker["method"] == "lower hull"
    frame = open_run(job / "a.mcap")["/tracker/frame"]
    assert set(np.unique(frame.stamp)) == {4}
    truth = pq.read_table(job / "truth.parquet").to_pydict()
    exposed = dict(zip(truth["frame_number"], truth["time_ns"], strict=True))
    markers = pq.read_table(job / "a" / "markers.parquet").to_pydict()
    pairs = zip(markers["frame_number"], markers["time_ns"], strict=True)
    late_ns = np.array([time_ns - exposed[number] for number, time_ns in pairs])
    assert (late_ns > 5_900_000).all()  # by the shortest way from exposure to network, never earlier
    assert np.ptp(late_ns) < 2_000_000
