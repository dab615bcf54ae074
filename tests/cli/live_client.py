"""A viewer by hand: Foxglove's websocket protocol, from its specification, over the `websockets` library.

References
----------
Foxglove WebSocket protocol v1: github.com/foxglove/ws-protocol, docs/spec.md.
"""

from __future__ import annotations

import json
import socket
import struct
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any
from urllib.parse import urlsplit

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

PROTOCOLS = [Subprotocol("foxglove.sdk.v1")]
_MESSAGE = 1
_HEAD = struct.Struct("<BIQ")


class LiveClient:
    """Subscribes to every channel as it is told of; `watch` gathers the messages by topic until the server closes."""

    def __init__(self) -> None:
        self.channels: dict[str, dict[str, Any]] = {}
        self.messages: dict[str, list[tuple[int, bytes]]] = defaultdict(list)
        self._topics: dict[int, str] = {}

    def watch(self, url: str) -> None:
        with connect(url, subprotocols=PROTOCOLS, max_size=None) as connection, suppress(ConnectionClosed):
            for frame in connection:
                self._take(frame, connection)

    def _take(self, frame: str | bytes, connection: ClientConnection) -> None:
        if isinstance(frame, bytes):
            kind, subscription, log_time_ns = _HEAD.unpack_from(frame)
            if kind == _MESSAGE:
                self.messages[self._topics[subscription]].append((log_time_ns, frame[_HEAD.size :]))
            return
        told = json.loads(frame)
        if told["op"] == "advertise":
            subscribe(connection, told["channels"])
            for channel in told["channels"]:
                self.channels[channel["topic"]] = channel
                self._topics[channel["id"]] = channel["topic"]


def subscribe(connection: ClientConnection, channels: list[dict[str, Any]]) -> None:
    wanted = [{"id": channel["id"], "channelId": channel["id"]} for channel in channels]
    connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


@contextmanager
def stalled_client(url: str) -> Iterator[None]:
    """Subscribe to everything, then never read again; the smallest of buffers, so that the server's fill up."""
    parts = urlsplit(url)
    narrow = socket.socket()
    narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
    narrow.connect((parts.hostname, parts.port))
    with connect(url, sock=narrow, subprotocols=PROTOCOLS, max_queue=1, close_timeout=0.1) as connection:
        told = {"op": ""}
        while told["op"] != "advertise":
            told = json.loads(connection.recv())
        subscribe(connection, told["channels"])
        yield
