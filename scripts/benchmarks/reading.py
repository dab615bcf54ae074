"""Reading a long recording into arrays: how fast on one core, in how much memory, beside the readers of others.

Speeds are by processor time, so that what else the machine does is in none of them.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from bench.config import simulated_config_text
from bench.model import NO_ID, Record, RobotState, StampKind, TrackerFrame
from bench.recording import FRAME, POINTS, ROBOT, Columns, RunWriter, open_run
from bench.timing import ManualClock
from benchmarks.table import Row, ratio_row

N_FRAMES, FULL_N_FRAMES = 40_000, 400_000
STATES_PER_FRAME = 5
N_POINTS = 10
N_PEER_MESSAGES = 60_000
N_TEMPLATES = 1000
"""More than LZ4 looks back over: what is random does not pack, so the reader has all its bytes to move."""
MB_PER_S_LIMIT = 300.0
MEMORY_LIMIT = 2.0
"""Times the arrays that are kept."""
SCRIPTS = Path(__file__).parents[1]
TOPICS = [ROBOT, POINTS, FRAME]
START_NS = 1_700_000_000_000_000_000
FRAME_NS = 1_000_000_000 // 360


def measure_reading(folder: Path, full: bool) -> list[Row]:
    """Read robot states and points with their frames, against `mcap`'s messages and their ordinary decoder."""
    path = folder / "reading.mcap"
    write_long_run(path, FULL_N_FRAMES if full else N_FRAMES)
    ours = json.loads(
        subprocess.check_output([sys.executable, "-m", "benchmarks.reading", path], text=True, cwd=SCRIPTS)
    )
    n_per_s = ours["n_messages"] / ours["seconds"]
    what = f"reading, {ours['n_messages'] / 1e6:.2f} million messages, one core: "
    rows = [
        ratio_row(what + "messages/s", n_per_s, rate(path, read_messages), "mcap, not decoded"),
        ratio_row(what + "messages/s", n_per_s, rate(path, decode_messages), "mcap-ros2-support"),
        ratio_row(what + "MB/s unpacked", ours["unpacked"] / 1e6 / ours["seconds"], MB_PER_S_LIMIT, "limit"),
        ratio_row(what + "peak memory / arrays", ours["peak"] / ours["kept"], MEMORY_LIMIT, "limit"),
    ]
    path.unlink()
    return rows


def write_long_run(path: Path, n_frames: int) -> None:
    """Write frames and robot states of random numbers."""
    writer = RunWriter(
        path, ManualClock(START_NS), config_toml=simulated_config_text(), versions={}, run_id="benchmark"
    )
    writer.put_all(make_records(n_frames))
    writer.close(exit_status="success", reason="")


def make_records(n_frames: int) -> Iterator[Record]:
    rng = np.random.default_rng(1)
    frames, states = [_make_frame(rng) for _ in range(N_TEMPLATES)], [_make_state(rng) for _ in range(N_TEMPLATES)]
    for i in range(n_frames):
        now_ns = START_NS + i * FRAME_NS
        yield replace(frames[i % N_TEMPLATES], frame_number=i, arrival_ns=now_ns, capture_ns=now_ns - 3_000_000)
        for k in range(STATES_PER_FRAME):
            j, later_ns = i * STATES_PER_FRAME + k, now_ns + k * FRAME_NS // STATES_PER_FRAME
            yield replace(states[j % N_TEMPLATES], sequence=j, arrival_ns=later_ns, capture_ns=later_ns - 100_000)


def _make_frame(rng: np.random.Generator) -> TrackerFrame:
    return TrackerFrame(
        arrival_ns=0,
        capture_ns=0,
        frame_number=0,
        device_ticks=0,
        stamp=StampKind.MID_EXPOSURE,
        points_m=rng.random((N_POINTS, 3), dtype=np.float32),
        ids=np.full(N_POINTS, NO_ID, np.uint32),
        flags=np.zeros(N_POINTS, np.uint32),
        residual_m=rng.random(N_POINTS, dtype=np.float32),
        bodies=(),
    )


def _make_state(rng: np.random.Generator) -> RobotState:
    q_rad, tcp_pose = (tuple(rng.normal(0, 1, 6).tolist()) for _ in range(2))
    return RobotState(
        arrival_ns=0, capture_ns=0, sequence=0, segment=0, controller_time_s=0.0, q_rad=q_rad, tcp_pose=tcp_pose
    )


def read_messages(path: Path) -> int:
    with path.open("rb") as stream:
        messages = make_reader(stream).iter_messages(topics=TOPICS)
        return sum(1 for _ in zip(range(N_PEER_MESSAGES), messages, strict=False))


def decode_messages(path: Path) -> int:
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        messages = reader.iter_decoded_messages(topics=TOPICS)
        return sum(1 for _ in zip(range(N_PEER_MESSAGES), messages, strict=False))


def rate(path: Path, work: Callable[[Path], int]) -> float:
    """Return messages for each second of processor time, the best of three."""
    best = 0.0
    for _ in range(3):
        begin = time.process_time()
        n = work(path)
        best = max(best, n / (time.process_time() - begin))
    return best


def measure_own(path: Path) -> dict[str, float]:
    """Read on one core; the peak is that of the first reading, above what the interpreter took before it."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    open_run(path)
    before = _peak_bytes()
    seconds = [_read(path)]
    peak = _peak_bytes() - before
    run = open_run(path)
    run.load(TOPICS)
    kept = count_bytes([run[topic] for topic in TOPICS])
    n_messages, unpacked = sum(run.topics.values()), count_unpacked(path)
    del run
    seconds += [_read(path) for _ in range(2)]
    return {"seconds": min(seconds), "peak": peak, "kept": kept, "n_messages": n_messages, "unpacked": unpacked}


def _read(path: Path) -> float:
    begin = time.process_time()
    open_run(path).load(TOPICS)
    return time.process_time() - begin


def count_unpacked(path: Path) -> int:
    with path.open("rb") as stream:
        return sum(chunk.uncompressed_size for chunk in make_reader(stream).get_summary().chunk_indexes)


def count_bytes(topics: list[Columns]) -> int:
    arrays = {id(array): array for columns in topics for array in columns.values()}
    return sum(array.nbytes for array in arrays.values())


def _peak_bytes() -> int:
    """Return the peak of this process alone; `getrusage` counts what it was forked from."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line for line in lines if line.startswith("VmHWM")).split()[1])


if __name__ == "__main__":
    print(json.dumps(measure_own(Path(sys.argv[1]))))
