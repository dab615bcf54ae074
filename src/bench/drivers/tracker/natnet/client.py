"""NatNet: every frame, every clock echo, from a reader thread of our own, and a way back to a tracker that was lost."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from bench.config import TrackerConfig
from bench.drivers.base import RecordSink
from bench.drivers.flight import FlightRecorder
from bench.drivers.receive import KERNEL
from bench.drivers.tracker.natnet.handshake import CONNECT, begin_streaming, connect, describe, name_software
from bench.drivers.tracker.natnet.link import LONGEST_WAIT_S, CommandLink
from bench.drivers.tracker.natnet.messages import ServerInfo
from bench.drivers.tracker.natnet.stream import FrameStream
from bench.drivers.tracker.natnet.wire import Message, encode_packet
from bench.errors import BenchError, LinkLostError, ProtocolError
from bench.model import DeviceInfo, LogEntry, Severity
from bench.timing import Clock, patience_ns

__all__ = ["NatNetTracker"]

logger = logging.getLogger(__name__)

KEEPALIVE_S = 1.0
"""Machine time; Motive drops a unicast client that it has not heard for some seconds."""
SILENCE_S = 1.0
"""Machine time without a frame after which the link counts as lost: 100 frames at 100 Hz."""
RECONNECT_S = 1.0
"""Machine time between two attempts to meet a lost tracker again."""
CHORES_S = 0.02
"""Machine time between two looks at what else is due, so that they do not cost something for each frame."""
GATHERING_S = 0.02
"""Machine time; nobody waits for a frame. Of 360 a second, seven come meanwhile: after a sleep the first costs 0.1 ms,
each that follows at once 0.02 ms (measured 2026-11)."""
JOIN_S = 2.0


class NatNetTracker:
    """A `TrackerStream` of OptiTrack Motive (NatNet 2.9 and newer), unicast or multicast.

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
    flight : FlightRecorder, optional
        Keeps the last packets for the day on which the tracker falls silent or is not understood.
    """

    def __init__(
        self,
        config: TrackerConfig,
        clock: Clock,
        *,
        on_missed: Callable[[str, int], None] | None = None,
        on_lost: Callable[[BenchError], None] | None = None,
        flight: FlightRecorder | None = None,
    ) -> None:
        self._config = config
        self._clock = clock
        self._flight = flight or FlightRecorder("tracker", clock)
        self._link = CommandLink(config, clock, self._flight)
        self._on_missed = on_missed or (lambda _topic, _n: None)
        self._on_lost = on_lost or (lambda _error: None)
        self._lost_told = False
        self._silent = False
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._sink: RecordSink = lambda _record: None
        self._stream: FrameStream | None = None
        self._server: ServerInfo | None = None
        self._refused: ServerInfo | None = None
        self._next_chores_ns = 0
        self._next_keepalive_ns = 0
        self._next_connect_ns = 0

    def open(self, sink: RecordSink) -> DeviceInfo:
        """Connect, ask what the tracker is, and start pushing into `sink`.

        Raises
        ------
        ConnectError
            No answer within 3 s, or no way to ask.
        ProtocolError
            The answer cannot be read, or is of a NatNet older than 2.9.
        DeviceStateError
            Positions are streamed in another unit than metres, or not in the way that the configuration asks for.
        """
        self._link.open()
        try:
            server = connect(self._link, self._config)
            bitstream = begin_streaming(server, self._link, self._config)
            info = describe(self._link, server, bitstream, sink, self._clock)
        except BaseException as error:
            self._link.close()
            if isinstance(error, ProtocolError):
                self._flight.keep(error)
            raise
        self._stopping.clear()
        self._lost_told = self._silent = False
        self._sink, self._server = sink, server
        self._stream = FrameStream(
            self._link, self._clock, sink, bitstream, server.clock_hz, self._on_missed, keep_packets=self._flight.write
        )
        self._stream.on_server = self._meet_again
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
        wait_s = LONGEST_WAIT_S
        while not self._stopping.is_set():
            received = self._link.receive(wait_s)
            if received is not None:
                stream.take(*received)
            now_ns = self._clock.now_ns()
            if received is None or now_ns >= self._next_chores_ns:
                self._next_chores_ns = now_ns + patience_ns(self._clock, CHORES_S)
                self._keep_alive(now_ns)
                stream.keep_up(now_ns)
                self._watch_silence(stream, now_ns, is_idle=received is None)
            wait_s = self._let_packets_gather(now_ns, is_idle=received is None, has_waited=wait_s > 0.0)
        stream.finish()
        if remark := self._link.remark():
            self._say(Severity.INFO, remark)

    def _let_packets_gather(self, now_ns: int, *, is_idle: bool, has_waited: bool) -> float:
        """Where the kernel stamps arrivals, read what came in a moment at once, and return how long to wait for more.

        Most of what a frame costs is waking up for it: Python's own memory has to come back to the processor's.
        """
        if self._link.stamped_by != KERNEL:
            return LONGEST_WAIT_S
        if is_idle and not has_waited:
            self._clock.sleep_until_ns(now_ns + patience_ns(self._clock, GATHERING_S))
            return LONGEST_WAIT_S
        return LONGEST_WAIT_S if is_idle else 0.0

    def _keep_alive(self, now_ns: int) -> None:
        if now_ns >= self._next_keepalive_ns:
            self._next_keepalive_ns = now_ns + patience_ns(self._clock, KEEPALIVE_S)
            self._link.send(encode_packet(Message.KEEPALIVE))

    def _watch_silence(self, stream: FrameStream, now_ns: int, *, is_idle: bool) -> None:
        """Tell a silent tracker. While packets wait to be read, it is we who are late: then it takes twice as long."""
        limit_ns = patience_ns(self._clock, SILENCE_S if is_idle else 2 * SILENCE_S)
        if stream.is_dismissed or now_ns - stream.newest_frame_ns > limit_ns:
            if not self._silent:
                self._silent = True
                self._lose(self._describe_silence(stream))
            self._try_to_connect(now_ns)
        elif self._silent:
            self._silent = False
            self._say(Severity.WARN, "The tracker sends frames again.")

    def _try_to_connect(self, now_ns: int) -> None:
        if now_ns >= self._next_connect_ns:
            self._next_connect_ns = now_ns + patience_ns(self._clock, RECONNECT_S)
            self._link.send(CONNECT)

    def _meet_again(self, server: ServerInfo) -> None:
        """Go on with a tracker that answers after it was lost: as it was, or changed meanwhile."""
        stream, before = self._stream, self._server
        if stream is None or before is None or not self._silent or server == self._refused:
            return
        bitstream = None
        try:
            if server != before:
                bitstream = begin_streaming(server, self._link, self._config)
                self._say(Severity.WARN, f"The tracker is {name_software(server)} now; it was {name_software(before)}.")
        except BenchError as error:
            self._refused = server
            self._say(Severity.ERROR, str(error))
            return
        self._server, self._refused = server, None
        stream.go_on(bitstream, server.clock_hz)

    def _describe_silence(self, stream: FrameStream) -> str:
        if stream.is_dismissed:
            return f"The tracker at {self._link.name} ended the connection."
        text = f"The tracker at {self._link.name} has sent no frame for {SILENCE_S:g} s"
        return text + (", though it answers." if stream.answers_since_frame > 0 else ", nor any answer.")

    def _lose(self, text: str) -> None:
        text = f"{text} {self._flight.write(text)}".rstrip()
        self._say(Severity.ERROR, text)
        if not self._lost_told:
            self._lost_told = True
            self._on_lost(LinkLostError(text, hint="Check Motive's streaming, its PC and the network cable."))

    def _say(self, severity: Severity, text: str) -> None:
        self._sink(LogEntry(self._clock.now_ns(), severity, "tracker", text))
