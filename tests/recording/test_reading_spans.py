"""A stretch of a run is read as the whole is, without the rest of the file."""

from __future__ import annotations

import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from recording_examples import T0_NS, make_frame, make_state, one_of_each, write_run

from bench.model import Record
from bench.recording import BODIES, POINTS, ROBOT, Columns, Run, open_run
from bench.recording.reading import batches

MS = 1_000_000
PER_POINT = ("points_m", "residual_m", "ids", "flags")


def copy_with_small_chunks(source: Path, path: Path, chunk_bytes: int = 1500) -> Path:
    with source.open("rb") as stream, path.open("wb") as target:
        reader = make_reader(stream)
        writer = Writer(target, chunk_size=chunk_bytes, compression=CompressionType.LZ4)
        writer.start()
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
            channel_id = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
            times = (message.log_time, message.data, message.publish_time, message.sequence)
            writer.add_message(channel_id, *times)
        writer.finish()
    return path


def open_in_small_chunks(folder: str | Path, records: list[Record]) -> Run:
    return open_run(copy_with_small_chunks(write_run(Path(folder) / "run.mcap", records), Path(folder) / "copy.mcap"))


def records_at(times_ms: list[int]) -> list[Record]:
    """Return a frame and a state for each time, whatever the order of the times."""
    found: list[Record] = []
    for i, time_ms in enumerate(times_ms):
        found += [
            make_frame(i, n_points=i % 4, n_bodies=i % 3, arrival_ns=T0_NS + time_ms * MS),
            make_state(i, arrival_ns=T0_NS + time_ms * MS + 7),
        ]
    return found


def assert_is_part(part: Columns, whole: Columns, start_ns: int, end_ns: int) -> None:
    kept = (whole.log_time_ns >= start_ns) & (whole.log_time_ns < end_ns)
    for name, array in whole.items():
        if name in PER_POINT and "points_m" in whole:
            expected = array[np.repeat(kept, np.diff(whole.offsets))]
        elif name in ("offsets", "frame_index"):
            continue
        else:
            expected = array[kept]
        assert part[name].dtype == array.dtype
        np.testing.assert_array_equal(part[name], expected, err_msg=name)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, 60), max_size=40), st.integers(-5, 65), st.integers(-5, 65))
def test_any_stretch_is_what_the_whole_has_of_it(times_ms: list[int], first_ms: int, last_ms: int) -> None:
    start_ns, end_ns = T0_NS + first_ms * MS, T0_NS + last_ms * MS
    with tempfile.TemporaryDirectory() as folder:
        run = open_in_small_chunks(folder, records_at(times_ms))
        part = run.read([POINTS, ROBOT, BODIES], start_ns, end_ns)
        for topic in (POINTS, ROBOT, BODIES):
            assert_is_part(part[topic], run[topic], start_ns, end_ns)
    assert len(part[POINTS].offsets) == len(part[POINTS].sequence) + 1
    assert part[POINTS].offsets[-1] == len(part[POINTS].ids)
    assert part[BODIES].offsets[-1] == len(part[BODIES].body_id)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, 60), max_size=40), st.sampled_from([1, 4000, 1 << 20]))
def test_the_parts_of_a_stream_are_the_whole(times_ms: list[int], part_bytes: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        run = open_in_small_chunks(folder, records_at(times_ms))
        parts = list(run.stream([POINTS, ROBOT], part_bytes))
        frames, states = run[POINTS], run[ROBOT]
    for topic, whole in ((POINTS, frames), (ROBOT, states)):
        found = np.concatenate([part[topic].sequence for part in parts])
        assert sorted(found.tolist()) == sorted(whole.sequence.tolist())
        for earlier, later in pairwise(parts):
            assert earlier[topic].log_time_ns.max(initial=0) <= later[topic].log_time_ns.min(initial=2**62)
    assert sum(len(part[POINTS].ids) for part in parts) == len(frames.ids)


def test_a_stretch_is_read_without_the_other_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = open_in_small_chunks(tmp_path, records_at(list(range(60))))
    n_read = 0

    original = batches.read_chunk

    def counting(*arguments: object) -> bytes:
        nonlocal n_read
        n_read += 1
        return original(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(batches, "read_chunk", counting)
    run.read([ROBOT], T0_NS + 10 * MS, T0_NS + 11 * MS)
    one_stretch, n_read = n_read, 0
    run.load([ROBOT])
    assert 0 < one_stretch <= 3 < 10 < n_read


def test_a_stretch_of_texts_and_of_nothing(tmp_path: Path) -> None:
    run = open_run(write_run(tmp_path / "run.mcap", one_of_each()))
    assert run.read(["/log"], T0_NS, T0_NS + 10)["/log"].text.tolist() == ["link lost"]
    nothing = run.read(["/log", POINTS], 0, 0)
    assert nothing["/log"].text.tolist() == []
    assert nothing[POINTS].points_m.shape == (0, 3)
    assert nothing[POINTS].offsets.tolist() == [0]
