"""Messages of definitions that this version never wrote are read as an independent decoder reads them."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory
from recording_examples import make_frame

from bench.recording import FRAME, POINTS, ROBOT, Run, open_run
from bench.recording.messages.cdr import encode
from bench.recording.messages.pointcloud import encode_cloud
from bench.recording.messages.schemas import load_schema, parse_schema
from bench.recording.messages.topics import TOPICS

ROBOT_STATE = "bench_msgs/msg/RobotState"
NUMBERS = {
    "bool": st.booleans(),
    "int8": st.integers(-(2**7), 2**7 - 1),
    "uint8": st.integers(0, 2**8 - 1),
    "uint16": st.integers(0, 2**16 - 1),
    "int32": st.integers(-(2**31), 2**31 - 1),
    "uint64": st.integers(0, 2**64 - 1),
    "float32": st.floats(width=32, allow_nan=False),
    "float64": st.floats(allow_nan=False),
}
TEXT = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=9)


@st.composite
def fields(draw: st.DrawFn) -> list[tuple[str, int | None]]:
    """Types with their array lengths, None for a single value; texts may stand anywhere."""
    kinds = st.sampled_from([*NUMBERS, "string"] if draw(st.booleans()) else [*NUMBERS])
    lengths = st.one_of(st.none(), st.integers(1, 4))
    found = draw(st.lists(st.tuples(kinds, lengths), min_size=1, max_size=7))
    return [(kind, None if kind == "string" else length) for kind, length in found]


def draw_values(data: st.DataObject, kinds: list[tuple[str, int | None]]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for i, (kind, length) in enumerate(kinds):
        one = TEXT if kind == "string" else NUMBERS[kind]
        values[f"f{i}"] = data.draw(one if length is None else st.lists(one, min_size=length, max_size=length))
    return values


def write_messages(path: Path, name: str, text: str, payloads: list[bytes], topic: str = ROBOT) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.LZ4, chunk_size=200)
        writer.start()
        writer.add_metadata("bench.run", {"run_id": "another version's"})
        channel = writer.register_channel(topic, "cdr", writer.register_schema(name, "ros2msg", text.encode()))
        for i, payload in enumerate(payloads):
            writer.add_message(channel, i, payload, i, i)
        writer.finish()


@settings(max_examples=40, deadline=None)
@given(fields(), st.data())
def test_any_definition_is_read_as_an_independent_decoder_does(
    kinds: list[tuple[str, int | None]], data: st.DataObject
) -> None:
    text = "".join(f"{kind}{'' if n is None else f'[{n}]'} f{i}\n" for i, (kind, n) in enumerate(kinds))
    schema = parse_schema(ROBOT_STATE, text)
    payloads = [encode(schema, draw_values(data, kinds)) for _ in range(data.draw(st.integers(1, 6)))]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        write_messages(path, ROBOT_STATE, text, payloads)
        columns = open_run(path)[ROBOT]
        with path.open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            decoded = [message for *_, message in reader.iter_decoded_messages()]
    assert columns.sequence.tolist() == list(range(len(payloads)))
    for i, (kind, length) in enumerate(kinds):
        theirs = [getattr(message, f"f{i}") for message in decoded]
        expected = theirs if length is None else [list(one) for one in theirs]
        assert columns[f"f{i}"].tolist() == expected, f"{kind} {length}"


OTHER_POINT = np.dtype(
    [("id", "<u4"), ("intensity", "<f4"), ("z", "<f8"), ("pad", "V3"), ("x", "<f4"), ("y", "<f4"), ("tail", "<u2")]
)
"""Other fields in another order, one with more bits, none where a number of its kind should stand."""


def encode_other_cloud(x_m: list[float], frame_id: str, **changes: Any) -> bytes:
    data = np.zeros(len(x_m), OTHER_POINT)
    data["x"], data["y"], data["z"], data["id"] = x_m, 2.0, 3.0, 7
    kinds = {"<u4": 6, "<f4": 7, "<f8": 8, "<u2": 4}
    fields = [
        {"name": name, "offset": OTHER_POINT.fields[name][1], "datatype": kinds[OTHER_POINT[name].str], "count": 1}  # type: ignore[index]
        for name in ("id", "intensity", "z", "x", "y", "tail")
    ]
    values = {
        "header": {"frame_id": frame_id},
        "height": 1,
        "width": len(data),
        "fields": fields,
        "point_step": OTHER_POINT.itemsize,
        "row_step": data.nbytes,
        "data": data.tobytes(),
    }
    return encode(load_schema(TOPICS[POINTS].schema), values | changes)


def write_frames(
    path: Path, clouds: list[bytes], n_points: list[int], first: str = POINTS, in_chunks: bool = False
) -> Run:
    """Write frames of `n_points` with point clouds of our own choice; `first` is the topic that is defined first."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.LZ4)
        writer.start()
        writer.add_metadata("bench.run", {"run_id": "another version's"})
        channels = {}
        for topic in sorted((POINTS, FRAME), key=first.__ne__):
            schema = load_schema(TOPICS[topic].schema)
            schema_id = writer.register_schema(schema.name, "ros2msg", schema.text.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema_id)
        for i, (cloud, n) in enumerate(zip(clouds, n_points, strict=True)):
            frame = encode(load_schema(TOPICS[FRAME].schema), {"frame_number": i, "n_points": n})
            writer.add_message(channels[POINTS], i, cloud, i, i)
            writer.add_message(channels[FRAME], i, frame, i, i)
            if in_chunks:
                writer.flush()
        writer.finish()
    return open_run(path)


