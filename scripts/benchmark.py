"""Measures bench beside its peers and its limits, in one run, and prints one table."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
import pyarrow.parquet as pq
from benchmarks.calibration import measure_calibration
from benchmarks.curvature import measure_curvature
from benchmarks.losses import measure_losses
from benchmarks.reading import measure_reading
from benchmarks.recording import measure_recording
from benchmarks.report import measure_report
from benchmarks.robot_link import measure_robot_link
from benchmarks.rods import measure_rods
from benchmarks.sorting import measure_sorting
from benchmarks.table import Row, print_table, ratio_row
from benchmarks.take_import import measure_take_import
from benchmarks.tracker_link import measure_tracker_link

from bench.config import simulated_config_text
from bench.recording import open_run

REPORT_LIMIT_S = 60.0
REPORT_LIMIT_BYTES = 1.5e9
SPEEDS = (10, 20, 40, 80)


@dataclass(frozen=True)
class Finished:
    text: str
    wall_s: float
    cpu_s: float
    """User and system time of the process itself, without its children."""
    peak_bytes: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--full",
        action="store_true",
        help="1000 cycles, minutes of both streams, a run and a take of 1 GB, 50 kills, how far --speed goes",
    )
    full = parser.parse_args().full
    with tempfile.TemporaryDirectory(prefix="bench-benchmark-") as name:
        print_table(measure(Path(name), full))


def measure(folder: Path, full: bool) -> Iterator[Row]:
    yield from measure_main_job(folder, n_cycles=1000 if full else 100)
    yield from measure_reading(folder, full)
    yield from measure_curvature()
    yield from measure_rods()
    yield from measure_simulated_sorting(folder, n_cycles=40)
    yield from measure_report(folder, full, bench)
    yield from measure_sorting()
    yield from measure_take_import(folder, full, bench)
    yield from measure_calibration(folder, bench)
    yield from measure_recording(full)
    yield from measure_robot_link(full)
    yield from measure_tracker_link(full)
    if full:
        yield from measure_losses()
        yield from (measure_speed(folder, speed) for speed in SPEEDS)


def measure_main_job(folder: Path, n_cycles: int) -> list[Row]:
    """Record at ten times real time and report on one core."""
    path = folder / "run.mcap"
    run = bench("run", "--cycles", n_cycles, "--speed", 10, "--output", path)
    report = bench("report", path, "--output", folder / "report", cores={0})
    table = pq.read_table(folder / "report" / "cycles.parquet").to_pydict()
    counted = len(set(table["cycle_index"]))
    n_frames = len(open_run(path)["/tracker/frame"]["frame_number"])
    losses = run.text.split(" tracker frames, ")[1].split(".")[0]
    frames_per_s, wanted_per_s = n_frames / report.wall_s, 200_000 / REPORT_LIMIT_S
    return [
        Row(f"run, {n_cycles} cycles at --speed 10: cycles counted", f"{counted} ({losses})", f"{n_cycles}", "-"),
        ratio_row("run: recorder and drivers, cores", run.cpu_s / run.wall_s, 1.0, "limit"),
        ratio_row("report, one core, all of it: frames/s", frames_per_s, wanted_per_s, "limit"),
        ratio_row("report: peak memory, MB", report.peak_bytes / 1e6, REPORT_LIMIT_BYTES / 1e6, "limit"),
    ]


SCENES = {
    "nothing missing": "",
    "5 % hidden in bursts, 2 ghosts": "burst_probability = 0.002\nghost_count = 2\n",
    "10 % hidden, 4 ghosts, 80 % near": "miss_probability = 0.05\nburst_probability = 0.002\nghost_count = 4\n"
    "ghost_near_share = 0.8\n",
}
"""What `[simulation]` adds to a run; bursts last 0.05 to 0.5 s."""


def measure_simulated_sorting(folder: Path, n_cycles: int) -> list[Row]:
    """Score runs of the simulated bench against its truth, sorted as a report sorts by itself and as the paper does."""
    rows = []
    for number, (name, keys) in enumerate(SCENES.items()):
        config, path = folder / f"scene-{number}.toml", folder / f"scene-{number}.mcap"
        truth = folder / f"truth-{number}.parquet"
        config.write_text(f"{simulated_config_text().replace('127.0.0.2', '127.0.51.2')}\n{keys}")
        bench("run", config, "--cycles", n_cycles, "--speed", 10, "--output", path, "--truth", truth)
        scores = []
        for sorting in ("auto", "paper"):
            # wrong labels may look like a bend below the limit, which is exit code 1 and no fault of this script
            chosen = folder / f"{sorting}-{number}.toml"
            chosen.write_text(f'{config.read_text()}\n[analysis]\nsorting = "{sorting}"\n')
            bench("report", path, "--config", chosen, "--output", folder / f"{sorting}-{number}", check=False)
            scores.append(score(folder / f"{sorting}-{number}" / "markers.parquet", truth))
        (exact, wrong), (paper, _) = scores
        what = f"simulated bench, {n_cycles} cycles, {name}: frames exact"
        rows.append(Row(what, f"{exact:.2%}", f"{paper:.2%} (the paper's)", f"{wrong:.2%} wrong label"))
    return rows


def measure_speed(folder: Path, speed: int) -> Row:
    """Ask for a multiple of real time and see whether the machine keeps up, by the run's own words."""
    path = folder / f"speed-{speed}.mcap"
    run = bench("run", "--cycles", speed * 5, "--speed", speed, "--output", path, check=False)
    if "cannot keep up" in run.text:
        verdict = "the run says: too fast for this machine"
    else:
        verdict = "kept up" if "Next: bench report" in run.text else "refused by the preflight"
    words = next((line.split() for line in run.text.splitlines() if line.endswith("cycles completed.")), ["0"])
    return Row(f"--speed {speed}: cycles counted", words[0], f"{speed * 5}", verdict)


