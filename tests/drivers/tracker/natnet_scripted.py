"""A tracker whose every packet the test chooses: sockets for the client, a bare link for the stream."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from bench.drivers.tracker.natnet.frame import BODY, LABELED, Frame, encode_frame
from bench.drivers.tracker.natnet.messages import (
    ServerInfo,
    decode_echo_request,
    decode_text,
    encode_echo_response,
    encode_integer_response,
    encode_number_response,
    encode_server_info,
)
from bench.drivers.tracker.natnet.models import RigidBodyModel, encode_models
from bench.drivers.tracker.natnet.wire import Message, encode_packet, split_packet

CLOCK_HZ = 1_000_000
PERIOD_TICKS = 10_000
VERSION = (4, 1)


def make_packet(
    number: int,
    *,
    ticks: int | None = None,
    received: int = 5,
    params: int = 0,
    version: tuple[int, ...] = VERSION,
    **more: object,
) -> bytes:
    """Encode a frame of two points and a body; `ticks` 0: the camera gives no mid-exposure stamp."""
    labeled = np.zeros(2, dtype=LABELED)
    labeled["id"] = (1 << 16 | 1, 50_001)
    labeled["params"] = (0x0A, 0x12)
    labeled["position_m"][:, 0] = number
    bodies = np.zeros(1, dtype=BODY)
    bodies["id"], bodies["params"] = 1, 1
    stamp = number * PERIOD_TICKS if ticks is None else ticks
    other_m, timestamp_s = labeled["position_m"][:1], number * 0.01
    frame = Frame(number, labeled, bodies, other_m, timestamp_s, stamp, received, 0, params=params, **more)
    return encode_frame(frame, version)


class BareLink:
    """Keeps what the stream sends."""

    name = "127.0.32.1:1510"

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def send(self, packet: bytes) -> bool:
        self.sent.append(packet)
        return True

    def sent_messages(self) -> list[int]:
        return [split_packet(packet)[0] for packet in self.sent]


class ScriptedTracker:
    """Answers the handshake; frames are sent when the test says so."""

    def __init__(self, host: str) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((host, 0))
        self.socket.settimeout(0.02)
        self.host, self.port = self.socket.getsockname()
        self.info = ServerInfo("Motive", (3, 1, 0, 0), (4, 1, 0, 0), CLOCK_HZ)
        self.answers: dict[str, bytes | None] = {
            "UnitsToMillimeters": encode_number_response(1000.0),
            "FrameRate": encode_number_response(100.0),
            "UpAxis": encode_integer_response(1),
        }
        self.models: bytes | None = encode_models((RigidBodyModel("clamp", 1, np.zeros((3, 3), np.float32)),), VERSION)
        self.heard: list[int] = []
        self.client: tuple[str, int] | None = None
        self.echo: Callable[[int], bytes | None] = lambda ticks: encode_echo_response(ticks, 77)
        self.is_deaf = False
        self.told: ServerInfo | None = None
        """What is said, where it is not what is true."""
        self._stopping = threading.Event()

    def send(self, packet: bytes) -> None:
        if self.client is not None:
            self.socket.sendto(packet, self.client)

    def send_to_group(self, packet: bytes) -> None:
        """Send a frame as a multicast, from a port of its own as Motive does."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.bind((self.host, 0))
            link.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(self.host))
            group = ".".join(map(str, self.info.multicast_group))
            link.sendto(packet, (group, self.info.data_port))

    def serve(self) -> None:
        while not self._stopping.is_set():
            try:
                packet, sender = self.socket.recvfrom(2048)
            except TimeoutError:
                continue
            message, payload = split_packet(packet)
            self.heard.append(message)
            if self.is_deaf:
                continue
            self.client = sender
            reply = self.reply(message, payload)
            if reply is not None:
                self.socket.sendto(reply, sender)

    def stop(self) -> None:
        self._stopping.set()

    def reply(self, message: int, payload: bytes) -> bytes | None:
        if message in (Message.CONNECT, Message.DISCOVERY):
            return encode_server_info(self.told or self.info)
        if message == Message.REQUEST:
            return self.answers.get(decode_text(payload), encode_packet(Message.UNRECOGNIZED_REQUEST, bytes(264)))
        if message == Message.REQUEST_MODELDEF:
            return self.models
        return self.echo(decode_echo_request(payload)) if message == Message.ECHOREQUEST else None


@contextmanager
def scripted_tracker(host: str = "127.0.32.2") -> Iterator[ScriptedTracker]:
    tracker = ScriptedTracker(host)
    thread = threading.Thread(target=tracker.serve)
    thread.start()
    try:
        yield tracker
    finally:
        tracker.stop()
        thread.join()
        tracker.socket.close()
