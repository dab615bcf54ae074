"""The readers of others read every topic as bench does, bit for bit, of a finished file and of a salvaged one."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, ChunkIndex, Message, Schema
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from recording_examples import T0_NS, make_frame, make_state, one_of_each, write_run
from rosbags.highlevel import AnyReader

from bench.model import Record
from bench.recording import (
    BODIES,
    CLOCK,
    CYCLE,
    FRAME,
    LOG,
    POINTS,
    ROBOT,
    STATE,
    STATS,
    Columns,
    open_run,
    salvage_copy,
    salvage_in_place,
)

JAVASCRIPT = Path(__file__).parent / "javascript"
EVERY_TOPIC = {ROBOT, POINTS, FRAME, BODIES, CYCLE, CLOCK, STATE, LOG, STATS}
N_RECORDS = 50


def read_with_mcap(path: Path) -> dict[str, list[Any]]:
    """Read every message with MCAP's own library and its decoder of ROS 2 messages."""
    theirs: dict[str, list[Any]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            theirs.setdefault(channel.topic, []).append((message, decoded))
    return theirs


def read_with_rosbags(path: Path) -> dict[str, list[Any]]:
    """Read every message with rosbags: by log time, and without the sequence numbers, which it does not give."""
    theirs: dict[str, list[Any]] = {}
    with AnyReader([path]) as reader:
        for connection, log_time_ns, payload in reader.messages():
            decoded = reader.deserialize(payload, connection.msgtype)
            theirs.setdefault(connection.topic, []).append((SimpleNamespace(log_time=log_time_ns), decoded))
    return theirs


def read_with_javascript(path: Path, *how: str) -> dict[str, list[Any]]:
    """Read every message with the libraries of Foxglove and Lichtblick."""
    if shutil.which("node") is None or not (JAVASCRIPT / "node_modules").is_dir():
        pytest.skip(f"needs Node.js, and once: npm ci --prefix {JAVASCRIPT}")
    done = subprocess.run(["node", JAVASCRIPT / "read.mjs", path, *how], capture_output=True, text=True, check=True)
    theirs: dict[str, list[Any]] = {}
    for line in done.stdout.splitlines():
        topic, log_time, publish_time, sequence, decoded = json.loads(line, object_hook=_from_json)
        message = SimpleNamespace(log_time=log_time, publish_time=publish_time, sequence=sequence)
        theirs.setdefault(topic, []).append((message, decoded))
    return theirs


def _from_json(values: dict[str, Any]) -> Any:
    match values:
        case {"$int": digits}:
            return int(digits)
        case {"$float": word}:
            return float(word)
    return SimpleNamespace(**values)


@pytest.fixture
def whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a finished file of several chunks."""
    monkeypatch.setattr("bench.recording.writing.writer.CHUNK_BYTES", 3000)
    some: list[Record] = one_of_each()[:-1]  # the recorder's own statistics come at the end
    some += [make_frame(i, n_points=i % 5, n_bodies=i % 3) for i in range(2, 2 + N_RECORDS)]
    some += [make_state(i, speed_scaling=float("nan")) for i in range(2, 2 + N_RECORDS)]
    return write_run(tmp_path / "run.mcap", some)


def finished(whole: Path) -> Path:
    return whole


def salvaged_where_it_lies(whole: Path) -> Path:
    """Return a file that ended in its last chunk's index and was finished in place."""
    cut = whole.with_suffix(".mcap.active")
    last = _chunks_of(whole)[-1]
    cut.write_bytes(whole.read_bytes()[: last.chunk_start_offset + last.chunk_length + 30])
    whole.unlink()
    return salvage_in_place(cut).path


def salvaged_by_copying(whole: Path) -> Path:
    """Return the copy of a file without its end and with a flipped bit in a chunk, which is left out."""
    data = bytearray(whole.read_bytes())
    chunks = _chunks_of(whole)
    data[chunks[2].chunk_start_offset + 500] ^= 1
    bad = whole.with_name("bad.mcap")
    bad.write_bytes(data[: chunks[-1].chunk_start_offset + chunks[-1].chunk_length])
    salvaged = salvage_copy(bad, whole.with_name("good.mcap"))
    assert salvaged.lost
    return salvaged.path


def _chunks_of(path: Path) -> list[ChunkIndex]:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return summary.chunk_indexes


@pytest.mark.parametrize("prepare", [finished, salvaged_where_it_lies, salvaged_by_copying])
@pytest.mark.parametrize("read", [read_with_mcap, read_with_rosbags, read_with_javascript])
def test_an_independent_reader_agrees_on_every_topic(
    whole: Path, read: Callable[[Path], dict[str, list[Any]]], prepare: Callable[[Path], Path]
) -> None:
    path = prepare(whole)
    run = open_run(path)
    theirs = read(path)
    assert {topic: len(found) for topic, found in theirs.items()} == run.topics
    assert set(run.topics) == EVERY_TOPIC
    n_frames, n_states = run.topics[POINTS], run.topics[ROBOT]
    assert (n_frames == n_states == N_RECORDS + 1) == (prepare is not salvaged_by_copying)
    assert n_frames + n_states > 2 * N_RECORDS - 20
    for topic, found in theirs.items():
        _assert_agrees(run[topic], found, topic)


def read_up_to_the_end_with_javascript(path: Path) -> dict[str, list[Any]]:
    return read_with_javascript(path, "unfinished")


def read_up_to_the_end_with_mcap(path: Path) -> dict[str, list[Any]]:
    """Read the messages of the whole chunks with MCAP's own library, which raises where the file ends."""
    theirs: dict[str, list[Any]] = {}
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    factory = DecoderFactory()
    with path.open("rb") as stream, pytest.raises(EndOfFile):
        for record in StreamReader(stream, validate_crcs=True).records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                decode = factory.decoder_for(channel.message_encoding, schemas[channel.schema_id])
                assert decode is not None
                theirs.setdefault(channel.topic, []).append((record, decode(record.data)))
    return theirs


@pytest.mark.parametrize("read", [read_up_to_the_end_with_mcap, read_up_to_the_end_with_javascript])
def test_an_unfinished_file_is_read_as_the_libraries_read_it_up_to_its_end(
    whole: Path, read: Callable[[Path], dict[str, list[Any]]]
) -> None:
    last = _chunks_of(whole)[-1]
    whole.write_bytes(whole.read_bytes()[: last.chunk_start_offset + last.chunk_length - 7])
    run = open_run(whole)
    theirs = read(whole)
    assert {topic: len(found) for topic, found in theirs.items()} == run.topics
    assert "the end of the file" in run.status.text
    for topic, found in theirs.items():
        _assert_agrees(run[topic], found, topic)


def _assert_agrees(columns: Columns, found: list[Any], topic: str) -> None:
    assert columns.log_time_ns.tolist() == [message.log_time for message, _ in found]
    if hasattr(found[0][0], "sequence"):
        assert columns.publish_time_ns.tolist() == [message.publish_time for message, _ in found]
        assert (columns.sequence & 0xFFFFFFFF).tolist() == [message.sequence for message, _ in found]
    if topic == POINTS:
        _assert_same_points(columns, [decoded for _, decoded in found])
        return
    names = {"severity": "level", "text": "msg"} if topic == LOG else {}
    compared = 0
    for name, column in columns.items():
        field = names.get(name, name)
        if hasattr(found[0][1], field) and name != "sequence":
            theirs = np.array([getattr(decoded, field) for _, decoded in found], column.dtype)
            assert theirs.tobytes() == column.tobytes() or (theirs == column).all(), name
            compared += 1
    assert compared >= 3


def _assert_same_points(columns: Columns, clouds: list[Any]) -> None:
    assert [cloud.width for cloud in clouds] == np.diff(columns.offsets).tolist()
    assert {cloud.header.frame_id for cloud in clouds} == {"lab"}
    kinds = {6: "<u4", 7: "<f4"}
    dtype = np.dtype(
        {
            "names": [field.name for field in clouds[0].fields],
            "formats": [kinds[field.datatype] for field in clouds[0].fields],
            "offsets": [field.offset for field in clouds[0].fields],
            "itemsize": clouds[0].point_step,
        }
    )
    points = np.frombuffer(b"".join(bytes(cloud.data) for cloud in clouds), dtype)
    assert np.stack([points["x"], points["y"], points["z"]], axis=1).tobytes() == columns.points_m.tobytes()
    assert points["residual"].tobytes() == columns.residual_m.tobytes()
    assert points["id"].tobytes() == columns.ids.tobytes()
    assert points["flags"].tobytes() == columns.flags.tobytes()
    stamps = [cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec for cloud in clouds]
    assert stamps == columns.capture_ns.tolist()
    assert stamps[0] > T0_NS
