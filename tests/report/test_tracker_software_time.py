"""A tracker that tells only the time since its software's start, and cannot be asked for it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from run_examples import T0_NS, TRACKER_HZ, RunSpec, write_run

from bench.model import DeviceInfo, StampKind
from bench.recording import open_run
from bench.report.source import load_topics, read_frames

DRIFT = 42e-6
QUICKEST_NS = 3_000_000


def late_by_chance(i: int, values: dict[str, Any]) -> dict[str, Any]:
    """Let the frame come 3 ms late or more, by a clock that runs 42 ppm slow and is known online only roughly."""
    seconds = i / TRACKER_HZ
    arrival_ns = T0_NS + round(seconds * 1e9) + QUICKEST_NS + (i * 7919 % 13) * 100_000
    ticks = round((5_000 + seconds * (1 - DRIFT)) * 1e9)
    changed = {"stamp": StampKind.TRACKER_TIME, "device_ticks": ticks, "arrival_ns": arrival_ns}
    return values | changed | {"capture_ns": arrival_ns}


def test_its_frames_are_put_on_the_time_line_by_their_earliest_arrivals(tmp_path: Path) -> None:
    old = DeviceInfo("tracker", "natnet", "", detail={"clock_hz": "1000000000"})
    spec = RunSpec(seconds=20.0, echoes=False, robot=False, change_points=late_by_chance, devices=[old])
    write_run(tmp_path / "run.mcap", spec)
    run = open_run(tmp_path / "run.mcap")
    load_topics(run)
    frames = read_frames(run)
    true_ns = T0_NS + np.rint((frames.frame_number - 1_000) / TRACKER_HZ * 1e9).astype(np.int64)
    late_ns = frames.time_ns - true_ns
    assert abs(late_ns - QUICKEST_NS).max() < 1_000
    (clock,) = frames.clocks
    assert clock.method == "lower hull"
    assert abs(clock.drift_ppm - 42) < 0.1
