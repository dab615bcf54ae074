"""A recording of many small chunks, and what can become of its bytes."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from recording_examples import make_frame, make_state, one_of_each, write_run

CHUNK = 6
"""MCAP's number for this kind of record."""


def record_small_chunks(path: Path, n_frames: int) -> bytes:
    """Return a finished file of many small chunks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.recording.writing.writer.CHUNK_BYTES", 3000)
        some = [r for i in range(n_frames) for r in (make_state(i), make_frame(i, n_points=i % 5, n_bodies=i % 3))]
        return write_run(path, [*some, *one_of_each()]).read_bytes()


def find_records(data: bytes) -> list[tuple[int, int, int]]:
    """Return opcode, start and end of every record, by an own walk."""
    found, offset = [], 8
    while offset + 9 <= len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, offset)
        found.append((opcode, offset, offset + 9 + length))
        offset += 9 + length
    return found


def find_chunks(data: bytes) -> list[tuple[int, int]]:
    return [(start, end) for opcode, start, end in find_records(data) if opcode == CHUNK]


def flip_a_bit(data: bytes, span: tuple[int, int]) -> bytes:
    """Change one bit in the middle of a chunk."""
    damaged = bytearray(data)
    damaged[sum(span) // 2] ^= 0x10
    return bytes(damaged)


def draw_changes(data: st.DataObject, recording: bytes, most: int, *more: bytes) -> bytearray:
    """Write over the recording at some places: ones, zeros, opcodes, or `more`."""
    changed = bytearray(recording)
    values = [b"\xff" * 8, b"\0" * 8, b"\x01", b"\x06", b"\xff\xff\xff\x7f", b"\x80", *more]
    for _ in range(data.draw(st.integers(1, most))):
        at = data.draw(st.integers(0, len(changed) - 9))
        new = data.draw(st.sampled_from(values))
        changed[at : at + len(new)] = new
    return changed


def draw_changes_and_a_cut(data: st.DataObject, recording: bytes) -> bytes:
    changed = draw_changes(data, recording, 4)
    if data.draw(st.booleans()):
        del changed[data.draw(st.integers(0, len(changed))) :]
    return bytes(changed)


def write_again(source: Path, target: Path, **options: object) -> Path:
    """Copy a recording with the settings of another program's writer, as ``mcap compress`` or ``mcap filter`` do."""
    with source.open("rb") as stream, target.open("wb") as copy:
        reader = make_reader(stream)
        writer = Writer(copy, **options)  # type: ignore[arg-type]
        writer.start()
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        channels: dict[str, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if channel.topic not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "cdr", schema_id)
            number = channels[channel.topic]
            writer.add_message(number, message.log_time, message.data, message.publish_time, message.sequence)
        writer.finish()
    return target
