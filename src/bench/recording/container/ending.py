"""The end of an MCAP file: what stands where, gathered while it is put together, for readers that start there.

References
----------
MCAP specification, mcap.dev/spec: summary section.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from itertools import accumulate
from typing import Any

from mcap import records
from mcap.data_stream import RecordBuilder

from bench.recording.container.contents import HEAD, INDEX_HEAD, MAGIC, Chunk

__all__ = ["Ending", "encode_records"]

_FOOTER_HEAD = struct.Struct("<BQQQ")
_FOOTER, _FOOTER_SIZE = 2, 20


def encode_records(made: Iterable[records.McapRecord]) -> bytes:
    """Return records as they stand in a file."""
    builder: Any = RecordBuilder()
    for record in made:
        record.write(builder)
    return bytes(builder.end())


class Ending:
    """The summary of a file, built up by noting each part with the place it has in it."""

    def __init__(self, schemas: Iterable[records.Schema], channels: Iterable[records.Channel]) -> None:
        self._schemas = list(schemas)
        self._channels = list(channels)
        self._chunks: list[records.ChunkIndex] = []
        self._counts: dict[int, int] = {}
        self._times: list[int] = []
        self._notes: list[records.MetadataIndex | records.AttachmentIndex] = []

    def note_chunk(self, chunk: Chunk, start: int) -> None:
        """Note a chunk whose record begins at `start`, followed by an index of its channels in the order of counts."""
        sizes = {channel: HEAD.size + INDEX_HEAD.size + 16 * n for channel, n in chunk.counts.items()}
        end = start + chunk.end - chunk.start
        places = dict(zip(sizes, accumulate(sizes.values(), initial=end), strict=False))
        self._chunks.append(
            records.ChunkIndex(
                chunk_length=chunk.end - chunk.start,
                chunk_start_offset=start,
                compression=chunk.compression,
                compressed_size=chunk.data_size,
                message_end_time=chunk.end_ns,
                message_index_length=sum(sizes.values()),
                message_index_offsets=places,
                message_start_time=chunk.start_ns,
                uncompressed_size=chunk.unpacked_size,
            )
        )
        self._times += [chunk.start_ns, chunk.end_ns]
        for channel, n in chunk.counts.items():
            self._counts[channel] = self._counts.get(channel, 0) + n

    def note_metadata(self, name: str, start: int, size: int) -> None:
        """Note a metadata record."""
        self._notes.append(records.MetadataIndex(offset=start, length=size, name=name))

    def note_attachment(self, attachment: records.Attachment, start: int, size: int) -> None:
        """Note an attachment."""
        self._notes.append(
            records.AttachmentIndex(
                offset=start,
                length=size,
                log_time=attachment.log_time,
                create_time=attachment.create_time,
                data_size=len(attachment.data),
                name=attachment.name,
                media_type=attachment.media_type,
            )
        )

    def encode(self, start: int) -> bytes:
        """Return all that follows the data, for a file whose data ends at `start`."""
        data_end = encode_records([records.DataEnd(0)])
        summary_start = start + len(data_end)
        summary = encode_records(
            [*self._schemas, *self._channels, self._make_statistics(), *self._chunks, *self._notes]
        )
        checksum = zlib.crc32(_FOOTER_HEAD.pack(_FOOTER, _FOOTER_SIZE, summary_start, 0), zlib.crc32(summary))
        return data_end + summary + encode_records([records.Footer(summary_start, 0, checksum)]) + MAGIC

    def _make_statistics(self) -> records.Statistics:
        n_metadata = sum(isinstance(note, records.MetadataIndex) for note in self._notes)
        return records.Statistics(
            attachment_count=len(self._notes) - n_metadata,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=max(self._times, default=0),
            message_start_time=min(self._times, default=0),
            metadata_count=n_metadata,
            schema_count=len(self._schemas),
        )
