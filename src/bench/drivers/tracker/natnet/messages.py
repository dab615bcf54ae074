"""The small messages: who is there, what is asked and answered, and the clock echo."""

from __future__ import annotations

from dataclasses import dataclass, field
from struct import Struct

from bench.drivers.tracker.natnet.wire import LARGEST_TICKS, Message, Reader, Version, encode_packet, pack_text
from bench.errors import ProtocolError

__all__ = [
    "ConnectRequest",
    "ServerInfo",
    "decode_connect",
    "decode_echo_request",
    "decode_echo_response",
    "decode_number",
    "decode_server_info",
    "decode_text",
    "encode_connect",
    "encode_echo_request",
    "encode_echo_response",
    "encode_integer_response",
    "encode_number_response",
    "encode_request",
    "encode_server_info",
    "encode_text_response",
    "encode_unrecognized",
]

NAME_BYTES = 256
SENDER = Struct(f"<{NAME_BYTES}s4B4B")
"""Name, version of the application, version of NatNet: 264 bytes."""
OPTIONS = Struct("<B4B")
"""Whether only subscribed data is wanted, and the bitstream version; since NatNet 4, after the sender."""
CONNECT_BYTES = 270
"""What clients of SDK 4 send: sender, options and one byte more."""
SERVER = Struct("<QHB4B")
"""Clock frequency, data port, multicast or not, group: since NatNet 3, after the sender."""
UNRECOGNIZED_BYTES = SENDER.size
"""Motive answers an unknown request with as many bytes (seen in the recorded packets)."""
ECHO_REQUEST = Struct("<Q")
ECHO_RESPONSE = Struct("<QQ")
FLOAT = Struct("<f")
INTEGER = Struct("<i")


@dataclass(frozen=True, slots=True)
class ConnectRequest:
    """What a client says of itself; also the payload of a discovery."""

    name: str = ""
    app_version: Version = (0, 0, 0, 0)
    natnet_version: Version = (0, 0, 0, 0)
    bitstream: Version | None = None
    """Version in which frames are wanted (unicast, NatNet 4 and newer); None: the server's own."""
    subscribed_only: bool = False
    name_rest: bytes = field(default=b"", compare=False, repr=False)
    """As in `ServerInfo`."""


@dataclass(frozen=True, slots=True)
class ServerInfo:
    """What the tracker's software says of itself."""

    name: str
    app_version: Version
    natnet_version: Version
    clock_hz: int = 0
    """Ticks of its clock in a second; 0 before NatNet 3. Never to be assumed: it depends on the PC."""
    data_port: int = 1511
    is_multicast: bool = False
    multicast_group: tuple[int, ...] = (239, 255, 42, 99)
    name_rest: bytes = field(default=b"", compare=False, repr=False)
    """What stands behind the name's end: Motive does not clear the memory there."""


def encode_connect(request: ConnectRequest, message: Message = Message.CONNECT) -> bytes:
    """Encode a CONNECT of 270 bytes, or of 264 where no bitstream version is wanted."""
    payload = _pack_sender(request)
    if request.bitstream is not None:
        payload += OPTIONS.pack(request.subscribed_only, *_four(request.bitstream))
        payload = payload.ljust(CONNECT_BYTES, b"\0")
    return encode_packet(message, payload)


def decode_connect(payload: bytes) -> ConnectRequest:
    """Decode a CONNECT of any length: clients in the field send 0, 5, 264, 270 or 271 bytes."""
    if len(payload) < SENDER.size:
        return ConnectRequest(decode_text(payload))
    name, app, natnet, rest = _unpack_sender(payload)
    if len(payload) < SENDER.size + OPTIONS.size:
        return ConnectRequest(name, app, natnet, name_rest=rest)
    subscribed, *bitstream = OPTIONS.unpack_from(payload, SENDER.size)
    wanted = tuple(bitstream) if any(bitstream) else None
    return ConnectRequest(name, app, natnet, wanted, bool(subscribed), rest)


def encode_server_info(info: ServerInfo) -> bytes:
    """Encode a SERVERINFO of 279 bytes."""
    sender = _pack_sender(info)
    tail = SERVER.pack(info.clock_hz, info.data_port, info.is_multicast, *info.multicast_group)
    return encode_packet(Message.SERVERINFO, sender + tail)