def test_points_with_other_fields_are_read_one_by_one(tmp_path: Path) -> None:
    own = make_frame(1, n_points=2)
    clouds = [encode_cloud(own), encode_other_cloud([1.5], "lab"), encode_other_cloud([], "a longer name of a frame")]
    for order in ([0, 1, 2], [2, 1, 0], [1, 0, 2]):
        counts = [[2, 1, 0][i] for i in order]
        run = write_frames(tmp_path / f"{order}.mcap", [clouds[i] for i in order], counts)
        points = run[POINTS]
        assert np.diff(points.offsets).tolist() == counts
        where = int(points.offsets[order.index(1)])
        assert points.points_m[where].tolist() == [1.5, 2.0, 3.0]
        assert np.isnan(points.residual_m[where])
        assert (points.ids[where], points.flags[where]) == (7, 0)
        first = int(points.offsets[order.index(0)])
        assert points.points_m[first : first + 2].tobytes() == own.points_m.tobytes()
        assert run.status.lost == ""


@pytest.mark.parametrize(
    "wrong",
    [{"width": 2}, {"point_step": 0}, {"point_step": 1 << 31}, {"fields": []}, {"data": b"abc"}, {"height": 0}],
    ids=str,
)
def test_points_that_contradict_themselves_are_damage(tmp_path: Path, wrong: dict[str, Any]) -> None:
    run = write_frames(tmp_path / "run.mcap", [encode_other_cloud([1.0], "lab", **wrong)], [1])
    assert len(run[POINTS].ids) == 0
    assert "1 of /tracker/points, 1 of /tracker/frame" in run.status.lost


@pytest.mark.parametrize("first", [POINTS, FRAME])
@pytest.mark.parametrize("bad", [0, 1, 2])
def test_a_chunk_that_cannot_be_read_costs_no_other_and_is_left_out_of_every_topic(
    tmp_path: Path, bad: int, first: str
) -> None:
    clouds = [encode_cloud(make_frame(i, n_points=i + 1)) for i in range(3)]
    clouds[bad] = encode_other_cloud([1.0], "lab", width=5)
    run = write_frames(tmp_path / "run.mcap", clouds, [1, 2, 3], first, in_chunks=True)
    assert len(run.topics) == 2
    left = [i for i in range(3) if i != bad]
    assert run[POINTS].frame_number.tolist() == left
    assert np.diff(run[POINTS].offsets).tolist() == [i + 1 for i in left]
    assert run[POINTS].points_m.tobytes() == b"".join(make_frame(i, n_points=i + 1).points_m.tobytes() for i in left)
    assert run.status.lost.count("1 of /tracker/points") == 1
