"""A run that is split by size: every record in one part, once, and all parts read as one run."""

from __future__ import annotations

import errno
import os
import shutil
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from recording_examples import (
    MINIMAL_TOML,
    T0_NS,
    make_frame,
    make_state,
    open_writer,
    records,
)

from bench.cli.info import info
from bench.errors import BenchError, DiskFullError, RecordingError, RecordingExistsError
from bench.model import DeviceInfo, Record
from bench.recording import FRAME, LOG, POINTS, ROBOT, STATS, TOPICS, Run, RunFollower, open_run
from bench.timing import ManualClock

PATIENCE_S = 30.0
CHUNK = b"\x03\0\0\0lz4"
N_RECORDS = 40
SPLIT_BYTES = 9_000
"""A part begins with 7 kB of definitions, so that it holds a handful of records."""


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.recording.writing.writer.CHUNK_BYTES", 1)
    spare_the_disk(monkeypatch)


def spare_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("fdatasync", "fsync"):
        monkeypatch.setattr(f"bench.recording.files.output.os.{name}", lambda _descriptor: None)


def write_split(path: Path, recorded: Sequence[Record], split_bytes: int = SPLIT_BYTES, **changes: Any) -> Path:
    writer = open_writer(path, split_bytes=split_bytes, **changes)
    writer.put_all(recorded)
    return writer.close(exit_status="success", reason="all cycles done")


def states_and_frames(n: int = N_RECORDS) -> list[Record]:
    return [record for i in range(n) for record in (make_state(i), make_frame(i, n_points=3, n_bodies=1))]


def part(folder: Path, number: int) -> Path:
    return folder / f"run.{number}.mcap"


def n_parts(folder: Path) -> int:
    return len(list(folder.glob("run*.mcap")))


@pytest.fixture
def split(tmp_path: Path) -> Path:
    path = write_split(tmp_path / "run.mcap", states_and_frames())
    assert n_parts(tmp_path) > 5
    return path


def read_states(path: Path) -> list[int]:
    numbers: list[int] = open_run(path)[ROBOT].sequence.tolist()
    return numbers


def assert_same_columns(one: Run, other: Run) -> None:
    for topic in TOPICS.keys() - {STATS}:  # the recorder's own counts, once more for each part
        assert list(one[topic]) == list(other[topic])
        for name, column in one[topic].items():
            assert column.dtype == other[topic][name].dtype
            np.testing.assert_array_equal(column, other[topic][name], err_msg=f"{topic} {name}")


def read_independently(paths: Sequence[Path]) -> list[tuple[str, int, int, int, bytes]]:
    messages = []
    for path in paths:
        with path.open("rb") as stream:
            for _, channel, one in make_reader(stream).iter_messages(log_time_order=False):
                if channel.topic != STATS:
                    messages.append((channel.topic, one.log_time, one.publish_time, one.sequence, one.data))
    return messages


@settings(max_examples=20, deadline=None)
@given(st.lists(records, max_size=30), st.integers(1_000, 12_000))
def test_split_or_not_every_column_of_every_topic_is_the_same(
    tmp_path_factory: pytest.TempPathFactory, recorded: list[Record], split_bytes: int
) -> None:
    folder = tmp_path_factory.mktemp("split")
    with pytest.MonkeyPatch.context() as patch:
        spare_the_disk(patch)
        whole = open_run(write_split(folder / "whole.mcap", recorded, 0))
        run = open_run(write_split(folder / "run.mcap", recorded, split_bytes))
    assert run.status.complete, run.status.lost
    assert_same_columns(whole, run)
    paths = [one.path for one in run.parts]
    assert read_independently(paths) == read_independently([whole.path])
    ends = ["received", "enqueued", "written", "dropped", "missed"]
    for topic in TOPICS.keys() - {STATS}:
        assert [getattr(run.totals[topic], name) for name in ends] == [
            getattr(whole.totals[topic], name) for name in ends
        ]


