"""Metadata and attachments as they stand in a file, each held against its lengths and, if it has one, its checksum."""

from __future__ import annotations

import struct
from io import BytesIO

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

from bench.recording.container.contents import ATTACHMENT, HEAD, LARGEST_NOTE, METADATA, Container, DamagedError, Note
from bench.recording.container.ending import encode_records
from bench.recording.files.run_files import RunFiles

__all__ = ["find_attachment", "read_note"]


def read_note(file: RunFiles, note: Note) -> records.Metadata | records.Attachment:
    """Read a note of metadata or an attachment.

    Raises
    ------
    DamagedError
        It is not what it should be.
    """
    if note.end - note.start > LARGEST_NOTE:
        raise DamagedError(f"it is larger than {LARGEST_NOTE} bytes")
    body = file.pread(note.end - note.start - HEAD.size, note.start + HEAD.size, note.part)
    stream = ReadDataStream(BytesIO(body))
    record: records.Metadata | records.Attachment
    try:
        record = records.Metadata.read(stream) if note.opcode == METADATA else records.Attachment.read(stream)
    except (struct.error, ValueError, OverflowError, MemoryError, McapError) as error:
        raise DamagedError(f"it cannot be taken apart: {error}") from error
    if encode_records([record]) != HEAD.pack(note.opcode, len(body)) + body:
        raise DamagedError("its lengths contradict each other, or its checksum is wrong")
    return record


def find_attachment(file: RunFiles, container: Container, name: str) -> bytes | None:
    """Return the content of the first sound attachment of this name; None without one."""
    for note in container.notes:
        if note.opcode == ATTACHMENT:
            try:
                record = read_note(file, note)
            except DamagedError:
                continue
            if isinstance(record, records.Attachment) and record.name == name:
                return record.data
    return None
