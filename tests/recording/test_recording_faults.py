"""What a recording holds after the worst: killed, without power, on a slow disk, in a folder that goes away."""

from __future__ import annotations

import fcntl
import os
import random
import shutil
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from pathlib import Path

import pytest
from recording_examples import T0_NS, make_state, open_writer
from writing_process import Loss, find_first_part, kill_after, measure_loss, writing_process

from bench.errors import BenchError, RecordingError, RecordingExistsError
from bench.recording import ROBOT, STATS, RunWriter, open_run
from bench.timing import ManualClock, RunClock

PATIENCE_S = 60.0
PROMISE_S = 1.0
N_KILLED = 3
SPLIT_BYTES = 20_000
HOUR_NS = 3_600_000_000_000
SHUTDOWN, WITHOUT_ITS_JOURNAL = 0x8004587D, 2  # linux: FS_IOC_SHUTDOWN, EXT4_GOING_FLAGS_NOLOGFLUSH


def assert_within_the_promise(loss: Loss) -> None:
    assert loss.is_whole_before_its_end
    assert 0 < len(loss.kept_states) <= loss.put_states + 1
    assert loss.put_frames - 1 <= loss.put_states // 5 <= loss.put_frames + 1
    assert loss.lost_s < PROMISE_S + loss.late_s


def test_what_is_put_until_a_second_before_a_kill_is_in_the_file(tmp_path: Path) -> None:
    folders = [tmp_path / str(i) for i in range(N_KILLED)]
    for folder in folders:
        folder.mkdir()
    with ThreadPoolExecutor(N_KILLED) as pool:
        losses = list(pool.map(kill_after, folders, [random.uniform(1.2, 2.2) for _ in folders]))
    for loss in losses:
        assert_within_the_promise(loss)


def test_a_kill_while_the_run_goes_on_in_ever_new_parts_costs_no_more(tmp_path: Path) -> None:
    folders = [tmp_path / str(i) for i in range(N_KILLED)]
    for folder in folders:
        folder.mkdir()
    seconds = [random.uniform(1.5, 2.2) for _ in folders]
    with ThreadPoolExecutor(N_KILLED) as pool:
        losses = list(pool.map(kill_after, folders, seconds, [0.0, 0.0, 0.33], repeat(SPLIT_BYTES)))
    for loss in losses:
        assert_within_the_promise(loss)
        assert loss.n_parts > 1


def test_a_disk_that_takes_a_third_of_a_second_for_each_sync_keeps_the_promise(tmp_path: Path) -> None:
    assert_within_the_promise(kill_after(tmp_path, random.uniform(1.8, 2.6), sync_takes_s=0.33))
    stats = open_run(tmp_path / "run.mcap.active")[STATS]
    assert stats.sync_ms.max() >= 330
    assert stats.dropped.max() == 0


@pytest.fixture
def ext4(tmp_path: Path) -> Iterator[tuple[Path, Path]]:
    """A disk of its own, and its image."""
    image, folder = tmp_path / "image", tmp_path / "disk"
    folder.mkdir()
    if os.geteuid() != 0 or shutil.which("mkfs.ext4") is None:
        pytest.skip("cutting the power of a disk needs root, and mkfs.ext4")
    with image.open("wb") as file:
        file.truncate(64 << 20)
    subprocess.run(["mkfs.ext4", "-q", image], check=True, capture_output=True)
    mounted = subprocess.run(["mount", "-o", "loop", image, folder], capture_output=True, text=True, check=False)
    if mounted.returncode:
        pytest.skip(f"a disk of its own cannot be mounted here: {mounted.stderr.strip()}")
    yield folder, image
    subprocess.run(["umount", folder], check=True)


@pytest.mark.parametrize("split_bytes", [0, SPLIT_BYTES], ids=["one file", "in parts"])
def test_what_was_put_until_a_second_before_the_power_fails_is_on_the_disk(
    tmp_path: Path, ext4: tuple[Path, Path], split_bytes: int
) -> None:
    folder, image = ext4
    shared = tmp_path / "shared"
    with writing_process(folder / "run.mcap", shared, split_bytes=split_bytes) as child:
        threading.Event().wait(random.uniform(1.5, 2.5))
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            fcntl.ioctl(descriptor, SHUTDOWN, struct.pack("I", WITHOUT_ITS_JOURNAL))
            put = shared.read_bytes()
        finally:
            os.close(descriptor)
        child.kill()
        child.wait()
    subprocess.run(["umount", folder], check=True)
    subprocess.run(["mount", "-o", "loop", image, folder], check=True)
    shared.write_bytes(put)
    assert_within_the_promise(measure_loss(find_first_part(folder), shared))


