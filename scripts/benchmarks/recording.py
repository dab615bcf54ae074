"""Recording 5 000 messages a second: what the thread that acquires them feels, and what the writer's thread costs."""

from __future__ import annotations

import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.model import NO_ID, Record, RobotState, StampKind, TrackerFrame
from bench.recording import RunWriter
from bench.timing import RunClock
from benchmarks.table import Row, ratio_row

STATES_PER_FRAME = 3
TURNS_PER_S = 1000
"""Each with three robot states and a tracker frame, which is two messages: 5 000 messages a second."""
N_POINTS = 10
SECONDS, FULL_SECONDS = 10, 60
SPLIT_BYTES = 1_000_000
"""A part for about each second: far more often than anybody splits a recording."""
STALL_LIMIT_MS = 0.2
CPU_LIMIT = 0.1


def measure_recording(full: bool) -> list[Row]:
    """Hand over records at a fixed rate: to nobody, to the recorder, and to one that splits the recording."""
    seconds = FULL_SECONDS if full else SECONDS
    nobody: deque[Record] = deque(maxlen=1000)
    without, late_without = _pace(nobody.append, seconds)
    writer, recorded, late, cpu = _record(seconds, 0)
    splitting, in_parts, _, _ = _record(seconds, SPLIT_BYTES)
    dropped = sum(stats.dropped for one in (writer, splitting) for stats in one.stats.values())
    written = sum(stats.written for topic, stats in writer.stats.items() if topic.startswith(("/robot", "/tracker")))
    added = np.percentile(recorded, 99.9) - np.percentile(without, 99.9)
    what = "writing 5 000 messages/s: "
    return [
        Row(what + "written, dropped", f"{written}, {dropped}", f"{seconds * TURNS_PER_S * 5}, 0", "-"),
        ratio_row(what + "added stall of the acquiring thread, p99.9, ms", added, STALL_LIMIT_MS, "limit"),
        _compare(what + "handing over", recorded, without),
        _compare(what + f"handing over, in {len(splitting.paths)} parts", in_parts, without),
        _compare(what + "from due to handed over", late, late_without),
        ratio_row(what + "the writer's thread, cores", cpu, CPU_LIMIT, "limit"),
    ]


def _record(
    seconds: int, split_bytes: int
) -> tuple[RunWriter, npt.NDArray[np.float64], npt.NDArray[np.float64], float]:
    """Return the closed writer, how long handing over took and how late it was, and the share of a core it used."""
    with tempfile.TemporaryDirectory(prefix="bench-benchmark-") as folder:
        path = Path(folder) / "run.mcap"
        writer = RunWriter(
            path, RunClock.start(), config_toml="", versions={}, run_id="benchmark", split_bytes=split_bytes
        )
        clock = _find_cpu_clock()
        begin_s = time.clock_gettime(clock)
        recorded, late = _pace(writer.put, seconds)
        cpu = (time.clock_gettime(clock) - begin_s) / seconds
        writer.close(exit_status="success", reason="")
    return writer, recorded, late, cpu


def _find_cpu_clock() -> int:
    """Return the clock of what the recorder's thread has used of its core."""
    recorder = next(thread for thread in threading.enumerate() if thread.name == "recorder")
    return time.pthread_getcpuclockid(recorder.ident or 0)


def _compare(what: str, with_it: npt.NDArray[np.float64], without: npt.NDArray[np.float64]) -> Row:
    peer = f"{_describe(without)} (no recorder)"
    return Row(f"{what}, ms: p50, p99.9, largest", _describe(with_it), peer, "-")


def _describe(stalls_ms: npt.NDArray[np.float64]) -> str:
    return ", ".join(f"{value:.3f}" for value in (*np.percentile(stalls_ms, [50, 99.9]), stalls_ms.max()))


def _pace(put: Callable[[Record], None], seconds: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Hand over the records of each turn when it is due.

    Returns
    -------
    stalls, late : numpy.ndarray
        For each turn, milliseconds: how long handing over took, and from when it was due to its end.
    """
    records = _make_turns(seconds * TURNS_PER_S)
    stalls, late = np.zeros(len(records)), np.zeros(len(records))
    begin = time.perf_counter_ns()
    for i, turn in enumerate(records):
        due = begin + i * 1_000_000_000 // TURNS_PER_S
        if (wait_ns := due - time.perf_counter_ns()) > 0:
            time.sleep(wait_ns * 1e-9)
        before = time.perf_counter_ns()
        for record in turn:
            put(record)
        after = time.perf_counter_ns()
        stalls[i], late[i] = (after - before) * 1e-6, (after - due) * 1e-6
    return stalls, late


def _make_turns(n: int) -> list[tuple[Record, ...]]:
    rng = np.random.default_rng(1)
    frames = [_make_frame(i, rng) for i in range(200)]
    states = [_make_state(i, rng) for i in range(600)]
    return [(*(states[(3 * i + k) % 600] for k in range(STATES_PER_FRAME)), frames[i % 200]) for i in range(n)]


def _make_state(i: int, rng: np.random.Generator) -> RobotState:
    def six() -> tuple[float, ...]:
        return tuple(rng.normal(0, 1, 6).tolist())

    return RobotState(
        arrival_ns=i * 333_333,
        capture_ns=i * 333_333,
        sequence=i,
        segment=0,
        controller_time_s=i / 3000,
        q_rad=six(),
        qd_rad_s=six(),
        target_q_rad=six(),
        current_a=six(),
        tcp_pose=six(),
        tcp_speed=six(),
        tcp_force=six(),
    )


def _make_frame(i: int, rng: np.random.Generator) -> TrackerFrame:
    return TrackerFrame(
        arrival_ns=i * 1_000_000,
        capture_ns=i * 1_000_000,
        frame_number=i,
        device_ticks=i,
        stamp=StampKind.MID_EXPOSURE,
        points_m=rng.normal(0, 1, (N_POINTS, 3)).astype(np.float32),
        ids=np.full(N_POINTS, NO_ID, np.uint32),
        flags=np.zeros(N_POINTS, np.uint32),
        residual_m=np.zeros(N_POINTS, np.float32),
    )
