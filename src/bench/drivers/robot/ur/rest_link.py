"""Questions over HTTP with JSON answers, each within one deadline from connecting to the last byte.

The only module that knows httpx. Its own limits are per socket operation, so a server that sends a byte now and then
would never run into them; here the whole exchange has one limit. No connection is kept between two exchanges: after
a hiccup the next one starts afresh, and nothing is left open.
"""

from __future__ import annotations

import asyncio
import json
from dataclasses import dataclass
from typing import Any

import httpx

from bench.drivers.robot.ur.words import one_line
from bench.errors import ConnectError, DeviceError, DeviceTimeoutError, LinkLostError, ProtocolError

__all__ = ["Answer", "RestLink"]

LARGEST_ANSWER = 4_194_304
"""The largest answer is the API's own description, some hundred kilobytes."""
MAX_REDIRECTS = 3
"""Paths have moved between versions of the Robot API, with a redirect from the old one."""
MOVED_STATUSES = (307, 308)
"""The redirects that keep method and body."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What came back."""

    status: int
    """HTTP status."""
    fields: dict[str, Any]
    """The JSON object; empty if the body is something else."""
    content: bytes
    """The body as it came."""

    @property
    def is_ok(self) -> bool:
        return 200 <= self.status < 300

    @property
    def said(self) -> str:
        """What the server says of it, in one line and ready to end a sentence."""
        parts = [self.fields.get(key) for key in ("message", "details")]
        text = one_line(" ".join(part for part in parts if isinstance(part, str)))
        return text.rstrip(".") or f"status {self.status}"


class RestLink:
    """A JSON API below one path of one host. Not for several threads at once.

    Parameters
    ----------
    host, port, root : str, int, str
        Where the API is: ``http://host:port/root``.
    peer : str
        Completes "The … did not answer".
    limit_s : float
        Limit on one exchange, in the machine's own seconds.
    """

    def __init__(self, host: str, port: int, root: str, *, peer: str, limit_s: float) -> None:
        self._address = (host, port, root)
        self._peer = peer
        self._limit_s = limit_s
        self._runner = asyncio.Runner(loop_factory=asyncio.new_event_loop)
        self._client = httpx.AsyncClient(
            trust_env=False,  # a proxy for the web does not lead to the robot
            timeout=None,  # noqa: S113 - `_exchange` limits the whole
            limits=httpx.Limits(max_keepalive_connections=0),
            headers={"Accept": "application/json", "Accept-Encoding": "identity"},
        )

    def ask(self, method: str, path: str, body: dict[str, str] | None = None) -> Answer:
        """Send one request and return its answer, whatever its status.

        Raises
        ------
        ConnectError
            Nobody listens there.
        DeviceTimeoutError
            The answer was not complete within the limit.
        LinkLostError, ProtocolError
            The connection broke, or what came is no HTTP.
        """
        request = f"{method} {path}"
        try:
            status, received = self._runner.run(self._exchange(method, path, body))
        except TimeoutError as error:
            raise DeviceTimeoutError(f"The {self._peer} did not answer '{request}' in {self._limit_s:g} s.") from error
        except (httpx.HTTPError, httpx.InvalidURL, OSError, ValueError) as error:
            raise self._translate(request, error) from error
        return Answer(status, _parse(received), received)

    async def _exchange(self, method: str, path: str, body: dict[str, str] | None) -> tuple[int, bytes]:
        """Follow a request to where the controller has moved its path to; the limit is on the whole."""
        host, port, root = self._address
        url = httpx.URL(scheme="http", host=host, port=port, path=f"/{root}/{path}")
        async with asyncio.timeout(self._limit_s):
            for _ in range(MAX_REDIRECTS + 1):
                status, received, moved_to = await self._send(method, url, body)
                if moved_to is None:
                    return status, received
                if moved_to.host != url.host:
                    raise ProtocolError(f"The {self._peer} sends '{method} {path}' on to another host.")
                url = moved_to
        raise ProtocolError(f"The {self._peer} sends '{method} {path}' on more than {MAX_REDIRECTS} times.")

    async def _send(
        self, method: str, url: httpx.URL, body: dict[str, str] | None
    ) -> tuple[int, bytes, httpx.URL | None]:
        received = bytearray()
        async with self._client.stream(method, url, json=body) as response:
            if response.status_code in MOVED_STATUSES and response.next_request is not None:
                return response.status_code, b"", response.next_request.url
            async for piece in response.aiter_raw():
                received += piece
                if len(received) > LARGEST_ANSWER:
                    raise ProtocolError(f"The {self._peer} answers '{method}' with more than {LARGEST_ANSWER} bytes.")
        return response.status_code, bytes(received), None

    def _translate(self, request: str, error: Exception) -> DeviceError:
        reason = one_line(str(error)).rstrip(".") or type(error).__name__
        if isinstance(error, httpx.ConnectError | httpx.InvalidURL | httpx.UnsupportedProtocol):
            return ConnectError(
                f"The {self._peer} cannot be reached: {reason}.",
                hint="Check that the controller is on, the cable, [robot] host and robot_api_port.",
            )
        if isinstance(error, httpx.RemoteProtocolError | ValueError):
            return ProtocolError(
                f"The {self._peer} answers '{request}' with something that is no HTTP: {reason}.",
                hint="Check [robot] robot_api_port.",
            )
        return LinkLostError(
            f"The {self._peer} did not take '{request}': {reason}.", hint="Check the robot and its network cable."
        )

    def close(self) -> None:
        """Free what the client holds. May be called twice."""
        self._runner.close()


def _parse(received: bytes) -> dict[str, Any]:
    try:
        data = json.loads(received)
    except (ValueError, RecursionError):
        return {}
    return data if isinstance(data, dict) else {}
