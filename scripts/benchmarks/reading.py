"""A long recording: read into arrays, how fast and in how much memory, beside the readers of others; and salvaged.

By elapsed time, for ours reads with a second core where there is one, and on one core by processor time, in which
what else the machine does is not. Each of our readings is the first of its process, as in `bench report`: pages of
memory are new to it. The best of several counts: a virtual machine whose host takes back memory that lies free pays
seconds for the first gigabyte that it uses again. All of them hold every chunk against its checksum.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from bench.config import simulated_config_text
from bench.model import NO_ID, Record, RobotState, StampKind, TrackerFrame
from bench.recording import FRAME, POINTS, ROBOT, Columns, RunWriter, open_run, salvage_in_place
from bench.timing import ManualClock
from benchmarks.table import Row, ratio_row

N_FRAMES, FULL_N_FRAMES = 40_000, 400_000
STATES_PER_FRAME = 5
N_POINTS = 10
N_PEER_MESSAGES = 60_000
N_TEMPLATES = 1000
"""More than LZ4 looks back over: what is random does not pack, so the reader has all its bytes to move."""
N_READINGS = 5
MB_PER_S_LIMIT = 1000.0
MEMORY_LIMIT = 2.0
"""Times the arrays that are kept."""
SALVAGE_LIMIT_S_PER_GB = 2.0
SCRIPTS = Path(__file__).parents[1]
TOPICS = [ROBOT, POINTS, FRAME]
START_NS = 1_700_000_000_000_000_000
FRAME_NS = 1_000_000_000 // 360


def measure_reading(folder: Path, full: bool) -> list[Row]:
    """Read robot states and points with their frames, against `mcap`'s messages and their ordinary decoder."""
    path = folder / "reading.mcap"
    write_long_run(path, FULL_N_FRAMES if full else N_FRAMES)
    all_cores, one_core = (_read_apart(path, cores) for cores in ("all", "one"))
    n_messages, unpacked = all_cores["n_messages"], all_cores["unpacked"]
    what = f"reading, {n_messages / 1e6:.2f} million messages: "
    rows = []
    for work, peer in ((read_messages, "mcap, not decoded"), (decode_messages, "mcap-ros2-support")):
        elapsed_s, cpu_s = time_peer(path, work)
        rows += [
            ratio_row(what + "messages/s", n_messages / all_cores["elapsed_s"], N_PEER_MESSAGES / elapsed_s, peer),
            ratio_row(what + "one core, messages/s", n_messages / one_core["cpu_s"], N_PEER_MESSAGES / cpu_s, peer),
        ]
    rows += [
        ratio_row(what + "one core, MB/s unpacked", unpacked / 1e6 / one_core["cpu_s"], MB_PER_S_LIMIT, "limit"),
        ratio_row(what + "peak memory / arrays", all_cores["peak"] / all_cores["kept"], MEMORY_LIMIT, "limit"),
    ]
    rows.append(_measure_salvage(path))
    path.unlink()
    return rows


def _measure_salvage(path: Path) -> Row:
    """Take the end off the file, in the midst of its last chunk, and finish it in place."""
    n_bytes = open_run(path).status.bytes_total
    with path.open("rb") as stream:
        last = make_reader(stream).get_summary().chunk_indexes[-1]
    os.truncate(path, last.chunk_start_offset + last.chunk_length // 2)
    begin = time.perf_counter()
    salvage_in_place(path)
    seconds_per_gb = (time.perf_counter() - begin) / (n_bytes / 1e9)
    return ratio_row(
        f"salvage in place of {n_bytes / 1e9:.2f} GB: s/GB", seconds_per_gb, SALVAGE_LIMIT_S_PER_GB, "limit"
    )


def _read_apart(path: Path, cores: str) -> dict[str, float]:
    """Read in new processes; of each figure the best."""
    command = [sys.executable, "-m", "benchmarks.reading", str(path), cores]
    found = [json.loads(subprocess.check_output(command, text=True, cwd=SCRIPTS)) for _ in range(N_READINGS)]
    return {name: min(one[name] for one in found) for name in found[0]}


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
    def six() -> tuple[float, ...]:
        return tuple(rng.normal(0, 1, 6).tolist())

    return RobotState(
        arrival_ns=0,
        capture_ns=0,
        sequence=0,
        segment=0,
        controller_time_s=0.0,
        q_rad=six(),
        qd_rad_s=six(),
        target_q_rad=six(),
        current_a=six(),
        joint_temperature_c=six(),
        tcp_pose=six(),
        tcp_speed=six(),
        tcp_force=six(),
        target_qd_rad_s=six(),
    )


def read_messages(path: Path) -> None:
    with path.open("rb") as stream:
        deque(islice(make_reader(stream, validate_crcs=True).iter_messages(topics=TOPICS), N_PEER_MESSAGES), maxlen=0)


def decode_messages(path: Path) -> None:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        deque(islice(reader.iter_decoded_messages(topics=TOPICS), N_PEER_MESSAGES), maxlen=0)


def time_peer(path: Path, work: Callable[[Path], None]) -> tuple[float, float]:
    """Return elapsed and processor time of the first `N_PEER_MESSAGES`, of each the best."""
    times = []
    for _ in range(N_READINGS):
        begin_s, cpu_begin_s = time.perf_counter(), time.process_time()
        work(path)
        times.append((time.perf_counter() - begin_s, time.process_time() - cpu_begin_s))
    elapsed_s, cpu_s = zip(*times, strict=True)
    return min(elapsed_s), min(cpu_s)


def measure_own(path: Path, cores: str) -> dict[str, float]:
    """Read all topics; the peak of memory is that above what the interpreter took before."""
    if cores == "one":
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    open_run(path).read_edge(ROBOT, last=True)  # imports
    before, begin_s, cpu_begin_s = _peak_bytes(), time.perf_counter(), time.process_time()
    run = open_run(path)
    run.load(TOPICS)
    return {
        "elapsed_s": time.perf_counter() - begin_s,
        "cpu_s": time.process_time() - cpu_begin_s,
        "peak": _peak_bytes() - before,
        "kept": count_bytes([run[topic] for topic in TOPICS]),
        "n_messages": sum(run.topics.values()),
        "unpacked": count_unpacked(path),
    }


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
    print(json.dumps(measure_own(Path(sys.argv[1]), sys.argv[2])))
