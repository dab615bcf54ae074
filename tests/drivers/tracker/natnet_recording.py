"""Real packets: the recorded traffic of Motive 2.1, read from its capture file."""

from __future__ import annotations

import struct
from functools import cache
from pathlib import Path

DATA = Path(__file__).parent / "data" / "natnet"
ENHANCED_PACKET = 6
ETHERNET_BYTES = 14


@cache
def traffic() -> list[bytes]:
    """Return the UDP payloads of the capture, in order."""
    raw = (DATA / "traffic.pcapng").read_bytes()
    payloads, offset = [], 0
    while offset < len(raw):
        kind, size = struct.unpack_from("<II", raw, offset)
        if kind == ENHANCED_PACKET:
            captured = struct.unpack_from("<I", raw, offset + 20)[0]
            payloads.append(_udp_payload(raw[offset + 28 + ETHERNET_BYTES : offset + 28 + captured]))
        offset += size
    return payloads


def packets_of(message: int) -> list[bytes]:
    return [packet for packet in traffic() if struct.unpack_from("<H", packet)[0] == message]


def stored(name: str) -> bytes:
    return (DATA / f"{name}.bin").read_bytes()


def _udp_payload(ip: bytes) -> bytes:
    header = (ip[0] & 15) * 4
    size = struct.unpack_from(">H", ip, header + 4)[0]
    return ip[header + 8 : header + size]
