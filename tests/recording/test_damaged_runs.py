from __future__ import annotations

import json
import os
import struct
import tempfile
from pathlib import Path

import numpy as np
import pytest
from damaged_bytes import (
    draw_changes,
    draw_changes_and_a_cut,
    find_chunks,
    flip_a_bit,
    record_small_chunks,
    write_again,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from bench.errors import RecordingError, RecordingUnfinishedError
from bench.recording import FRAME, POINTS, ROBOT, STATS, Run, open_run
from bench.recording.messages.cdr import encode
from bench.recording.messages.schemas import load_schema, parse_schema
from bench.recording.messages.topics import TOPICS

PATIENCE_S = 30.0
CHUNK_HEAD = 9
N_FRAMES = 30


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return record_small_chunks(tmp_path_factory.mktemp("runs") / "run.mcap", N_FRAMES)


def _open_bytes(folder: Path, data: bytes) -> Run:
    path = folder / "changed.mcap"
    path.write_bytes(data)
    run = open_run(path)
    run.load(TOPICS)
    return run


def test_every_complete_chunk_before_a_cut_is_read(recording: bytes, tmp_path: Path) -> None:
    whole = _open_bytes(tmp_path, recording)
    chunks = find_chunks(recording)
    assert len(chunks) >= 8
    per_chunk = whole[ROBOT].sequence.tolist()
    seen = -1
    cuts = sorted({*range(0, len(recording), 101), *(e + d for _, e in chunks for d in (-1, 0, 1, 20))})
    for cut in cuts:
        try:
            run = _open_bytes(tmp_path, recording[:cut])
        except RecordingError:
            assert seen == -1, cut
            continue
        states = run[ROBOT].sequence.tolist()
        assert states == per_chunk[: len(states)]
        assert len(states) >= seen
        assert not run.status.complete
        assert run.status.lost
        n_chunks = sum(end <= cut for _, end in chunks)
        assert (len(states) > 0) == (n_chunks > 0)
        assert len(run[POINTS].offsets) == len(run[FRAME].frame_number) + 1
        seen = max(seen, len(states))
    assert seen == len(per_chunk)


def test_a_file_that_lost_its_summary_only_is_read_whole(recording: bytes, tmp_path: Path) -> None:
    run = _open_bytes(tmp_path, recording[:-9])
    assert run[ROBOT].sequence.tolist() == _open_bytes(tmp_path, recording)[ROBOT].sequence.tolist()
    assert run.exit_status == "success"
    assert not run.status.complete
    assert run.status.lost == "only the file's summary, every record is there"


def test_an_unfinished_run_knows_its_last_statistics(recording: bytes, tmp_path: Path) -> None:
    run = _open_bytes(tmp_path, recording[: find_chunks(recording)[-1][1]])
    assert run.exit_status == "unfinished"
    assert "unfinished: " in str(run.status)
    assert run.totals[ROBOT].written == run.topics[ROBOT]
    assert run.topics[STATS] > 0


@pytest.mark.parametrize("is_cut", [False, True])
def test_statistics_of_a_file_that_does_not_tell_what_was_enqueued_are_read(tmp_path: Path, is_cut: bool) -> None:
    path = tmp_path / "old.mcap"
    text = load_schema("bench_msgs/msg/RecorderStats").text
    older = "\n".join(line for line in text.splitlines() if " enqueued" not in line)
    numbers = {"received": 5, "written": 4, "dropped": 1, "missed": 2}
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.LZ4)
        writer.start()
        writer.add_metadata("bench.run", {"run_id": "old"})
        schema = writer.register_schema("bench_msgs/msg/RecorderStats", "ros2msg", older.encode())
        payload = encode(parse_schema("bench_msgs/msg/RecorderStats", older), {"topic": ROBOT, "host_ns": 9, **numbers})
        writer.add_message(writer.register_channel(STATS, "cdr", schema), 7, payload, 6, 9)
        if not is_cut:
            writer.add_metadata("bench.end", {"totals": json.dumps({ROBOT: numbers})})
        writer.finish()
    total = open_run(path).totals[ROBOT]
    assert (total.received, total.written, total.dropped, total.missed) == (5, 4, 1, 2)
    assert total.enqueued == -1


