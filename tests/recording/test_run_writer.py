from __future__ import annotations

import errno
import os
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording_examples import MINIMAL_TOML, T0_NS, make_frame, make_state, open_writer, write_run

from bench.errors import BenchError, DiskFullError, RecordingError, RecordingExistsError
from bench.model import DeviceInfo, LogEntry, Severity
from bench.recording import BODIES, FRAME, LOG, POINTS, ROBOT, STATS, RunWriter, open_run
from bench.timing import ManualClock

PATIENCE_S = 30.0


class StuckDisk:
    """Stands in for `os.fdatasync`: holds the writer thread until it is released."""

    def __init__(self) -> None:
        self.reached = threading.Event()
        self.released = threading.Event()

    def __call__(self, _descriptor: int) -> None:
        self.reached.set()
        self.released.wait(PATIENCE_S)


@contextmanager
def stuck_writer(path: Path, monkeypatch: pytest.MonkeyPatch, **changes: Any) -> Iterator[tuple[RunWriter, StuckDisk]]:
    clock = ManualClock(T0_NS)
    writer = open_writer(path, clock, **changes)
    disk = StuckDisk()
    monkeypatch.setattr("bench.recording.files.output.os.fdatasync", disk)
    clock.advance_ns(2_000_000_000)
    assert disk.reached.wait(PATIENCE_S)
    try:
        yield writer, disk
    finally:
        disk.released.set()


