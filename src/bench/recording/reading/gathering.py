"""Parts of many messages of an unpacked chunk, copied out in one call.

A view of the chunk that begins a record at every byte, indexed with the messages' offsets, brings them all at once.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.recording.container.chunks import Data, Offsets
from bench.recording.container.contents import DamagedError
from bench.recording.reading.columns import Array

__all__ = ["MESSAGE_HEAD", "OWN_HEAD", "gather", "gather_bytes", "gather_heads", "payload_of", "read_message"]

MESSAGE_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time_ns", "<i8"),
        ("publish_time_ns", "<i8"),
    ]
)
"""An MCAP message record up to its payload; the times are unsigned there, and int64 here until the year 2262."""
OWN_HEAD = MESSAGE_HEAD.itemsize - 9
"""What a record's length counts besides the payload: all of the head but opcode and length."""


def gather(data: Data, offsets: Offsets, dtype: np.dtype[np.void]) -> Array:
    """Copy out one record of `dtype` at each offset; they ascend."""
    n_places = len(data) - dtype.itemsize + 1
    if len(offsets) == 0:
        return np.empty(0, dtype)
    if n_places <= offsets[-1] or offsets[0] < 0:
        raise DamagedError("a message goes beyond it")
    # copied as bytes without fields: numpy copies a record with fields one field after the other
    places: Array = np.ndarray((n_places,), f"V{dtype.itemsize}", buffer=data, strides=(1,))
    return places[offsets].view(dtype)


def gather_bytes(data: Data, offsets: Offsets, size: int) -> npt.NDArray[np.uint8]:
    """Copy out `size` bytes at each offset, one row for each."""
    return gather(data, offsets, np.dtype(f"V{size}")).view(np.uint8).reshape(len(offsets), size)


def gather_heads(data: Data, offsets: Offsets) -> Array:
    """Return the heads of messages, each of which ends within the chunk."""
    heads = gather(data, offsets, MESSAGE_HEAD)
    sizes = heads["length"] - np.uint64(OWN_HEAD)  # of a length that is too small a huge number
    room = len(data) - MESSAGE_HEAD.itemsize - offsets
    if (sizes > room.astype(np.uint64)).any():
        raise DamagedError("a message goes beyond it")
    return heads


def payload_of(data: Data, offset: int, length: int) -> Data:
    """Return the payload of the message at `offset` whose record has `length`."""
    return data[offset + MESSAGE_HEAD.itemsize : offset + MESSAGE_HEAD.itemsize + length - OWN_HEAD]


def read_message(data: Data, offset: int) -> tuple[int, int, int, bytes]:
    """Return log time, publish time, sequence and payload of the message at `offset`; `DamagedError` if it is cut."""
    head = gather_heads(data, np.array([offset]))[0]
    times = int(head["log_time_ns"]), int(head["publish_time_ns"])
    return *times, int(head["sequence"]), bytes(payload_of(data, offset, int(head["length"])))