def test_a_second_bench_on_the_same_output_is_refused_and_the_first_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with writing_process(path, tmp_path / "shared") as child:
        with pytest.raises(RecordingExistsError, match=r"run\.mcap\.active exists already"):
            open_writer(path)
        threading.Event().wait(1.2)
        child.kill()
        child.wait()
    assert_within_the_promise(measure_loss(path.with_name("run.mcap.active"), tmp_path / "shared"))


def test_of_many_that_begin_the_same_output_at_once_one_has_it(tmp_path: Path) -> None:
    together = threading.Barrier(8)

    def begin(path: Path) -> RunWriter | None:
        together.wait(PATIENCE_S)
        try:
            return open_writer(path)
        except RecordingExistsError:
            return None

    with ThreadPoolExecutor(8) as pool:
        (writer,) = (one for one in pool.map(begin, repeat(tmp_path / "run.mcap", 8)) if one is not None)
    writer.put(make_state(7))
    assert open_run(writer.close(exit_status="success", reason=""))[ROBOT].sequence.tolist() == [7]


@pytest.mark.parametrize("step_ns", [HOUR_NS, -HOUR_NS])
def test_a_clock_stepped_by_an_hour_bends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step_ns: int
) -> None:
    clock = RunClock.start()
    writer = open_writer(tmp_path / "run.mcap", clock)
    told = time.time_ns
    for i in range(2):
        if i == 1:
            monkeypatch.setattr(time, "time_ns", lambda: told() + step_ns)
            monkeypatch.setattr(time, "time", lambda: (told() + step_ns) * 1e-9)
        now = clock.now_ns()
        writer.put(make_state(i, arrival_ns=now, capture_ns=now))
        wait_until_synced(writer, i + 1)
    run = open_run(writer.close(exit_status="success", reason=""))
    times = run[ROBOT].arrival_ns
    assert (run[ROBOT].sequence.tolist(), sorted(times)) == ([0, 1], times.tolist())
    assert times[0] < run[STATS].host_ns.max() < times[0] + HOUR_NS // 2
    assert int(run.metadata["bench.end"]["ended_ns"]) >= times[-1]


def wait_until_synced(writer: RunWriter, n_states: int) -> None:
    pause = threading.Event()
    for _ in range(round(PATIENCE_S / 0.01)):
        if writer._counts._confirmed[ROBOT] >= n_states:
            return
        pause.wait(0.01)
    raise AssertionError(f"{n_states} states were not synced within {PATIENCE_S:g} s")


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    """A folder that takes no file: by its rights, or for root by its mount."""
    folder = tmp_path / "read-only"
    folder.mkdir()
    if os.geteuid() == 0:
        mounted = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", folder], capture_output=True, check=False
        )
        if mounted.returncode:
            pytest.skip(f"a folder cannot be made read-only here: {mounted.stderr.decode().strip()}")
        yield folder
        subprocess.run(["umount", folder], check=True)
    else:
        folder.chmod(0o500)
        yield folder
        folder.chmod(0o700)


@pytest.mark.parametrize("name", ["run.mcap", "new/folder/run.mcap"])
def test_a_read_only_folder_is_one_sentence_and_takes_nothing(read_only: Path, name: str) -> None:
    with pytest.raises(RecordingError, match=r"run\.mcap cannot be written: (Read-only|Permission)") as caught:
        open_writer(read_only / name)
    assert caught.value.hint == "Check the disk and the folder's permissions."
    assert caught.value.exit_code == 5
    assert list(read_only.iterdir()) == []


@pytest.mark.parametrize("is_moved", [True, False], ids=["moved", "deleted"])
def test_a_folder_that_vanishes_ends_the_recording_and_is_told(tmp_path: Path, is_moved: bool) -> None:
    clock, told, failed = ManualClock(T0_NS), [], threading.Event()

    def on_failure(error: BenchError) -> None:
        told.append(error)
        failed.set()

    writer = open_writer(tmp_path / "runs" / "run.mcap", clock, on_failure=on_failure)
    writer.put(make_state(1))
    clock.advance_ns(1_000_000_000)
    wait_until_synced(writer, 1)
    if is_moved:
        (tmp_path / "runs").rename(tmp_path / "moved")
    else:
        shutil.rmtree(tmp_path / "runs")
    writer.put(make_state(2))
    clock.advance_ns(1_000_000_000)
    assert failed.wait(PATIENCE_S)
    with pytest.raises(RecordingError, match=r"run\.mcap\.active cannot be written: No such file"):
        writer.close(exit_status="success", reason="")
    assert [str(error) for error in told] == [str(writer.failure)]
    assert (writer.stats[ROBOT].written, writer.stats[ROBOT].dropped) == (1, 1)
    if is_moved:  # what is not confirmed as written may be there all the same: it is never the other way round
        assert open_run(tmp_path / "moved" / "run.mcap.active")[ROBOT].sequence.tolist() == [1, 2]