def score(markers: Path, truth: Path) -> tuple[float, float]:
    """Return the fraction of frames that are exact, and of those with a wrong label."""
    found, true = (_sources(path) for path in (markers, truth))
    both = sorted(found.keys() & true.keys())
    a, b = np.array([found[n] for n in both]), np.array([true[n] for n in both])
    return float(np.mean((a == b).all(axis=1))), float(np.mean(((a >= 0) & (a != b)).any(axis=1)))


def _sources(path: Path) -> dict[int, list[int]]:
    columns = pq.read_table(path, columns=["frame_number", "source"]).to_pydict()
    return dict(zip(columns["frame_number"], columns["source"], strict=True))


def bench(*arguments: object, cores: set[int] | None = None, check: bool = True) -> Finished:
    """Run the command and account for its own process alone; the simulated bench is another one."""
    command = [sys.executable, "-m", "bench", *map(str, arguments)]
    begin = time.perf_counter()
    with tempfile.TemporaryFile("w+") as out:
        process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT)
        if cores is not None:
            os.sched_setaffinity(process.pid, cores)
        cpu_s, peak_bytes = _watch(psutil.Process(process.pid), process)
        wall_s = time.perf_counter() - begin
        out.seek(0)
        text = out.read()
    if check and process.returncode:
        sys.exit(f"{' '.join(command)} ended with {process.returncode}:\n{text}")
    return Finished(text, wall_s, cpu_s, peak_bytes)


def _watch(watched: psutil.Process, process: subprocess.Popen[bytes]) -> tuple[float, int]:
    cpu_s, peak_bytes = 0.0, 0
    while process.poll() is None:
        try:
            times, memory = watched.cpu_times(), watched.memory_info()
        except psutil.NoSuchProcess:
            break
        cpu_s, peak_bytes = max(cpu_s, times.user + times.system), max(peak_bytes, memory.rss)
        time.sleep(0.02)
    process.wait()
    return cpu_s, peak_bytes


if __name__ == "__main__":
    main()