def test_a_flipped_bit_costs_its_chunk_and_is_told(recording: bytes, tmp_path: Path) -> None:
    whole = _open_bytes(tmp_path, recording)[ROBOT].sequence.tolist()
    for start, end in find_chunks(recording):
        run = _open_bytes(tmp_path, flip_a_bit(recording, (start, end)))
        left = run[ROBOT].sequence.tolist()
        assert 0 < len(left) <= len(whole)
        assert set(left) <= set(whole)
        assert not run.status.complete
        assert f"chunk at byte {start + CHUNK_HEAD}" in run.status.lost
        assert str(run.status).startswith("damaged: ")
        assert sum(run.topics.values()) < sum(_open_bytes(tmp_path, recording).topics.values())


def test_a_damaged_message_index_costs_nothing(recording: bytes, tmp_path: Path) -> None:
    whole = _open_bytes(tmp_path, recording)
    for _, end in find_chunks(recording):
        (length,) = struct.unpack_from("<Q", recording, end + 1)
        for at in (end + 9 + 2, end + 9 + 6 + 8, end + 9 + 6 + 15, end + 9 + length - 2):
            damaged = bytearray(recording)
            damaged[at] ^= 0x41
            run = _open_bytes(tmp_path, bytes(damaged))
            assert run[ROBOT].q_rad.tobytes() == whole[ROBOT].q_rad.tobytes()
            assert run[POINTS].points_m.tobytes() == whole[POINTS].points_m.tobytes()


def test_losing_the_first_chunk_of_an_unfinished_file_does_not_make_the_others_unreadable(
    recording: bytes, tmp_path: Path
) -> None:
    chunks = find_chunks(recording)
    run = _open_bytes(tmp_path, flip_a_bit(recording[: chunks[-1][1]], chunks[0]))
    whole = _open_bytes(tmp_path, recording)[ROBOT].sequence.tolist()
    left = run[ROBOT].sequence.tolist()
    assert left == whole[len(whole) - len(left) :]
    assert len(left) > len(whole) // 2


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_whatever_bytes_are_changed_only_our_own_errors_come(recording: bytes, data: st.DataObject) -> None:
    changed = draw_changes_and_a_cut(data, recording)
    with tempfile.TemporaryDirectory() as folder:
        try:
            run = _open_bytes(Path(folder), changed)
        except RecordingError:
            return
        assert len(run[ROBOT].q_rad) <= N_FRAMES + 1
        assert str(run.status)


