"""What stands where in an MCAP file, finished or not.

The file's own summary is not needed for that, so a file that lost its end is read in the same way as one that has
it. Nothing is believed unseen: every length is checked against the file, and what a chunk may unpack to is limited.

References
----------
MCAP specification, mcap.dev/spec.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from datetime import UTC, datetime

from mcap import records

__all__ = [
    "ATTACHMENT",
    "CHANNEL",
    "HEAD",
    "INDEX_HEAD",
    "LARGEST_CHUNK",
    "LARGEST_NOTE",
    "MAGIC",
    "MESSAGE",
    "MESSAGE_INDEX",
    "METADATA",
    "SCHEMA",
    "Channel",
    "Chunk",
    "Container",
    "DamagedError",
    "Note",
    "describe_chunk",
]

MAGIC = b"\x89MCAP0\r\n"
LARGEST_CHUNK = 256 << 20
"""Bytes a chunk may unpack to. Ours hold about 1 MiB; one giant frame could make one larger."""
LARGEST_NOTE = 64 << 20
"""Bytes of a schema, channel or metadata record."""
MOST_DAMAGE = 1000
"""Damaged parts that are named one by one."""
SCHEMA, CHANNEL, MESSAGE, MESSAGE_INDEX, ATTACHMENT, METADATA = 3, 4, 5, 7, 9, 12
HEAD = struct.Struct("<BQ")
"""Of every record: opcode and length of what follows."""
INDEX_HEAD = struct.Struct("<HI")
"""Of a message index: channel and bytes of entries."""


class DamagedError(Exception):
    """A part of the file is not what it should be. Callers skip the part and say so."""


@dataclass(frozen=True, slots=True)
class Channel:
    """Where the messages of one topic are."""

    id: int
    topic: str
    encoding: str
    schema_name: str
    """Empty, like encoding and text, where only the topic is known."""
    schema_encoding: str
    schema_text: str


@dataclass(frozen=True, slots=True)
class Note:
    """A definition, metadata or an attachment outside of chunks: where its record begins and ends."""

    opcode: int
    start: int
    end: int
    part: int = 0
    """In which of the run's files it is, counted from 0."""


@dataclass(slots=True)
class Chunk:
    """One chunk, not yet read."""

    offset: int
    """Of its record in the file."""
    data_offset: int
    data_size: int
    unpacked_size: int
    checksum: int
    compression: str
    start_ns: int
    end_ns: int
    index: dict[int, tuple[int, int]] = field(default_factory=dict)
    """File offset and number of the index entries, by channel."""
    counts: dict[int, int] = field(default_factory=dict)
    """Messages by channel."""
    is_dated: bool = True
    """The index does not contradict the times of its head, which have no checksum."""
    is_loose: bool = False
    """It is no chunk in the file, but messages that stand there one after the other: the same bytes as in one."""
    part: int = 0
    """In which of the run's files it is, counted from 0."""

    @property
    def start(self) -> int:
        """Where its record begins."""
        return self.offset - HEAD.size

    @property
    def end(self) -> int:
        """Where its record ends."""
        return self.data_offset + self.data_size


@dataclass(slots=True)
class Container:
    """All of the file that could be understood."""

    size: int
    end: int = 0
    """Bytes understood, from the start."""
    finished: bool = False
    """The file has its footer."""
    problem: str = ""
    """Why the pass ended before the footer."""
    chunks: list[Chunk] = field(default_factory=list)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    damage: list[str] = field(default_factory=list)
    """One sentence for each part that was skipped."""
    first_damage: int | None = None
    """Where the first part begins that was skipped."""
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    registered: dict[int, records.Channel] = field(default_factory=dict)
    """The channels as the file defines them."""
    notes: list[Note] = field(default_factory=list)
    """What stands outside of chunks, in the order of the file."""
    data_ended: bool = False
    """What follows is the summary."""
    repeated: list[tuple[Note, bytes]] = field(default_factory=list)
    """Definitions in the summary, which count when its checksum is right."""
    current: Chunk | None = None
    """The chunk that the next index records belong to."""
    names: tuple[str, ...] = ()
    """What the files are called, where a run is in several."""
    sizes: tuple[int, ...] = ()
    """Bytes in each of them."""
    last: Container | None = None
    """The newest of them that is there, by itself."""
    missing: list[str] = field(default_factory=list)
    """One sentence for each part of the run that is not there, or cannot be read."""

    def note_damage(self, offset: int, text: str) -> None:
        """Note a part that is skipped; a file that is all damage does not fill the memory with sentences."""
        self.first_damage = offset if self.first_damage is None else min(offset, self.first_damage)
        if text in self.damage:
            return
        if len(self.damage) < MOST_DAMAGE:
            self.damage.append(text)
        elif len(self.damage) == MOST_DAMAGE:
            self.damage.append("and more")


def describe_chunk(chunk: Chunk, container: Container) -> str:
    """Return where a chunk is, from when, and how many messages of which topics its index promises."""
    channels = container.channels
    counts = [f"{n} of {channels[key].topic}" for key, n in sorted(chunk.counts.items()) if key in channels]
    try:
        begin, end = (datetime.fromtimestamp(ns * 1e-9, tz=UTC) for ns in (chunk.start_ns, chunk.end_ns))
        times = f"{begin:%Y-%m-%d %H:%M:%S.%f} to {end:%H:%M:%S.%f} UTC"
    except (ValueError, OverflowError, OSError):
        times = "of unknown time"
    promised = f"; {', '.join(counts)}" if counts else ""
    place = f" of {container.names[chunk.part]}" if container.names else ""
    return f"the chunk at byte {chunk.offset}{place} ({chunk.data_size} bytes, {times}{promised})"
