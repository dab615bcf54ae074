"""The whole report of a long night: hundreds of thousands of frames with hidden markers and ghosts, on one core."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bench.model import NO_ID, UNLABELED, ClockSample, ClockSource, Record, RobotState, StampKind, TrackerFrame
from bench.recording import RunWriter
from bench.simulation.made_motions import HELD_OUT, Motion
from bench.simulation.made_takes import USUAL, MadeTake, make_take
from bench.timing import ManualClock
from benchmarks.table import Row, ratio_row

N_FRAMES, FULL_N_FRAMES = 60_000, 400_000
LIMIT_S, LIMIT_BYTES = 30.0, 2e9
START_LIMIT_S, N_STARTS = 0.3, 5
RATE_HZ, ROBOT_HZ = 100.0, 125.0
TICKS_HZ = 1e7
LATE_NS = 3_000_000
TOML = """
[run]
name = "long-night"
[robot]
host = "192.0.2.10"
program = "bend_test.urp"
rate_hz = 125
[cable]
length_m = {length_m}
diameter_mm = 8.0
marker_arc_length_m = {arc_length_m}
minimum_bend_radius_mm = 30.0
[cable.anchor]
kind = "static_marker"
position_m = {anchor_m}
[analysis]
marker_noise_mm = 0.5
"""


def measure_report(folder: Path, full: bool, bench: Callable[..., Any]) -> list[Row]:
    """Report a made run: a crossing motion, 5 % of the markers hidden, two ghosts."""
    path, n_frames = folder / "night.mcap", FULL_N_FRAMES if full else N_FRAMES
    write_made_run(path, n_frames)
    # a cable as hard to sort as this may read a bend below the limit, which is exit code 1 and no fault of this script
    report = bench("report", path, "--output", folder / "night", cores={0}, check=False)
    path.unlink()
    what = f"report of {n_frames} frames, all of it, one core: "
    return [
        ratio_row(what + "frames/s", n_frames / report.wall_s, FULL_N_FRAMES / LIMIT_S, "limit"),
        ratio_row(what + "peak memory, MB", report.peak_bytes / 1e6, LIMIT_BYTES / 1e6, "limit"),
        *measure_starts(),
    ]


def measure_starts() -> list[Row]:
    """Import what a notebook imports, and ask for help, each in a new process."""
    starts = {
        "import of bench.analysis, s": ["-c", "import bench.analysis"],
        "bench --help, s": ["-m", "bench", "--help"],
    }
    return [ratio_row(what, _time_start(arguments), START_LIMIT_S, "limit") for what, arguments in starts.items()]


def _time_start(arguments: list[str]) -> float:
    """Return the shortest of some processes' times (s), their interpreter's start included."""
    seconds = []
    for _ in range(N_STARTS):
        begin = time.perf_counter()
        subprocess.run([sys.executable, *arguments], stdout=subprocess.DEVNULL, check=True)
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def write_made_run(path: Path, n_frames: int) -> None:
    """Write a run of a made take as the recorder would have written it."""
    motion = HELD_OUT["loop"][0]
    take = make_take(motion, n_frames / (motion.cycle_s * RATE_HZ), USUAL, rate_hz=RATE_HZ, seed=1)
    anchor_m = take.anchor_m[0].tolist()
    toml = TOML.format(length_m=take.length_m, arc_length_m=list(take.arc_length_m), anchor_m=anchor_m)
    writer = RunWriter(path, ManualClock(int(take.time_ns[0])), config_toml=toml, versions={}, run_id="benchmark")
    writer.put_all(_records(take, motion))
    writer.close(exit_status="success", reason="")


def _records(take: MadeTake, motion: Motion) -> Iterator[Record]:
    """Yield everything in order of time: a frame, and the robot's states until the next one."""
    rng, start_ns = np.random.default_rng(1), int(take.time_ns[0])
    n_states, seconds = 0, len(take.time_ns) / RATE_HZ
    n_cycles = int(seconds / motion.cycle_s)
    for i, now_ns in enumerate(take.time_ns.tolist()):
        if i % 25 == 0:
            ticks = round((now_ns - start_ns) * 1e-9 * TICKS_HZ)
            yield ClockSample(ClockSource.TRACKER, now_ns - 100_000, ticks, now_ns + 100_000, TICKS_HZ)
        yield _make_frame(take, i, now_ns, start_ns, rng)
        while n_states < min((i + 1) / RATE_HZ, seconds) * ROBOT_HZ:
            yield _make_state(n_states, start_ns, motion.cycle_s, n_cycles)
            n_states += 1


def _make_frame(take: MadeTake, i: int, now_ns: int, start_ns: int, rng: np.random.Generator) -> TrackerFrame:
    points = np.concatenate([take.points_m[take.offsets[i] : take.offsets[i + 1]], take.anchor_m[i][None]])
    n = len(points)
    return TrackerFrame(
        arrival_ns=now_ns + LATE_NS,
        capture_ns=now_ns,
        frame_number=i,
        device_ticks=round((now_ns - start_ns) * 1e-9 * TICKS_HZ),
        stamp=StampKind.MID_EXPOSURE,
        points_m=(points + rng.normal(0, 1e-4, (n, 3))).astype(np.float32),
        ids=np.full(n, NO_ID, dtype=np.uint32),
        flags=np.full(n, UNLABELED, dtype=np.uint32),
        residual_m=np.full(n, np.nan, dtype=np.float32),
        bodies=(),
    )


def _make_state(i: int, start_ns: int, cycle_s: float, n_cycles: int) -> RobotState:
    now_ns, (count, phase) = start_ns + round(i / ROBOT_HZ * 1e9), divmod(i / ROBOT_HZ / cycle_s, 1.0)
    is_over = count >= n_cycles
    return RobotState(
        arrival_ns=now_ns + 150_000,
        capture_ns=now_ns,
        sequence=i,
        segment=0,
        controller_time_s=50.0 + i / ROBOT_HZ,
        runtime_state=2,
        cycle_count=min(int(count), n_cycles),
        cycle_running=0 if is_over else 1,
        cycle_phase=1.0 if is_over else phase,
    )


if __name__ == "__main__":
    begin = time.perf_counter()
    write_made_run(Path(sys.argv[1]), int(sys.argv[2]))
    print(f"{time.perf_counter() - begin:.1f} s")