def break_stream(writer: RunWriter, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """Let every further write to the file fail."""

    def fail(_data: bytes) -> int:
        raise OSError(number, os.strerror(number))

    class Broken:
        def __init__(self, stream: Any) -> None:
            self._stream = stream
            self.write = fail

        def __getattr__(self, name: str) -> Any:
            return getattr(self._stream, name)

    monkeypatch.setattr(writer._parts._part._mcap, "_Writer__stream", Broken(writer._parts._part.file.stream))


def test_a_run_carries_its_metadata(tmp_path: Path) -> None:
    writer = open_writer(tmp_path / "run.mcap", extra={"bench.facts": {"operator": "Ada"}})
    info = DeviceInfo("tracker", "natnet", "10.0.0.2", "4.1", 100.0, {1: "pole", 7: "Flansch"}, {"host": "Motive"})
    writer.add_device(info)
    writer.add_metadata("bench.note", {"key": "value"})
    run = open_run(writer.close(exit_status="abort", reason="stopped by the operator"))
    assert run.status.complete
    assert str(run.status).startswith("complete: ")
    assert (run.exit_status, run.exit_reason) == ("abort", "stopped by the operator")
    assert run.devices == [info]
    assert run.metadata["bench.note"] == {"key": "value"}
    assert run.metadata["bench.facts"] == {"operator": "Ada"}
    assert run.versions == {"bench": "0.1.0"}
    assert run.run_id == "run-7"
    assert run.config_toml == MINIMAL_TOML
    assert run.config.cable.minimum_bend_radius_mm == 60.0
    assert run.metadata["bench.run"]["started_utc"].startswith("2023-11-14T22:13:20")


def test_the_configuration_is_also_an_attachment(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    with write_run(tmp_path / "run.mcap", []).open("rb") as stream:
        attachments = list(make_reader(stream).iter_attachments())
    assert [(a.name, a.data.decode()) for a in attachments] == [("config.toml", MINIMAL_TOML)]


def test_attachments_are_texts_or_any_bytes_and_are_read_back_by_name(tmp_path: Path) -> None:
    content = bytes(range(256)) * 9
    writer = open_writer(tmp_path / "run.mcap", attachments={"calibration.toml": "[time]", "program.urp": content})
    unfinished = open_run(tmp_path / "run.mcap.active")
    assert unfinished.read_attachment("program.urp") == content
    run = open_run(writer.close(exit_status="success", reason=""))
    assert run.read_attachment("program.urp") == content
    assert run.read_attachment("calibration.toml") == b"[time]"
    with pytest.raises(RecordingError, match="no attachment 'other'"):
        run.read_attachment("other")


def test_the_file_has_its_active_name_until_it_is_closed(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "run.mcap"
    writer = open_writer(path)
    assert [p.name for p in path.parent.iterdir()] == ["run.mcap.active"]
    assert writer.close(exit_status="success", reason="") == path
    assert [p.name for p in path.parent.iterdir()] == ["run.mcap"]
    assert writer.close(exit_status="success", reason="") == path


@pytest.mark.parametrize("name", ["run.mcap", "run.mcap.active"])
def test_an_existing_file_is_never_overwritten(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"precious")
    with pytest.raises(RecordingExistsError, match=r"run\.mcap.* exists already"):
        open_writer(tmp_path / "run.mcap")
    assert [p.read_bytes() for p in tmp_path.iterdir()] == [b"precious"]


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="is, or lies under, a file"):
        open_writer(tmp_path / "file" / "run.mcap")
    with pytest.raises(RecordingError, match="is, or lies under, a file"):
        open_writer(tmp_path / "file" / "folder" / "run.mcap")


def test_a_disk_that_is_full_at_once_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("bench.recording.files.output.os.fdatasync", full)
    with pytest.raises(DiskFullError, match="No space left"):
        open_writer(tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []


def test_a_name_that_is_taken_meanwhile_keeps_both_files(tmp_path: Path) -> None:
    writer = open_writer(tmp_path / "run.mcap")
    writer.put(make_state(1))
    (tmp_path / "run.mcap").write_bytes(b"precious")
    with pytest.raises(RecordingExistsError, match=r"complete in .*run\.mcap\.active"):
        writer.close(exit_status="success", reason="")
    assert (tmp_path / "run.mcap").read_bytes() == b"precious"
    run = open_run(tmp_path / "run.mcap.active")
    assert run.status.complete
    assert run[ROBOT].sequence.tolist() == [1]


@pytest.mark.parametrize("taken", [False, True])
def test_a_file_system_without_links_is_no_obstacle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, taken: bool
) -> None:
    def no_links(_a: object, _b: object) -> None:
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    writer = open_writer(tmp_path / "run.mcap")
    monkeypatch.setattr("bench.recording.files.output.os.link", no_links)
    if taken:
        (tmp_path / "run.mcap").write_bytes(b"precious")
        with pytest.raises(RecordingExistsError):
            writer.close(exit_status="success", reason="")
        assert (tmp_path / "run.mcap").read_bytes() == b"precious"
    else:
        assert open_run(writer.close(exit_status="success", reason="")).status.complete
        assert not (tmp_path / "run.mcap.active").exists()


def test_what_does_not_fit_the_queue_is_dropped_and_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with stuck_writer(tmp_path / "run.mcap", monkeypatch, queue_limit=10) as (writer, disk):
        for i in range(8):
            writer.put(make_state(i))
        for i in range(5):
            writer.put(make_frame(i, n_points=2, n_bodies=3))
        assert writer.queue_length == 10
        writer.note_missed(ROBOT, 4)
        waiting = writer.stats
        assert (waiting[ROBOT].received, waiting[ROBOT].enqueued, waiting[ROBOT].written) == (8, 8, 0)
        assert (waiting[BODIES].received, waiting[BODIES].enqueued, waiting[BODIES].dropped) == (15, 6, 9)
        disk.released.set()
        run = open_run(writer.close(exit_status="success", reason=""))
    totals = run.totals
    assert (totals[ROBOT].received, totals[ROBOT].written, totals[ROBOT].missed) == (8, 8, 4)
    assert (totals[POINTS].received, totals[POINTS].written, totals[POINTS].dropped) == (5, 2, 3)
    assert (totals[BODIES].received, totals[BODIES].written, totals[BODIES].dropped) == (15, 6, 9)
    assert (totals[ROBOT].enqueued, totals[POINTS].enqueued, totals[BODIES].enqueued) == (8, 2, 6)
    assert all(total.received == total.written + total.dropped for total in totals.values())
    assert {topic: total.written for topic, total in totals.items() if total.written} == run.topics
    assert totals[ROBOT].queue_high_water == 10
    last = {topic: i for i, topic in enumerate(run[STATS].topic)}
    assert run[STATS].dropped[last[FRAME]] == 3
    assert run[STATS].enqueued[last[FRAME]] == 2


def test_a_slow_disk_loses_nothing_and_never_holds_up_the_devices(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with stuck_writer(tmp_path / "run.mcap", monkeypatch) as (writer, disk):
        for i in range(3000):
            writer.put(make_state(i))  # the writer thread is held: this returns all the same
        disk.released.set()
        run = open_run(writer.close(exit_status="success", reason=""))
    assert run[ROBOT].sequence.tolist() == list(range(3000))
    assert run.totals[ROBOT].dropped == 0


class RushingClock(ManualClock):
    """Every look at it finds a second gone."""

    def now_ns(self) -> int:
        self.advance_ns(1_000_000_000)
        return super().now_ns()


def test_a_long_queue_does_not_put_off_the_sync(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = StuckDisk()
    writer = open_writer(tmp_path / "run.mcap", RushingClock(T0_NS))
    monkeypatch.setattr("bench.recording.files.output.os.fdatasync", disk)
    assert disk.reached.wait(PATIENCE_S)
    for i in range(5000):
        writer.put(make_state(i))
    disk.released.set()
    stats = open_run(writer.close(exit_status="success", reason=""))[STATS]
    of_robot = stats.topic == ROBOT
    assert len({n for n in stats.written[of_robot].tolist() if 0 < n < 5000}) >= 4
    assert set(stats.enqueued[of_robot].tolist()) <= {0, 5000}


def test_records_of_a_file_wait_where_the_queue_is_full(tmp_path: Path) -> None:
    writer = open_writer(tmp_path / "run.mcap", queue_limit=50)
    writer.put_all(make_state(i) for i in range(400))
    run = open_run(writer.close(exit_status="success", reason=""))
    assert run[ROBOT].sequence.tolist() == list(range(400))
    assert run.totals[ROBOT].dropped == 0


def test_a_record_that_cannot_be_encoded_is_dropped_and_the_rest_is_written(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    writer = open_writer(tmp_path / "run.mcap")
    writer.put(make_state(1, cycle_count=2**40))
    writer.put(make_frame(1, residual_m=np.zeros(1, np.float32)))
    writer.put("no record at all")  # type: ignore[arg-type]
    writer.put(make_state(2))
    run = open_run(writer.close(exit_status="success", reason=""))
    assert run[ROBOT].sequence.tolist() == [2]
    assert (run.totals[ROBOT].dropped, run.totals[FRAME].dropped) == (1, 1)
    assert "cannot be recorded" in caplog.text


def test_events_are_numbered_by_the_recorder(tmp_path: Path) -> None:
    entries = [LogEntry(T0_NS, Severity.INFO, "run", "again") for _ in range(3)]
    assert open_run(write_run(tmp_path / "run.mcap", entries))[LOG].sequence.tolist() == [0, 1, 2]


def test_a_full_disk_stops_the_recording_once_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ManualClock(T0_NS)
    told: list[tuple[BenchError, str]] = []
    failed = threading.Event()

    def on_failure(error: BenchError) -> None:
        told.append((error, threading.current_thread().name))
        failed.set()

    writer = open_writer(tmp_path / "run.mcap", clock, on_failure=on_failure)
    writer.put(make_state(0))
    clock.advance_ns(2_000_000_000)
    wait_for_size(writer)
    break_stream(writer, monkeypatch, errno.ENOSPC)
    writer.put(make_state(1))
    clock.advance_ns(2_000_000_000)
    assert failed.wait(PATIENCE_S)
    writer.put(make_state(2))
    assert isinstance(writer.failure, DiskFullError)
    for _ in range(2):
        with pytest.raises(DiskFullError, match="cannot take more"):
            writer.close(exit_status="success", reason="")
    assert told == [(writer.failure, "recorder")]
    stats = writer.stats[ROBOT]
    assert (stats.received, stats.enqueued, stats.written, stats.dropped) == (3, 2, 1, 2)
    run = open_run(tmp_path / "run.mcap.active")
    assert not run.status.complete
    assert run.exit_status == "unfinished"
    assert run[ROBOT].sequence.tolist() == [0]


def wait_for_size(writer: RunWriter) -> None:
    """Return when the first chunk is in the file and synced."""
    pause = threading.Event()
    while not writer.stats[ROBOT].sync_ms and not writer._counts._confirmed[ROBOT]:
        pause.wait(0.005)


def test_a_disk_that_fails_while_closing_is_told_by_close(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[BenchError] = []
    writer = open_writer(tmp_path / "run.mcap", on_failure=told.append)
    break_stream(writer, monkeypatch, errno.EIO)
    writer.put(make_state(1))
    with pytest.raises(RecordingError, match="Input/output error"):
        writer.close(exit_status="success", reason="")
    assert told == []
    assert writer.stats[ROBOT].dropped == 1
    assert (tmp_path / "run.mcap.active").exists()


def test_a_file_that_vanishes_is_a_failure(tmp_path: Path) -> None:
    clock = ManualClock(T0_NS)
    failed = threading.Event()
    writer = open_writer(tmp_path / "run.mcap", clock, on_failure=lambda _: failed.set())
    (tmp_path / "run.mcap.active").unlink()
    clock.advance_ns(2_000_000_000)
    assert failed.wait(PATIENCE_S)
    with pytest.raises(RecordingError, match="No such file"):
        writer.close(exit_status="success", reason="")


def test_a_fault_of_our_own_ends_the_recording_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    writer = open_writer(tmp_path / "run.mcap")
    monkeypatch.setattr(writer._counts, "confirm", None)
    with pytest.raises(RecordingError, match="cannot be written: TypeError"):
        writer.close(exit_status="success", reason="")
    assert "the recorder failed" in caplog.text


def test_importing_into_a_failed_file_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ManualClock(T0_NS)
    writer = open_writer(tmp_path / "run.mcap", clock, queue_limit=5)
    break_stream(writer, monkeypatch, errno.ENOSPC)
    clock.advance_ns(2_000_000_000)
    with pytest.raises(DiskFullError):
        writer.put_all(make_state(i) for i in range(10_000_000))
    with pytest.raises(DiskFullError):
        writer.close(exit_status="fail", reason="")


def test_a_callback_that_fails_does_not_hide_the_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def on_failure(_error: BenchError) -> None:
        raise RuntimeError("the callback's own fault")

    clock = ManualClock(T0_NS)
    writer = open_writer(tmp_path / "run.mcap", clock, on_failure=on_failure)
    break_stream(writer, monkeypatch, errno.ENOSPC)
    clock.advance_ns(2_000_000_000)
    writer._thread.join(PATIENCE_S)
    with pytest.raises(DiskFullError):
        writer.close(exit_status="success", reason="")
    assert "could not be told" in caplog.text


def test_statistics_are_written_each_second_for_every_topic_that_had_records(tmp_path: Path) -> None:
    clock = ManualClock(T0_NS)
    writer = open_writer(tmp_path / "run.mcap", clock)
    for i in range(3):
        writer.put(make_state(i))
        clock.advance_ns(1_000_000_000)
        pause = threading.Event()
        while writer._counts._confirmed[ROBOT] <= i:
            pause.wait(0.005)
    run = open_run(writer.close(exit_status="success", reason=""))
    received = run[STATS].received[run[STATS].topic == ROBOT]
    assert received.tolist() == [1, 2, 3, 3]


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "bench-test", folder], capture_output=True)
    if mounted.returncode:
        pytest.skip("mounting a small file system needs root")
    yield folder
    subprocess.run(["umount", "--lazy", folder], check=True, capture_output=True)


def test_on_a_disk_that_is_really_full_everything_before_is_readable(small_disk: Path) -> None:
    writer = open_writer(small_disk / "run.mcap", queue_limit=100)
    with pytest.raises(DiskFullError):
        writer.put_all(make_frame(i, n_points=50) for i in range(100_000))
    with pytest.raises(DiskFullError):
        writer.close(exit_status="fail", reason="")
    run = open_run(small_disk / "run.mcap.active")
    numbers = run[POINTS].frame_number
    assert len(numbers) > 500
    assert numbers.tolist() == list(range(1000, 1000 + len(numbers)))
    assert writer.stats[FRAME].written <= len(numbers)
    assert all(s.received == s.written + s.dropped for s in writer.stats.values())
