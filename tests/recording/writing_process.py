"""A process that records as a run does, and says in shared memory what it has put: the child that tests kill.

Alone it is a sweep: ``python tests/recording/writing_process.py 50`` kills fifty and prints as JSON what was lost; with
a second number, on a disk whose every sync takes so many seconds; with a third, in parts of so many bytes.
"""

from __future__ import annotations

import json
import mmap
import os
import random
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from recording_examples import make_frame, make_state, open_writer

from bench.recording import FRAME, POINTS, ROBOT, open_run
from bench.timing import RunClock

STATES_PER_S = 500
STATES_PER_FRAME = 5
PATIENCE_S = 60.0
_SLOTS = struct.Struct("<4q")
"""Number and arrival of the last state that was put, of the last frame, and the longest that the child was late."""


@dataclass(frozen=True)
class Loss:
    """What a killed process put, and what its file holds."""

    put_states: int
    put_frames: int
    kept_states: list[int]
    kept_frames: list[int]
    n_parts: int
    lost_s: float
    """From the last state in the file to the last that was put."""
    late_s: float
    """The longest that the machine kept the process from its turn: no promise of a recorder's covers that."""

    @property
    def is_whole_before_its_end(self) -> bool:
        """Every record before the last that was kept is there, once."""
        return all(kept == list(range(len(kept))) for kept in (self.kept_states, self.kept_frames))


def record_until_killed(path: Path, shared: Path, sync_takes_s: float, split_bytes: int) -> None:
    """Put 500 states and 100 frames a second, for ever, on a disk whose every sync takes so long, in such parts."""
    slow_down_the_disk(sync_takes_s)
    with shared.open("r+b") as file:
        slots = mmap.mmap(file.fileno(), _SLOTS.size)
    clock = RunClock.start()
    writer = open_writer(path, clock, split_bytes=split_bytes)
    begin, late_ns, number = clock.now_ns(), 0, 0
    while True:
        due = begin + number * 1_000_000_000 // STATES_PER_S
        clock.sleep_until_ns(due)
        now = clock.now_ns()
        late_ns = max(late_ns, now - due)
        writer.put(make_state(number, arrival_ns=now, capture_ns=now))
        if number % STATES_PER_FRAME == 0:
            writer.put(make_frame(number // STATES_PER_FRAME, arrival_ns=now, capture_ns=now))
        slots[:] = _SLOTS.pack(number, now, number // STATES_PER_FRAME, late_ns)
        number += 1


def slow_down_the_disk(sync_takes_s: float) -> None:
    sync = os.fdatasync

    def slow(descriptor: int) -> None:
        time.sleep(sync_takes_s)
        sync(descriptor)

    os.fdatasync = slow


@contextmanager
def writing_process(
    path: Path, shared: Path, sync_takes_s: float = 0.0, split_bytes: int = 0
) -> Iterator[subprocess.Popen[bytes]]:
    """Start the child, wait for its first records, and see that nothing of it is left."""
    shared.write_bytes(_SLOTS.pack(-1, 0, -1, 0))
    child = subprocess.Popen([sys.executable, __file__, *map(str, (path, shared, sync_takes_s, split_bytes))])
    try:
        pause = threading.Event()
        for _ in range(round(PATIENCE_S / 0.01)):
            if read_slots(shared)[0] >= 0:
                break
            assert child.poll() is None, "the child ended by itself"
            pause.wait(0.01)
        yield child
    finally:
        child.kill()
        child.wait()


def read_slots(shared: Path) -> tuple[int, int, int, int]:
    number, arrival_ns, frame, late_ns = _SLOTS.unpack(shared.read_bytes())
    return number, arrival_ns, frame, late_ns


def measure_loss(path: Path, shared: Path) -> Loss:
    """Compare what was put with what the unfinished run holds whose file, or first part, is `path`."""
    run = open_run(path)
    run.load([ROBOT, POINTS])  # fails where a frame is without its points
    number, arrival_ns, frame, late_ns = read_slots(shared)
    last = int(run[ROBOT].arrival_ns[-1]) if len(run[ROBOT].arrival_ns) else arrival_ns - 10**12
    frames = (run[FRAME].frame_number - 1000).tolist()
    lost_s, late_s = max(arrival_ns - last, 0) * 1e-9, late_ns * 1e-9
    return Loss(number, frame, run[ROBOT].sequence.tolist(), frames, len(run.parts), lost_s, late_s)


def kill_after(folder: Path, seconds: float, sync_takes_s: float = 0.0, split_bytes: int = 0) -> Loss:
    """Kill a recording process `seconds` after its first record."""
    path, shared = folder / "run.mcap", folder / "shared"
    with writing_process(path, shared, sync_takes_s, split_bytes) as child:
        threading.Event().wait(seconds)
        child.send_signal(signal.SIGKILL)
        child.wait()
    return measure_loss(find_first_part(folder), shared)


def find_first_part(folder: Path) -> Path:
    """Return the file of an unfinished run, or the first of its parts: only the newest of them is still active."""
    active = folder / "run.mcap.active"
    return active if active.exists() else folder / "run.mcap"


def sweep(n: int, sync_takes_s: float, split_bytes: int) -> None:
    """Kill `n` processes at random moments and print what was lost."""
    losses = []
    for _ in range(n):
        with tempfile.TemporaryDirectory() as folder:
            losses.append(kill_after(Path(folder), random.uniform(1.0, 3.0), sync_takes_s, split_bytes))
    lost_s = [loss.lost_s for loss in losses]
    figures = {
        "killed": n,
        "lost_at_most_s": round(max(lost_s), 3),
        "lost_in_the_median_s": round(statistics.median(lost_s), 3),
        "late_at_most_s": round(max(loss.late_s for loss in losses), 3),
        "parts_at_most": max(loss.n_parts for loss in losses),
        "files_with_gaps": sum(not loss.is_whole_before_its_end for loss in losses),
    }
    sys.stdout.write(json.dumps(figures) + "\n")


if __name__ == "__main__":
    match sys.argv[1:]:
        case [n]:
            sweep(int(n), 0.0, 0)
        case [n, sync_takes_s]:
            sweep(int(n), float(sync_takes_s), 0)
        case [n, sync_takes_s, split_bytes]:
            sweep(int(n), float(sync_takes_s), int(split_bytes))
        case [path, shared, sync_takes_s, split_bytes]:
            record_until_killed(Path(path), Path(shared), float(sync_takes_s), int(split_bytes))