def decode_server_info(payload: bytes) -> ServerInfo:
    """Decode a SERVERINFO; before NatNet 3 it has 264 bytes and knows no clock.

    Raises
    ------
    ProtocolError
        Shorter than that.
    """
    if len(payload) < SENDER.size:
        raise ProtocolError(f"A NatNet SERVERINFO has {len(payload)} bytes; at least {SENDER.size} are due.")
    name, app, natnet, rest = _unpack_sender(payload)
    if len(payload) < SENDER.size + SERVER.size:
        return ServerInfo(name, app, natnet, name_rest=rest)
    clock_hz, port, is_multicast, *group = SERVER.unpack_from(payload, SENDER.size)
    return ServerInfo(name, app, natnet, clock_hz, port, bool(is_multicast), tuple(group), rest)


def encode_request(text: str) -> bytes:
    """Encode a REQUEST such as `FrameRate`."""
    return encode_packet(Message.REQUEST, pack_text(text))


def encode_text_response(text: str) -> bytes:
    return encode_packet(Message.RESPONSE, pack_text(text))


def encode_number_response(value: float) -> bytes:
    return encode_packet(Message.RESPONSE, FLOAT.pack(value))


def encode_integer_response(value: int) -> bytes:
    return encode_packet(Message.RESPONSE, INTEGER.pack(value))


def encode_unrecognized(request: bytes) -> bytes:
    """Encode the answer to a request that is not understood: the request again, in 264 bytes."""
    return encode_packet(Message.UNRECOGNIZED_REQUEST, request[:UNRECOGNIZED_BYTES].ljust(UNRECOGNIZED_BYTES, b"\0"))


def decode_text(payload: bytes) -> str:
    """Decode the string of a REQUEST, RESPONSE or MESSAGESTRING; its terminating zero may be missing."""
    return payload.split(b"\0", 1)[0].decode("utf-8", "replace")


def decode_number(payload: bytes, layout: Struct = FLOAT) -> float:
    """Decode a RESPONSE that is one number.

    Raises
    ------
    ProtocolError
        It does not have the size of a number.
    """
    if len(payload) != layout.size:
        raise ProtocolError(f"A NatNet RESPONSE has {len(payload)} bytes where a number of {layout.size} is due.")
    return float(layout.unpack(payload)[0])


def encode_echo_request(client_ticks: int) -> bytes:
    """Encode the question what the server's clock reads; `client_ticks` comes back and tells answers apart."""
    return encode_packet(Message.ECHOREQUEST, ECHO_REQUEST.pack(client_ticks))


def decode_echo_request(payload: bytes) -> int:
    return int(Reader(payload, "ECHOREQUEST").unpack(ECHO_REQUEST)[0])


def encode_echo_response(client_ticks: int, server_ticks: int) -> bytes:
    return encode_packet(Message.ECHORESPONSE, ECHO_RESPONSE.pack(client_ticks, server_ticks))


def decode_echo_response(payload: bytes) -> tuple[int, int]:
    """Return the client's ticks and the server's.

    Raises
    ------
    ProtocolError
        Too short, or ticks that no clock has.
    """
    client, server = Reader(payload, "ECHORESPONSE").unpack(ECHO_RESPONSE)
    if server > LARGEST_TICKS:
        raise ProtocolError(f"A NatNet ECHORESPONSE says {server} ticks; at most {LARGEST_TICKS} make sense.")
    return int(client), int(server)


def _four(version: Version) -> Version:
    return (*version, 0, 0, 0, 0)[:4]


def _pack_sender(sender: ConnectRequest | ServerInfo) -> bytes:
    name = sender.name.encode()[: NAME_BYTES - 1] + b"\0" + sender.name_rest
    return SENDER.pack(name[:NAME_BYTES], *_four(sender.app_version), *_four(sender.natnet_version))


def _unpack_sender(payload: bytes) -> tuple[str, Version, Version, bytes]:
    raw, *numbers = SENDER.unpack_from(payload)
    _, _, rest = raw.partition(b"\0")
    return decode_text(raw), tuple(numbers[:4]), tuple(numbers[4:]), rest.rstrip(b"\0")