def test_every_part_is_a_whole_file_that_says_what_run_it_is_of(tmp_path: Path) -> None:
    device = DeviceInfo("tracker", "natnet", "10.0.0.2", "4.1", 100.0, {1: "pole"}, {"host": "Motive"})
    writer = open_writer(
        tmp_path / "run.mcap",
        split_bytes=SPLIT_BYTES,
        extra={"bench.facts": {"operator": "Ada"}},
        attachments={"calibration.toml": "[a]"},
    )
    writer.add_device(device)
    writer.put_all(states_and_frames())
    writer.close(exit_status="success", reason="done")
    assert [path.name for path in writer.paths] == [
        "run.mcap",
        *(f"run.{i}.mcap" for i in range(2, len(writer.paths) + 1)),
    ]
    assert writer.bytes_written == sum(path.stat().st_size for path in writer.paths)
    n_before = 0
    for number, path in enumerate(writer.paths, start=1):
        with path.open("rb") as stream:
            reader = make_reader(stream)
            told = {one.name: one.metadata for one in reader.iter_metadata()}
            attached = {one.name: one.data.decode() for one in reader.iter_attachments()}
            summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert attached == {"config.toml": MINIMAL_TOML, "calibration.toml": "[a]"}
        assert told["bench.run"]["run_id"] == "run-7"
        assert told["bench.facts"] == {"operator": "Ada"}
        assert told["bench.part"] == {"number": str(number), "first": "run.mcap", "written_before": str(n_before)}
        assert ("bench.device.tracker" in told) or number == 1
        is_last = number == len(writer.paths)
        assert ("bench.end" in told, "bench.continues" in told) == (is_last, not is_last)
        if not is_last:
            assert told["bench.continues"]["file"] == f"run.{number + 1}.mcap"
        n_before += summary.statistics.message_count
    assert open_run(tmp_path / "run.mcap").devices == [device]


def test_what_each_part_repeats_is_never_most_of_it(tmp_path: Path) -> None:
    large = {"program.urp": bytes(20_000)}
    run = open_run(write_split(tmp_path / "run.mcap", states_and_frames(), attachments=large))
    assert len(run.parts) > 1
    assert all(one.bytes_total > 40_000 for one in run.parts[:-1])
    assert run[ROBOT].sequence.tolist() == list(range(N_RECORDS))


def test_an_attachment_that_is_damaged_in_one_part_is_read_from_another(split: Path) -> None:
    data = bytearray(split.read_bytes())
    data[data.rindex(b"minimum_bend_radius_mm", 0, data.index(CHUNK))] ^= 1
    split.write_bytes(data)
    assert open_run(split).read_attachment("config.toml").decode() == MINIMAL_TOML


def test_a_run_that_stays_below_the_size_is_one_file(tmp_path: Path) -> None:
    path = write_split(tmp_path / "run.mcap", states_and_frames(), 1_000_000)
    run = open_run(path)
    assert [one.name for one in tmp_path.iterdir()] == ["run.mcap"]
    assert str(run.status).startswith("complete: ")
    assert "part" not in str(run.status)


def test_spans_edges_streams_and_messages_go_over_the_parts(split: Path) -> None:
    run = open_run(split)
    frames = [number for piece in run.stream([FRAME], 1) for number in piece[FRAME].frame_number.tolist()]
    assert frames == run[FRAME].frame_number.tolist() == list(range(1000, 1000 + N_RECORDS))
    middle = run.read([POINTS], T0_NS + 100_000_000, T0_NS + 200_000_000)[POINTS]
    assert middle.frame_number.tolist() == list(range(1010, 1020))
    assert (run.read_edge(ROBOT, last=False).sequence[0], run.read_edge(ROBOT, last=True).sequence[-1]) == (
        0,
        N_RECORDS - 1,
    )
    assert len(run.messages([ROBOT])) == N_RECORDS


