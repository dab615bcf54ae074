"""Chosen topics of a run file, in one pass over its chunks, put together to columns."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.errors import RecordingError
from bench.recording.container.chunks import read_chunk, read_offsets
from bench.recording.container.contents import Channel, Chunk, Container, DamagedError, describe_chunk
from bench.recording.files.run_files import RunFiles, opened
from bench.recording.messages.cdr import CdrError
from bench.recording.messages.schemas import Schema, load_schema, parse_schema
from bench.recording.messages.topics import BODIES, FRAME, LOG, POINTS, TOPICS, Message
from bench.recording.reading.batches import Batch, find_messages, group_chunks, unpack_batch
from bench.recording.reading.collecting import Collector, make_collector
from bench.recording.reading.columns import HEAD_COLUMNS, Array, Columns
from bench.recording.reading.gathering import read_message
from bench.recording.reading.in_turn import work_in_turn

__all__ = ["Span", "read_messages", "read_topics", "split_spans"]

_log = logging.getLogger(__name__)


class Span(NamedTuple):
    """A stretch of arrival times."""

    start_ns: int = 0
    end_ns: int = 1 << 63
    """The first moment that is not in it."""

    def touches(self, chunk: Chunk) -> bool:
        return chunk.start_ns < self.end_ns and self.start_ns <= chunk.end_ns


_ALWAYS = Span()


def split_spans(container: Container, unpacked_bytes: int) -> Iterator[Span]:
    """Yield spans that together hold everything, each of about so many bytes and never less than a chunk."""
    start_ns, size = _ALWAYS.start_ns, 0
    for chunk in sorted(container.chunks, key=lambda chunk: chunk.start_ns):
        if size >= unpacked_bytes and chunk.start_ns > start_ns:
            yield Span(start_ns, chunk.start_ns)
            start_ns, size = chunk.start_ns, 0
        size += chunk.unpacked_size
    yield Span(start_ns)


def read_topics(
    paths: Sequence[Path],
    container: Container,
    topics: Iterable[str],
    frames: Columns | None = None,
    span: Span = _ALWAYS,
) -> dict[str, Columns]:
    """Read all of `topics` in one pass; `frames` are those of /tracker/frame if they are not among them.

    Of the file only the chunks that touch `span` are read, and of their messages those that arrived in it are kept.

    A damaged chunk is taken out of `container.chunks` and noted in `container.damage`.

    Raises
    ------
    RecordingError
        A topic is none of bench's, or its messages are not what this version can read.
    """
    path = paths[0]
    try:
        collectors = {topic: _make_collector(path, container, topic, span) for topic in topics}
        with opened(*paths) as files:
            _collect(files, container, collectors, span)
        arrays = {topic: _trim(topic, collector.columns(), span) for topic, collector in collectors.items()}
    except (CdrError, MemoryError) as error:
        raise RecordingError(f"{path} cannot be read: {error}.") from error
    return _put_together(path, arrays, frames)


def _make_collector(path: Path, container: Container, topic: str, span: Span) -> Collector:
    if topic not in TOPICS:
        raise RecordingError(f"'{topic}' is no topic of a run file; there are: {', '.join(TOPICS)}.")
    channels = [channel for channel in container.channels.values() if channel.topic == topic]
    schemas = {_read_schema(path, channel).text: _read_schema(path, channel) for channel in channels}
    if len(schemas) > 1:
        raise RecordingError(f"{path} holds {topic} in {len(schemas)} different definitions.")
    schema = next(iter(schemas.values()), load_schema(TOPICS[topic].schema))
    ids = {channel.id for channel in channels}
    touched = [chunk for chunk in container.chunks if span.touches(chunk)]
    return make_collector(schema, sum(chunk.counts.get(key, 0) for chunk in touched for key in ids))


def _read_schema(path: Path, channel: Channel) -> Schema:
    """Return the definition that stands in the file: an older or newer one is read by its own layout."""
    own = TOPICS[channel.topic].schema
    if not channel.schema_name:
        return load_schema(own)
    found = (channel.encoding, channel.schema_encoding, channel.schema_name)
    if found != ("cdr", "ros2msg", own):
        raise RecordingError(f"{path} holds {channel.topic} as {' '.join(found)} instead of cdr ros2msg {own}.")
    return parse_schema(own, channel.schema_text)


def _collect(files: RunFiles, container: Container, collectors: Mapping[str, Collector], span: Span) -> None:
    wanted = {key: collectors[c.topic] for key, c in container.channels.items() if c.topic in collectors}
    chunks = [chunk for chunk in container.chunks if span.touches(chunk) and not wanted.keys().isdisjoint(chunk.counts)]
    batches = work_in_turn(
        group_chunks(chunks),
        lambda group: unpack_batch(files, group),
        lambda batch: _take(files, batch, wanted),
    )
    for left in batches:
        for chunk, error in left:
            _leave_out(container, chunk, error)


def _take(files: RunFiles, batch: Batch, wanted: Mapping[int, Collector]) -> list[tuple[Chunk, DamagedError]]:
    """Take a batch apart, all of it or nothing; of one that fails each chunk alone. Return the chunks left out."""
    marks = [(collector, collector.mark()) for collector in wanted.values()]
    try:
        for channel, offsets in find_messages(files, batch, wanted).items():
            if len(offsets):
                wanted[channel].take(batch.data, offsets)
    except DamagedError as error:
        for collector, mark in marks:
            collector.return_to(mark)
        if len(batch.chunks) == 1:
            return [*batch.damaged, (batch.chunks[0], error)]
        return [*batch.damaged, *(left for part in batch.split() for left in _take(files, part, wanted))]
    return [*batch.damaged]


def _leave_out(container: Container, chunk: Chunk, error: DamagedError) -> None:
    container.chunks.remove(chunk)
    damage = f"{describe_chunk(chunk, container)}: {error}"
    container.note_damage(chunk.offset, damage)
    _log.warning("damaged: %s", damage)


def _trim(topic: str, arrays: dict[str, Array], span: Span) -> dict[str, Array]:
    if span == _ALWAYS:
        return arrays
    times_ns = arrays["log_time_ns"]
    kept = (times_ns >= span.start_ns) & (times_ns < span.end_ns)
    if topic != POINTS:
        return {name: array[kept] for name, array in arrays.items()}
    n_points = np.diff(arrays["offsets"])
    kept_points = np.repeat(kept, n_points)
    trimmed = {
        name: array[kept if name in HEAD_COLUMNS else kept_points]
        for name, array in arrays.items()
        if name != "offsets"
    }
    return trimmed | {"offsets": np.concatenate([[0], np.cumsum(n_points[kept])])}


def read_messages(paths: Sequence[Path], container: Container, topics: Iterable[str]) -> list[Message]:
    """Read the messages of `topics` as they stand in the file, and in its order; damaged chunks are left out."""
    names = {key: channel.topic for key, channel in container.channels.items() if channel.topic in set(topics)}
    messages: list[Message] = []
    with opened(*paths) as files:
        for chunk in container.chunks:
            try:
                messages.extend(_messages_of(files, chunk, names))
            except DamagedError as error:
                _log.warning("damaged chunk at byte %d: %s", chunk.offset, error)
    return messages


def _messages_of(files: RunFiles, chunk: Chunk, names: Mapping[int, str]) -> list[Message]:
    data = read_chunk(files, chunk)
    channels = read_offsets(files, chunk, data, names).items()
    places = sorted((offset, names[key]) for key, offsets in channels for offset in offsets.tolist())
    return [Message(topic, *read_message(data, offset)) for offset, topic in places]


def _put_together(path: Path, arrays: dict[str, dict[str, Array]], frames: Columns | None) -> dict[str, Columns]:
    columns = {topic: Columns(_rename(topic, found)) for topic, found in arrays.items()}
    frames = columns.get(FRAME, frames)
    if frames is not None and POINTS in columns:
        columns[POINTS] = Columns({**frames, **_verify_points(path, columns[POINTS], frames)})
    if frames is not None and BODIES in columns:
        columns[BODIES] = Columns({**columns[BODIES], **_assign_bodies(path, columns[BODIES], frames)})
    return columns


def _rename(topic: str, arrays: dict[str, Array]) -> dict[str, Array]:
    names = TOPICS[topic].columns
    renamed = {names.get(name, name): array for name, array in arrays.items()}
    if topic == LOG:
        renamed["host_ns"] = renamed["log_time_ns"]
    return renamed


def _verify_points(path: Path, points: Columns, frames: Columns) -> Columns:
    """Points and description of a frame are written together; check that they still belong together."""
    _verify_columns(path, frames, "n_points")
    same = len(points.sequence) == len(frames.sequence) and all(
        np.array_equal(points[name], frames[name]) for name in ("sequence", "log_time_ns")
    )
    if not same or not np.array_equal(np.diff(points.offsets), frames.n_points):
        raise RecordingError(f"{path}: {POINTS} and {FRAME} do not belong together; another program has changed it.")
    return points


def _assign_bodies(path: Path, bodies: Columns, frames: Columns) -> dict[str, Array]:
    """Return which bodies belong to which frame, both ways."""
    _verify_columns(path, frames, "n_bodies")
    offsets = np.zeros(len(frames.n_bodies) + 1, np.int64)
    np.cumsum(frames.n_bodies, out=offsets[1:])
    if offsets[-1] != len(bodies.sequence):
        raise RecordingError(f"{path}: {BODIES} and {FRAME} do not belong together; another program has changed it.")
    return {"offsets": offsets, "frame_index": np.repeat(np.arange(len(frames.n_bodies)), frames.n_bodies)}


def _verify_columns(path: Path, frames: Columns, name: str) -> None:
    if name not in frames or frames[name].dtype.kind != "u" or frames[name].ndim != 1:
        raise RecordingError(f"{path}: {FRAME} does not say {name} of each frame, so its points cannot be told apart.")
