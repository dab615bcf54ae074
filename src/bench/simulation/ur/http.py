"""As much of an HTTP/1.1 server as one JSON interface needs: requests with a length, answers with a length."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any

from bench.simulation.outbox import Outbox

__all__ = ["HttpSession", "Reply", "Request"]

LONGEST_HEAD = 16_384
LONGEST_BODY = 1_048_576
JSON = "application/json"


@dataclass(frozen=True, slots=True)
class Request:
    """One request."""

    method: str
    path: str
    fields: dict[str, Any] | None
    """The JSON object of its body; None if it is something else, or there is none."""


@dataclass(frozen=True, slots=True)
class Reply:
    """What is answered."""

    fields: dict[str, Any]
    status: HTTPStatus = HTTPStatus.OK


class HttpSession:
    """One connection of a client, answered request by request, from the network's thread.

    Parameters
    ----------
    outbox : Outbox
        Takes the answers.
    answer : callable
        Gives the reply to a request.
    """

    def __init__(self, outbox: Outbox, answer: Callable[[Request], Reply]) -> None:
        self._outbox = outbox
        self._answer = answer
        self._received = b""

    def receive(self, data: bytes) -> bool:
        """Answer each whole request; False when the connection is over."""
        self._received += data
        while (end := self._received.find(b"\r\n\r\n")) >= 0:
            head = self._received[:end].decode("latin-1")
            length = _length(head)
            if length is None:
                self._send(Reply({"message": "Bad Request"}, HTTPStatus.BAD_REQUEST))
                return False
            if len(self._received) < end + 4 + length:
                return True
            body, self._received = self._received[end + 4 : end + 4 + length], self._received[end + 4 + length :]
            self._send(self._answer(_request(head, body)))
            if "\nconnection: close" in head.lower():
                return False
        return len(self._received) <= LONGEST_HEAD

    def close(self) -> None:
        """Forget the client, for which nothing is kept."""

    def _send(self, reply: Reply) -> None:
        body = json.dumps(reply.fields).encode()
        head = f"HTTP/1.1 {reply.status.value} {reply.status.phrase}\r\nContent-Type: {JSON}\r\n"
        self._outbox.send(f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body)


def _length(head: str) -> int | None:
    """Return the length of the body that belongs to a head; None if this is no request that can be read."""
    first, *lines = head.split("\r\n")
    if len(first.split(" ")) != 3 or not first.endswith(("HTTP/1.1", "HTTP/1.0")):
        return None
    headers = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    text = headers.get("content-length", "0")
    if "transfer-encoding" in headers or not (text.isascii() and text.isdigit()) or len(text) > 9:
        return None
    return int(text) if int(text) <= LONGEST_BODY else None


def _request(head: str, body: bytes) -> Request:
    method, target, _ = head.split("\r\n", 1)[0].split(" ")
    try:
        data = json.loads(body)
    except (ValueError, RecursionError):
        data = None
    return Request(method, target.partition("?")[0], data if isinstance(data, dict) else None)
