"""NatNet unicast: every frame, every clock echo, from a reader thread of our own."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from struct import Struct

from bench.config import TrackerConfig
from bench.drivers.base import RecordSink
from bench.drivers.tracker.natnet.bitstream import CHOOSING_SINCE, WANTED_VERSION, Bitstream
from bench.drivers.tracker.natnet.frame import OLDEST_VERSION
from bench.drivers.tracker.natnet.link import CommandLink
from bench.drivers.tracker.natnet.messages import (
    ConnectRequest,
    ServerInfo,
    decode_number,
    decode_server_info,
    encode_connect,
    encode_request,
)
from bench.drivers.tracker.natnet.models import RigidBodyModel
from bench.drivers.tracker.natnet.stream import FrameStream
from bench.drivers.tracker.natnet.wire import Message, Version, encode_packet
from bench.errors import BenchError, ConnectError, DeviceStateError, LinkLostError, ProtocolError
from bench.model import DeviceInfo, LogEntry, Severity
from bench.timing import Clock, patience_ns

__all__ = ["NatNetTracker"]

logger = logging.getLogger(__name__)

CONNECT_TRIES, CONNECT_WAIT_S = 6, 0.5
"""3 s of machine time in all; a tracker on the same network answers within 2 ms."""
QUESTION_TRIES, QUESTION_WAIT_S = 3, 0.25
KEEPALIVE_S = 1.0
"""Machine time; Motive drops a unicast client that it has not heard for some seconds."""
SILENCE_S = 1.0
"""Machine time without a frame after which the link counts as lost: 100 frames at 100 Hz."""
JOIN_S = 2.0
METRES_TO_MILLIMETRES = 1000.0
UP_AXES = {0: "x", 1: "y", 2: "z"}
FLOAT, INTEGER = Struct("<f"), Struct("<i")


class NatNetTracker:
    """A `TrackerStream` of OptiTrack Motive (NatNet 3.0 and newer), unicast.

    Parameters
    ----------
    config : TrackerConfig
    clock : Clock
        Gives every arrival stamp. Limits on the link are in the machine's own time.
    on_missed : callable, optional
        Called as ``on_missed(topic, n)`` from the reader thread when the frame numbers show that `n` more frames
        did not come; with -1 when one of them comes late after all.
    on_lost : callable, optional
        Called once, from the reader thread, when no frame has come for 1 s.
    """

    def __init__(
        self,
        config: TrackerConfig,
        clock: Clock,
        *,
        on_missed: Callable[[str, int], None] | None = None,
        on_lost: Callable[[BenchError], None] | None = None,
    ) -> None:
        self._clock = clock
        self._link = CommandLink(config, clock)
        self._on_missed = on_missed or (lambda _topic, _n: None)
        self._on_lost = on_lost or (lambda _error: None)
        self._lost_told = False
        self._silent = False
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._sink: RecordSink = lambda _record: None
        self._stream: FrameStream | None = None
        self._next_keepalive_ns = 0

    def open(self, sink: RecordSink) -> DeviceInfo:
        """Connect, ask what the tracker is, and start pushing into `sink`.

        Raises
        ------
        ConnectError
            No answer within 3 s, or no way to ask.
        ProtocolError
            The answer cannot be read, or is of a NatNet older than 3.0.
        DeviceStateError
            Positions are streamed in another unit than metres.
        """
        self._link.open()
        try:
            server = self._connect()
            bitstream = Bitstream(server.natnet_version)
            info = self._describe(server, bitstream, sink)
        except BaseException:
            self._link.close()
            raise
        self._stopping.clear()
        self._lost_told = self._silent = False
        self._sink = sink
        self._stream = FrameStream(self._link, self._clock, sink, bitstream, server.clock_hz, self._on_missed)
        self._thread = threading.Thread(target=self._run, name="natnet-reader", daemon=True)
        self._thread.start()
        return info

    def close(self) -> None:
        """Stop the reader thread, take leave of the tracker and close the socket. May be called twice."""
        self._stopping.set()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(JOIN_S)
        self._link.send(encode_packet(Message.DISCONNECT))
        self._link.close()

    def _connect(self) -> ServerInfo:
        request = encode_connect(ConnectRequest("bench", (0, 1), WANTED_VERSION, WANTED_VERSION))
        answer = self._link.ask(request, (Message.SERVERINFO,), tries=CONNECT_TRIES, wait_s=CONNECT_WAIT_S)
        if answer is None:
            raise ConnectError(
                f"The tracker at {self._link.name} does not answer: no NatNet server info within "
                f"{CONNECT_TRIES * CONNECT_WAIT_S:g} s.",
                hint="Is Motive running, its streaming enabled and set to Unicast on this network, and does its PC's "
                f"firewall let UDP port {self._link.name.rpartition(':')[2]} through?",
            )
        server = decode_server_info(answer[1])
        if server.natnet_version < OLDEST_VERSION or server.clock_hz == 0:
            raise ProtocolError(
                f"The tracker at {self._link.name} speaks NatNet {_dotted(server.natnet_version)}; 3.0 is the oldest "
                "that stamps its frames.",
                hint="Update to Motive 2.0 or newer.",
            )
        return server

    def _describe(self, server: ServerInfo, bitstream: Bitstream, sink: RecordSink) -> DeviceInfo:
        millimetres = self._ask_number("UnitsToMillimeters")
        if millimetres not in (None, METRES_TO_MILLIMETRES):
            raise DeviceStateError(
                f"The tracker at {self._link.name} streams positions in units of {millimetres:g} mm, not in metres.",
                hint="Set the streaming scale in Motive back to 1 (metres).",
            )
        rate_hz = self._ask_number("FrameRate")
        up_axis = self._ask_number("UpAxis", INTEGER)
        return DeviceInfo(
            device="tracker",
            kind="natnet",
            address=self._link.name,
            version=f"{server.name} {_dotted(server.app_version)}, NatNet {_dotted(server.natnet_version)}",
            rate_hz=float("nan") if rate_hz is None else rate_hz,
            bodies=self._ask_bodies(bitstream, sink),
            detail={
                "bitstream": _dotted(bitstream.version),
                "clock_hz": str(server.clock_hz),
                "local_address": self._link.local_address,
                "receive_buffer_bytes": str(self._link.receive_buffer_bytes),
                "stamped_by": self._link.stamped_by,
                "up_axis": UP_AXES.get(-1 if up_axis is None else int(up_axis), "unknown"),
                "version_chosen_by": "client" if server.natnet_version >= CHOOSING_SINCE else "server",
            },
        )

    def _ask_number(self, question: str, layout: Struct = FLOAT) -> float | None:
        answers = (Message.RESPONSE, Message.UNRECOGNIZED_REQUEST)
        answer = self._link.ask(encode_request(question), answers, tries=QUESTION_TRIES, wait_s=QUESTION_WAIT_S)
        if answer is None or answer[0] == Message.UNRECOGNIZED_REQUEST:
            return None
        return decode_number(answer[1], layout)

    def _ask_bodies(self, bitstream: Bitstream, sink: RecordSink) -> dict[int, str]:
        """Return the rigid bodies' names. A run without rigid bodies does not need them, so their lack is no error."""
        question = encode_packet(Message.REQUEST_MODELDEF)
        answer = self._link.ask(question, (Message.MODELDEF,), tries=QUESTION_TRIES, wait_s=QUESTION_WAIT_S)
        try:
            models = () if answer is None else bitstream.decode_models(answer[1])
            problem = "gave no model definitions." if answer is None else ""
        except ProtocolError as error:
            models, problem = (), f"gave model definitions that cannot be read: {error}"
        if problem:
            text = f"The tracker at {self._link.name} {problem}"
            sink(LogEntry(self._clock.now_ns(), Severity.WARN, "tracker", text))
        return {model.body_id: model.name for model in models if isinstance(model, RigidBodyModel)}

    def _run(self) -> None:
        try:
            self._read()
        except Exception as error:
            logger.exception("the reader of the tracker stopped")
            self._lose(f"The reader of the tracker at {self._link.name} stopped: {error!r}.")

    def _read(self) -> None:
        stream = self._stream
        if stream is None:
            return
        stream.start()
        while not self._stopping.is_set():
            received = self._link.receive()
            if received is not None:
                stream.take(*received)
            now_ns = self._clock.now_ns()
            self._keep_alive(now_ns)
            stream.keep_up(now_ns)
            self._watch_silence(stream, now_ns, is_idle=received is None)
        stream.finish()
        if remark := self._link.remark():
            self._sink(LogEntry(self._clock.now_ns(), Severity.INFO, "tracker", remark))

    def _keep_alive(self, now_ns: int) -> None:
        if now_ns >= self._next_keepalive_ns:
            self._next_keepalive_ns = now_ns + patience_ns(self._clock, KEEPALIVE_S)
            self._link.send(encode_packet(Message.KEEPALIVE))

    def _watch_silence(self, stream: FrameStream, now_ns: int, *, is_idle: bool) -> None:
        """Tell a silent tracker. While packets wait to be read, it is we who are late: then it takes twice as long."""
        limit_ns = patience_ns(self._clock, SILENCE_S if is_idle else 2 * SILENCE_S)
        silence_ns = now_ns - stream.newest_frame_ns
        if stream.is_dismissed or silence_ns > limit_ns:
            if not self._silent:
                self._silent = True
                self._lose(self._describe_silence(stream))
        elif self._silent:
            self._silent = False
            self._sink(LogEntry(now_ns, Severity.WARN, "tracker", "The tracker sends frames again."))

    def _describe_silence(self, stream: FrameStream) -> str:
        if stream.is_dismissed:
            return f"The tracker at {self._link.name} ended the connection."
        text = f"The tracker at {self._link.name} has sent no frame for {SILENCE_S:g} s"
        return text + (", though it answers." if stream.answers_since_frame > 0 else ", nor any answer.")

    def _lose(self, text: str) -> None:
        self._sink(LogEntry(self._clock.now_ns(), Severity.ERROR, "tracker", text))
        if not self._lost_told:
            self._lost_told = True
            self._on_lost(LinkLostError(text, hint="Check Motive's streaming, its PC and the network cable."))


def _dotted(version: Version) -> str:
    """Write a version without its trailing zeros, but with two numbers."""
    numbers = list(version)
    while len(numbers) > 2 and numbers[-1] == 0:
        numbers.pop()
    return ".".join(map(str, numbers))