@pytest.fixture(scope="module")
def unprotected(recording: bytes, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return a copy without compression and checksums: whatever is changed in it reaches the decoders."""
    path = tmp_path_factory.mktemp("runs") / "copy.mcap"
    return _rewrite(recording, path, CompressionType.NONE, enable_crcs=False).read_bytes()


@settings(max_examples=120, deadline=None)
@given(data=st.data())
def test_whatever_reaches_the_decoders_only_our_own_errors_come(unprotected: bytes, data: st.DataObject) -> None:
    changed = draw_changes(data, unprotected, 6, b"\0" * 4, b"[")
    with tempfile.TemporaryDirectory() as folder:
        try:
            run = _open_bytes(Path(folder), bytes(changed))
        except RecordingError:
            return
        assert len(run[ROBOT].q_rad) <= N_FRAMES + 1


def test_zeros_at_the_end_as_a_power_cut_leaves_them_are_no_records(recording: bytes, tmp_path: Path) -> None:
    chunks = find_chunks(recording)
    run = _open_bytes(tmp_path, recording[: chunks[3][1]] + bytes(8192))
    assert "no record begins" in str(run.status)
    assert len(run[ROBOT].sequence) > 0


def test_a_lying_length_is_damage_and_not_memory(recording: bytes, tmp_path: Path) -> None:
    start, end = find_chunks(recording)[2]
    for offset, lie in ((1, 2**63), (1, 2**40), (9 + 16, 2**62), (9 + 16, 2**31)):
        damaged = bytearray(recording)
        struct.pack_into("<Q", damaged, start + offset, lie)
        run = _open_bytes(tmp_path, bytes(damaged))
        assert not run.status.complete
        assert 0 < len(run[ROBOT].sequence) < N_FRAMES + 1
    assert end > start


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"", "is empty"),
        (b"PK\x03\x04 a zip file", "is not an MCAP file"),
        (os.urandom(5000), "is not an MCAP file"),
        (b"\x89MCAP0\r\n", "holds nothing that can be read"),
    ],
)
def test_a_file_that_is_no_recording_is_one_sentence(tmp_path: Path, data: bytes, sentence: str) -> None:
    with pytest.raises(RecordingError, match=sentence):
        _open_bytes(tmp_path, data)


def test_a_file_that_is_not_there_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"cannot be opened: No such file or directory\.$"):
        open_run(tmp_path / "run.mcap")
    with pytest.raises(RecordingError, match="cannot be read: Is a directory"):
        open_run(tmp_path)
    (tmp_path / "run.mcap.active").write_bytes(b"")
    with pytest.raises(RecordingError, match=r"run\.mcap\.active can be read in its place"):
        open_run(tmp_path / "run.mcap")
    with pytest.raises(RecordingUnfinishedError):
        open_run(tmp_path / "run.mcap.active")


def test_another_programs_mcap_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/imu", "json", writer.register_schema("Imu", "jsonschema", b"{}"))
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(RecordingError, match="not a recording of bench"):
        open_run(path)


def _rewrite(recording: bytes, path: Path, compression: CompressionType, **options: object) -> Path:
    source = path.with_suffix(".source")
    source.write_bytes(recording)
    return write_again(source, path, chunk_size=4000, compression=compression, **options)


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.NONE])
def test_a_copy_with_other_chunks_reads_the_same(
    recording: bytes, tmp_path: Path, compression: CompressionType, index: IndexType
) -> None:
    original = _open_bytes(tmp_path, recording)
    copy = open_run(_rewrite(recording, tmp_path / "copy.mcap", compression, index_types=index))
    assert copy.topics == original.topics
    for topic in TOPICS:
        for name, column in original[topic].items():
            np.testing.assert_array_equal(copy[topic][name], column, err_msg=name)
    assert copy.status.complete


def test_an_unknown_topic_is_refused_with_the_known_ones(recording: bytes, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="'/nonsense' is no topic of a run file; there are: /robot/state"):
        _open_bytes(tmp_path, recording)["/nonsense"]


def test_points_without_their_frames_are_refused(recording: bytes, tmp_path: Path) -> None:
    source, path = tmp_path / "source.mcap", tmp_path / "copy.mcap"
    source.write_bytes(recording)
    with source.open("rb") as stream, path.open("wb") as target:
        reader = make_reader(stream)
        writer = Writer(target)
        writer.start()
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        for schema, channel, message in reader.iter_messages(topics=[POINTS], log_time_order=False):
            assert schema is not None
            schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
            writer.add_message(writer.register_channel(channel.topic, "cdr", schema_id), 1, message.data, 1)
        writer.finish()
    with pytest.raises(RecordingError):
        open_run(path)[POINTS]


def test_an_older_definition_is_read_by_its_own_layout(tmp_path: Path) -> None:
    path = tmp_path / "old.mcap"
    text = b"int64 arrival_ns\nfloat64[6] q_rad\nint32 cycle_count\n"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.LZ4)
        writer.start()
        writer.add_metadata("bench.run", {"run_id": "old"})
        schema = writer.register_schema("bench_msgs/msg/RobotState", "ros2msg", text)
        channel = writer.register_channel(ROBOT, "cdr", schema)
        payload = b"\0\1\0\0" + struct.pack("<q6di", 5, *range(6), 3)
        writer.add_message(channel, 7, payload, 6, 9)
        writer.finish()
    columns = open_run(path)[ROBOT]
    assert columns.q_rad.tolist() == [[0, 1, 2, 3, 4, 5]]
    assert (columns.cycle_count.tolist(), columns.sequence.tolist()) == ([3], [9])
    assert "tcp_pose" not in columns
