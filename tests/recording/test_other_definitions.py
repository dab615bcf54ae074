"""Messages of definitions that this version never wrote are read as an independent decoder reads them."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory

from bench.recording import ROBOT, open_run
from bench.recording.cdr import encode
from bench.recording.schemas import parse_schema

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