def test_more_parts_than_are_open_at_once_are_read(split: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.recording.files.run_files.MOST_OPEN", 2)
    before = len(list(Path("/proc/self/fd").iterdir()))
    assert read_states(split) == list(range(N_RECORDS))
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_a_later_part_by_its_own_name_is_read_alone_and_says_so(split: Path) -> None:
    run = open_run(part(split.parent, 3))
    assert (run.part_number, run.first_part) == (3, "run.mcap")
    assert str(run.status).startswith("part 3 alone of the run that begins in run.mcap; complete: ")
    assert "the run goes on in run.4.mcap" in str(run.status)
    assert "open run.mcap" in run.status.lost
    assert 0 < len(run[ROBOT].sequence) < N_RECORDS


def test_a_missing_first_part_is_an_error_that_names_a_later_one(split: Path) -> None:
    split.unlink()
    with pytest.raises(RecordingError, match=r"run\.mcap cannot be opened") as caught:
        open_run(split)
    assert caught.value.hint.endswith("run.2.mcap is called like a later part of it, and can be read alone.")
    assert open_run(part(split.parent, 2)).part_number == 2


def test_a_missing_part_costs_what_is_in_it_and_is_named(split: Path) -> None:
    lost, n_lost = read_states(part(split.parent, 3)), sum(open_run(part(split.parent, 3)).topics.values())
    part(split.parent, 3).unlink()
    run = open_run(split)
    assert run[ROBOT].sequence.tolist() == [i for i in range(N_RECORDS) if i not in lost]
    assert not run.status.complete
    assert str(run.status).startswith("incomplete: ")
    assert run.status.lost == f"run.3.mcap is missing: {n_lost} messages"
    assert run.exit_status == "success"


def test_several_missing_parts_are_counted_together(split: Path) -> None:
    lost = [open_run(part(split.parent, number)) for number in (2, 3)]
    for run in lost:
        run.path.unlink()
    n_lost = sum(sum(run.topics.values()) for run in lost)
    assert open_run(split).status.lost == f"run.2.mcap, run.3.mcap are missing: {n_lost} messages"


def test_a_missing_last_part_is_missed_by_the_one_before(split: Path) -> None:
    n = n_parts(split.parent)
    part(split.parent, n).unlink()
    run = open_run(split)
    assert run.status.lost == f"run.{n}.mcap is missing, and so is all that followed"
    assert run.exit_status == "unfinished"
    assert run[ROBOT].sequence.tolist() == list(range(len(run[ROBOT].sequence)))


def write_with_other_channels(path: Path) -> None:
    with path.open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start()
        writer.add_metadata("bench.run", {"run_id": "run-7"})
        schema = writer.register_schema("bench_msgs/msg/RobotState", "ros2msg", b"int64 sequence")
        writer.add_message(writer.register_channel("/another/topic", "cdr", schema), 1, b"", 1)
        writer.finish()


@pytest.mark.parametrize("kind", ["another run", "junk", "another part", "empty", "cut", "other channels"])
def test_what_is_only_called_like_a_part_is_none(tmp_path: Path, kind: str) -> None:
    path = write_split(tmp_path / "run.mcap", states_and_frames())
    kept = read_states(part(tmp_path, 2))
    part(tmp_path, 2).unlink()
    if kind == "another run":
        write_split(part(tmp_path, 2), [make_state(77)], 0, run_id="another")
    elif kind == "another part":
        shutil.copy(part(tmp_path, 4), part(tmp_path, 2))
    elif kind == "other channels":
        write_with_other_channels(part(tmp_path, 2))
    else:
        junk = {"empty": b"", "junk": b"no mcap", "cut": path.read_bytes()[:60]}
        part(tmp_path, 2).write_bytes(junk[kind])
    run = open_run(path)
    assert run[ROBOT].sequence.tolist() == [i for i in range(N_RECORDS) if i not in kept]
    assert run.status.lost.startswith("run.2.mcap (there is run.2.mcap, but ")


def test_the_neighbour_of_a_run_in_one_file_is_not_its_part(tmp_path: Path) -> None:
    write_split(part(tmp_path, 2), [make_state(77)], 0, run_id="another")
    run = open_run(write_split(tmp_path / "run.mcap", [make_state(1)], 0))
    assert run.status.complete
    assert run[ROBOT].sequence.tolist() == [1]


def test_a_damaged_part_costs_its_damage_and_is_named(split: Path) -> None:
    data = bytearray(part(split.parent, 3).read_bytes())
    data[data.index(CHUNK) + 60] ^= 0xFF
    part(split.parent, 3).write_bytes(data)
    run = open_run(split)
    n_states = len(run[ROBOT].sequence) + len(run[FRAME].frame_number)
    assert n_states == 2 * N_RECORDS - 1
    assert str(run.status).startswith("damaged: ")
    assert "run.3.mcap" in run.status.lost


def test_a_part_without_its_end_is_named_with_what_is_lost_of_it(split: Path) -> None:
    data, whole = part(split.parent, 3).read_bytes(), open_run(part(split.parent, 3)).topics
    second_chunk = data.index(CHUNK, data.index(CHUNK) + 1)
    part(split.parent, 3).write_bytes(data[: second_chunk + 100])
    n_lost = sum(whole.values()) - sum(open_run(part(split.parent, 3)).topics.values())
    run = open_run(split)
    assert run.status.lost.startswith(f"run.3.mcap has lost its end, {n_lost} messages: ")
    assert len(run[ROBOT].sequence) < N_RECORDS


def test_a_part_that_lost_no_more_than_its_end_costs_nothing(split: Path) -> None:
    data = part(split.parent, 3).read_bytes()
    part(split.parent, 3).write_bytes(data[: data.index(b"bench.continues") - 13])
    run = open_run(split)
    assert run.status.complete, run.status.lost
    assert run[ROBOT].sequence.tolist() == list(range(N_RECORDS))


def test_the_next_parts_name_is_taken_and_the_run_goes_on_in_the_same_file(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    writer = open_writer(tmp_path / "run.mcap", split_bytes=SPLIT_BYTES)
    part(tmp_path, 2).write_bytes(b"precious")
    writer.put_all(states_and_frames())
    run = open_run(writer.close(exit_status="success", reason=""))
    assert part(tmp_path, 2).read_bytes() == b"precious"
    assert run[ROBOT].sequence.tolist() == list(range(N_RECORDS))
    assert run.totals[ROBOT].dropped == 0
    assert run.status.complete
    (said,) = set(run[LOG].text)
    assert said.startswith("The recording could not be split, so it goes on in ")
    assert "run.2.mcap exists already" in said
    assert set(writer.warnings) == {said}
    assert said in caplog.text


def test_a_name_that_is_free_again_is_used_one_size_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = 0
    create = Path.open

    def refuse_once(path: Path, mode: str = "r", *args: Any, **kwargs: Any) -> Any:
        nonlocal opened
        if path.name == "run.2.mcap.active" and mode == "xb":
            opened += 1
            if opened == 1:
                raise PermissionError(errno.EACCES, "Permission denied")
        return create(path, mode, *args, **kwargs)

    monkeypatch.setattr(Path, "open", refuse_once)
    run = open_run(write_split(tmp_path / "run.mcap", states_and_frames(), SPLIT_BYTES))
    assert opened == 2
    assert run.parts[0].bytes_total > 1.9 * SPLIT_BYTES
    assert len(run.parts) > 2
    assert run[ROBOT].sequence.tolist() == list(range(N_RECORDS))
    assert "Permission denied" in run[LOG].text[0]


@pytest.mark.parametrize(("name", "is_folder"), [("run.3.mcap.active", False), ("run.2.mcap", True)])
def test_a_run_is_refused_where_a_later_parts_name_is_taken(tmp_path: Path, name: str, is_folder: bool) -> None:
    taken = tmp_path / name
    taken.mkdir() if is_folder else taken.write_bytes(b"precious")
    with pytest.raises(RecordingExistsError, match=rf"{name} exists already") as caught:
        open_writer(tmp_path / "run.mcap", split_bytes=SPLIT_BYTES)
    assert "A later part of this run would have that name." in caught.value.hint
    assert list(tmp_path.iterdir()) == [taken]
    assert open_run(write_split(tmp_path / "run.mcap", [make_state(1)], 0)).status.complete


def test_a_part_whose_final_name_is_taken_meanwhile_is_complete_under_its_active_one(tmp_path: Path) -> None:
    writer = open_writer(tmp_path / "run.mcap", split_bytes=SPLIT_BYTES)
    (tmp_path / "run.mcap").write_bytes(b"precious")
    writer.put_all(states_and_frames())
    with pytest.raises(RecordingExistsError, match=r"complete in .*run\.mcap\.active"):
        writer.close(exit_status="success", reason="")
    assert (tmp_path / "run.mcap").read_bytes() == b"precious"
    run = open_run(tmp_path / "run.mcap.active")
    assert run.status.complete, run.status.lost
    assert run[ROBOT].sequence.tolist() == list(range(N_RECORDS))


@pytest.mark.parametrize("name", ["run.2.mcap", "run.mcap"], ids=["beginning the next", "ending the one before"])
def test_a_disk_that_is_full_at_a_parts_end_ends_the_recording_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    told: list[BenchError] = []
    failed = threading.Event()

    def on_failure(error: BenchError) -> None:
        told.append(error)
        failed.set()

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    writer = open_writer(tmp_path / "run.mcap", split_bytes=SPLIT_BYTES, on_failure=on_failure)
    if name == "run.mcap":
        monkeypatch.setattr("bench.recording.writing.part_writing.RunPart.finish", full)
    else:
        monkeypatch.setattr("bench.recording.writing.part_writing.RunPart.add_metadata", full)
    for record in states_and_frames():
        writer.put(record)
    assert failed.wait(PATIENCE_S)
    with pytest.raises(DiskFullError, match=rf"cannot take more of .*{name}"):
        writer.close(exit_status="success", reason="")
    assert told == [writer.failure]
    stats = writer.stats[ROBOT]
    run = open_run(tmp_path / "run.mcap.active")
    assert run[ROBOT].sequence.tolist()[: stats.written] == list(range(stats.written))
    assert stats.written > 0
    assert stats.received == stats.written + stats.dropped
    assert not run.status.complete


def test_a_run_that_never_began_leaves_none_of_its_parts(tmp_path: Path) -> None:
    writer = open_writer(tmp_path / "run.mcap", split_bytes=SPLIT_BYTES)
    for record in states_and_frames():
        writer.put(record)
    while writer.queue_length or len(writer.paths) < 3:
        threading.Event().wait(0.005)
    writer.discard()
    assert list(tmp_path.iterdir()) == []


class Snapshots:
    """Copies of a folder as a kill would leave it, before and after each step that its recorder takes on the disk."""

    def __init__(self, folder: Path, into: Path) -> None:
        self._folder, self._into = folder, into
        self.taken: list[Path] = []
        self._lock = threading.Lock()

    def around(self, step: Any) -> Any:
        def stepped(*arguments: Any, **named: Any) -> Any:
            self.take()
            result = step(*arguments, **named)
            self.take()
            return result

        return stepped

    def take(self) -> None:
        with self._lock:
            target = self._into / str(len(self.taken))
            target.mkdir()
            for path in self._folder.iterdir():
                shutil.copy(path, target)
            self.taken.append(target)


def test_a_kill_at_any_step_of_going_on_in_the_next_part_leaves_a_run_that_is_read_wholly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, copies = tmp_path / "run", tmp_path / "copies"
    folder.mkdir()
    copies.mkdir()
    writer = open_writer(folder / "run.mcap", split_bytes=SPLIT_BYTES)
    snapshots = Snapshots(folder, copies)
    for name in ("fdatasync", "fsync", "link", "unlink", "open"):
        monkeypatch.setattr(f"bench.recording.files.output.os.{name}", snapshots.around(getattr(os, name)))
    for record in states_and_frames(12):
        writer.put(record)
    while len(writer.paths) < 4 or writer.queue_length or writer._parts._ending is not None:
        threading.Event().wait(0.005)
    monkeypatch.undo()
    writer.close(exit_status="success", reason="")
    assert len(snapshots.taken) > 40
    most = 0
    for copy in snapshots.taken:
        files = {path.name for path in copy.iterdir()}
        run = open_run(copy / ("run.mcap" if "run.mcap" in files else "run.mcap.active"))
        states = run[ROBOT].sequence.tolist()
        assert states == list(range(len(states)))
        assert len(states) >= most, "what was there in an earlier moment is gone"
        assert run.status.lost == "what was received in about the last second before the recording broke off"
        most = len(states)
    assert most > 6


def test_parts_are_followed_while_they_are_written(tmp_path: Path) -> None:
    clock = ManualClock(T0_NS)
    writer = open_writer(tmp_path / "run.mcap", clock, split_bytes=SPLIT_BYTES)
    follower, seen = RunFollower(tmp_path / "run.mcap"), list[int]()
    for i in range(N_RECORDS):
        writer.put(make_state(i))
        writer.put(make_frame(i, n_points=2))
        if i % 5 == 0 and (added := follower.read()) is not None:
            seen += added[ROBOT].sequence.tolist()
    writer.close(exit_status="success", reason="")
    while not follower.is_finished:
        if (added := follower.read()) is not None:
            seen += added[ROBOT].sequence.tolist()
    assert seen == list(range(N_RECORDS))
    assert len(writer.paths) > 5
    recent = follower.recent()[ROBOT].sequence.tolist()
    assert recent == list(range(N_RECORDS))[-len(recent) :]
    assert len(recent) > 3


def test_the_newest_part_of_a_run_under_way_is_followed_from_there_on(split: Path) -> None:
    newest = part(split.parent, n_parts(split.parent))
    states = read_states(newest)
    newest.rename(newest.with_name(newest.name + ".active"))
    follower = RunFollower(newest.with_name(newest.name + ".active"))
    added = follower.read()
    assert added is not None
    assert added[ROBOT].sequence.tolist() == states
    assert follower.is_finished


def test_info_shows_each_part(split: Path, capsys: pytest.CaptureFixture[str]) -> None:
    info([split])
    out = capsys.readouterr().out
    assert f"in {n_parts(split.parent)} parts" in out
    shown = [line for line in out.splitlines() if line.startswith("  part ")]
    assert len(shown) == n_parts(split.parent)
    assert "run.2.mcap: " in shown[1]
    assert sum(int(line.split()[-2]) for line in shown) == sum(open_run(split).topics.values())
