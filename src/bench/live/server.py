"""Foxglove's websocket: which channels there are, and what goes into them. The one file that knows foxglove-sdk."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from typing import Any

import foxglove
import numpy as np
import numpy.typing as npt
from foxglove.channels import SceneUpdateChannel
from foxglove.messages import Color, LinePrimitive, Point3, SceneEntity, SceneUpdate, Timestamp

from bench.errors import ConnectError
from bench.recording import CYCLE, LOG, POINTS, STATE, TOPICS, encode, load_schema
from bench.report.derived import CURVATURE, CURVATURE_SCHEMA, LINE

__all__ = ["FORWARDED", "LiveServer"]

FORWARDED = (POINTS, CYCLE, STATE, LOG)
"""Topics that are served as they stand in the run file."""
STATUS = "/live/status"
_MADE = {STATUS: "bench_msgs/msg/LiveStatus", CURVATURE: CURVATURE_SCHEMA}
_LINE_PIXELS = 4.0
_BACKLOG = 2048
"""Messages that wait for a slow client, some 40 s and 2 MB of them; then its oldest are left out."""
_LINGER_S = 0.5
"""Machine time for the last messages to leave: the library drops what still waits when it is stopped."""

Floats = npt.NDArray[np.float64]


class LiveServer:
    """Serves the live view until it is closed. A client that does not read holds up nobody: it loses messages.

    Raises
    ------
    ConnectError
        The address cannot be served.
    """

    def __init__(self, host: str, port: int) -> None:
        self._context = foxglove.Context()
        schemas = {topic: TOPICS[topic].schema for topic in FORWARDED} | _MADE
        self._channels = {topic: self._make_channel(topic, name) for topic, name in schemas.items()}
        self._line = SceneUpdateChannel(LINE, context=self._context)
        try:
            self._server = foxglove.start_server(
                name="bench", host=host, port=port, context=self._context, message_backlog_size=_BACKLOG
            )
        except (RuntimeError, OSError, ValueError) as error:
            raise ConnectError(
                f"The live view cannot be served on {host}:{port}: {error}.",
                hint="Another bench may be served there: choose another port, or an address of this machine.",
            ) from error
        self.url = f"ws://{f'[{host}]' if ':' in host else host}:{self._server.port}"
        """Where a viewer connects."""

    def _make_channel(self, topic: str, name: str) -> foxglove.Channel:
        schema = foxglove.Schema(name=name, encoding="ros2msg", data=load_schema(name).text.encode())
        return foxglove.Channel(topic, message_encoding="cdr", schema=schema, context=self._context)

    def forward(self, topic: str, payload: bytes, host_ns: int) -> None:
        """Send a message that is encoded already: of the run file as it is, or one of the cable's curvature."""
        self._channels[topic].log(payload, log_time=host_ns)

    def show_status(self, values: Mapping[str, Any], host_ns: int) -> None:
        """Send where the run stands, the fields of ``bench_msgs/msg/LiveStatus``."""
        self.forward(STATUS, encode(load_schema(_MADE[STATUS]), values), host_ns)

    def draw_line(self, line_m: Floats, of_limit: Iterable[float], host_ns: int) -> None:
        """Draw the cable (g, 3), green where straight and red where `of_limit` (g,) reaches 1, its curvature limit."""
        sec, nanosec = divmod(host_ns, 1_000_000_000)
        line = LinePrimitive(
            thickness=_LINE_PIXELS,
            scale_invariant=True,
            points=[Point3(x=x, y=y, z=z) for x, y, z in line_m.tolist()],
            colors=[Color(r=red, g=1.0 - red, b=0.2, a=1.0) for red in of_limit],
        )
        entity = SceneEntity(timestamp=Timestamp(sec, nanosec), frame_id="lab", id="cable", lines=[line])
        self._line.log(SceneUpdate(entities=[entity]), log_time=host_ns)

    def close(self) -> None:
        """Let what was sent last get out, then disconnect all clients."""
        threading.Event().wait(_LINGER_S)
        self._server.stop()
