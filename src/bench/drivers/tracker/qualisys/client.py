"""A Qualisys system, by `qtm_rt`: the one file that imports it.

The library belongs to an asyncio loop, so the loop runs in a thread of its own, which does nothing else.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from typing import TypeVar

from qtm_rt import QRTConnection
from qtm_rt.protocol import QRTCommandException, QTMProtocol

from bench.config import QualisysConfig
from bench.drivers.base import RecordSink
from bench.drivers.tracker.qualisys.settings import Settings, read_settings
from bench.drivers.tracker.qualisys.stream import TICKS_PER_S, FrameStream
from bench.errors import BenchError, ConnectError, LinkLostError, ProtocolError
from bench.model import DeviceInfo, LogEntry, Severity
from bench.timing import Clock, patience_ns

__all__ = ["QualisysTracker"]

logger = logging.getLogger(__name__)
Answer = TypeVar("Answer")
logging.getLogger("qtm_rt").addHandler(logging.NullHandler())  # what it logs, we raise as errors of our own

PROTOCOL_VERSION = "1.13"
"""QTM keeps every older version of its protocol; this one (2015) has all that is asked for here."""
COMPONENTS = ["3dres", "3dnolabelsres", "6dres"]
HEADER_BYTES = 8
LARGEST_BYTES = 1 << 24
"""Settings of a large system are some 100 kB, a frame of 1000 markers 20 kB."""
TIMEOUT_S = 3.0
"""Machine time for connecting and for each answer; QTM answers within milliseconds."""
SILENCE_S = 1.0
"""Machine time without a frame after which the link counts as lost: 100 frames at 100 Hz."""
LOOK_S = 0.05
"""How late silence, or the end of the reader, may be noticed."""
RETRY_S = 1.0
HINT = "Is QTM running, and its real-time output (Project options, Real-time output) on this port?"
LOST_HINT = "Check QTM's real-time output, its PC and the network cable."


class QualisysTracker:
    """A `TrackerStream` of Qualisys Track Manager.

    QTM's clock cannot be asked, so its time is mapped to host time by the arrivals, as a robot's is.

    Parameters
    ----------
    config : QualisysConfig
    clock : Clock
        Gives every arrival stamp. Limits on the link are in the machine's own time.
    on_missed : callable, optional
        Called as ``on_missed(topic, n)`` when the frame numbers show that `n` more frames did not come.
    on_lost : callable, optional
        Called once for each loss: no frame for 1 s, or the connection closed.
    """

    def __init__(
        self,
        config: QualisysConfig,
        clock: Clock,
        *,
        on_missed: Callable[[str, int], None] | None = None,
        on_lost: Callable[[BenchError], None] | None = None,
    ) -> None:
        self._config = config
        self._clock = clock
        self._on_missed = on_missed or (lambda _topic, _n: None)
        self._on_lost = on_lost or (lambda _error: None)
        self._name = f"{config.host}:{config.port}"
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()
        self._opened: Future[DeviceInfo] = Future()

    def open(self, sink: RecordSink) -> DeviceInfo:
        """Connect, ask what QTM is, and start pushing into `sink`.

        Raises
        ------
        ConnectError
            No connection or no answer within 3 s.
        ProtocolError
            What answers is not QTM.
        """
        self._closing.clear()
        self._opened = Future()
        self._thread = threading.Thread(target=self._run, args=(sink,), name="qualisys-reader", daemon=True)
        self._thread.start()
        return self._opened.result()

    def close(self) -> None:
        """Stop the reader thread and close the connection. May be called twice, and after an error."""
        self._closing.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()
        self._thread = None

    def _run(self, sink: RecordSink) -> None:
        try:
            asyncio.run(self._serve(sink))
        except Exception as error:
            logger.exception("the reader of the tracker stopped")
            fault = LinkLostError(f"The reader of the tracker at {self._name} stopped: {error!r}.")
            if not self._opened.done():
                self._opened.set_exception(fault)
            else:
                self._tell_loss(sink, fault)

    async def _serve(self, sink: RecordSink) -> None:
        """Body of the reader thread: connect, stream, and connect again for as long as the stream is open."""
        stream = FrameStream(self._clock, sink, self._on_missed)
        try:
            protocol, info = await self._connect(stream)
        except BenchError as error:
            self._opened.set_exception(error)
            return
        self._opened.set_result(info)
        while loss := await self._follow(protocol, stream):
            protocol.leave()
            self._tell_loss(sink, loss)
            restored = await self._restore(stream, sink)
            if restored is None:
                break
            protocol = restored
        protocol.leave()
        stream.finish()

    async def _connect(self, stream: FrameStream) -> tuple[_Protocol, DeviceInfo]:
        protocol = await self._reach()
        connection = QRTConnection(protocol, timeout=TIMEOUT_S)
        try:
            silent = f"The tracker at {self._name} accepts the connection but does not answer in {TIMEOUT_S:g} s."
            await self._in_time(protocol.set_version(PROTOCOL_VERSION), silent)
            info = await self._ask(connection)
            stream.begin()
            wanted = connection.stream_frames(components=COMPONENTS, on_packet=stream.take)
            await self._in_time(wanted, f"QTM at {self._name} does not begin to stream in {TIMEOUT_S:g} s.")
        except BaseException:
            protocol.leave()
            raise
        return protocol, info

    async def _reach(self) -> _Protocol:
        loop = asyncio.get_running_loop()
        try:
            link = loop.create_connection(lambda: _Protocol(loop=loop), self._config.host, self._config.port)
            _, protocol = await asyncio.wait_for(link, TIMEOUT_S)
        except TimeoutError as error:
            raise ConnectError(f"The tracker at {self._name} does not answer in {TIMEOUT_S:g} s.", hint=HINT) from error
        except OSError as error:
            reason = "refuses the connection" if isinstance(error, ConnectionRefusedError) else "cannot be reached"
            raise ConnectError(f"The tracker at {self._name} {reason}.", hint=HINT) from error
        return protocol

    async def _ask(self, connection: QRTConnection) -> DeviceInfo:
        late = f"QTM at {self._name} does not tell its settings in {TIMEOUT_S:g} s."
        version = await self._in_time(connection.qtm_version(), late)
        text = await self._in_time(connection.get_parameters(["general", "3d", "6d"]), late)
        return self._describe(version.decode(errors="replace"), read_settings(text))

    def _describe(self, version: str, settings: Settings) -> DeviceInfo:
        return DeviceInfo(
            device="tracker",
            kind="qualisys",
            address=self._name,
            version=version,
            rate_hz=settings.rate_hz,
            bodies=dict(enumerate(settings.bodies, start=1)),
            detail={
                "clock_hz": str(TICKS_PER_S),
                "labels": ",".join(settings.labels),
                "protocol": PROTOCOL_VERSION,
                "up_axis": settings.up_axis,
            },
        )

    async def _follow(self, protocol: _Protocol, stream: FrameStream) -> LinkLostError | None:
        """Wait while frames come; return how they ceased to, None if the stream is closed."""
        while not self._closing.is_set():
            await asyncio.sleep(LOOK_S)
            stream.keep_up()
            if protocol.is_over:
                return LinkLostError(f"QTM at {self._name} {protocol.ending}.", hint=LOST_HINT)
            if self._clock.now_ns() - stream.newest_frame_ns > patience_ns(self._clock, SILENCE_S):
                return LinkLostError(f"QTM at {self._name} has sent no frame for {SILENCE_S:g} s.", hint=LOST_HINT)
        return None

    def _tell_loss(self, sink: RecordSink, error: LinkLostError) -> None:
        if self._closing.is_set():
            return
        sink(LogEntry(self._clock.now_ns(), Severity.ERROR, "tracker", str(error.args[0])))
        self._on_lost(error)

    async def _restore(self, stream: FrameStream, sink: RecordSink) -> _Protocol | None:
        """Connect again until a frame comes; None if the stream is closed."""
        told = ""
        while not self._closing.is_set():
            try:
                protocol, _ = await self._connect(stream)
            except BenchError as error:
                if str(error) != told:
                    told = str(error)
                    sink(LogEntry(self._clock.now_ns(), Severity.WARN, "tracker", told))
            else:
                if await self._first_frame(stream):
                    sink(LogEntry(self._clock.now_ns(), Severity.WARN, "tracker", "The tracker sends frames again."))
                    return protocol
                protocol.leave()
            await asyncio.sleep(RETRY_S)
        return None

    async def _first_frame(self, stream: FrameStream) -> bool:
        deadline_ns = self._clock.now_ns() + patience_ns(self._clock, SILENCE_S)
        while not stream.has_frame and not self._closing.is_set() and self._clock.now_ns() < deadline_ns:
            await asyncio.sleep(LOOK_S)
        return bool(stream.has_frame)

    async def _in_time(self, work: Awaitable[Answer], sentence: str) -> Answer:
        """Wait for an answer of QTM; `ConnectError` with `sentence` if there is none, or with QTM's own refusal."""
        try:
            return await asyncio.wait_for(work, TIMEOUT_S)
        except TimeoutError as error:
            raise ConnectError(sentence, hint=HINT) from error
        except QRTCommandException as error:
            raise ConnectError(f"QTM at {self._name} refuses: {error.value}.", hint=HINT) from error


class _Protocol(QTMProtocol):  # type: ignore[misc]  # the library has no types
    """The library's protocol, ending the connection over bytes that are none of QTM's.

    The library itself raises, and goes round for ever over a packet that says it has no bytes.
    """

    def __init__(self, *, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(loop=loop)
        self._waiting = b""
        self.is_over = False
        self.ending = "closed the connection"

    def data_received(self, data: bytes) -> None:
        self._waiting += data
        try:
            while size := _whole_packet(self._waiting):
                packet, self._waiting = self._waiting[:size], self._waiting[size:]
                super().data_received(packet)
        except Exception as error:
            self.ending = f"is not understood any more ({error})"
            self.leave()

    def connection_lost(self, reason: Exception | None) -> None:
        self.is_over = True
        super().connection_lost(reason)

    def leave(self) -> None:
        """Close the connection. May be called twice."""
        if self.transport is not None:
            self.transport.close()


def _whole_packet(data: bytes) -> int:
    """Return the size of the first packet; 0 while it is not complete. `ProtocolError` if it cannot be one."""
    if len(data) < HEADER_BYTES:
        return 0
    size = int.from_bytes(data[:4], "little")
    if not HEADER_BYTES <= size <= LARGEST_BYTES:
        raise ProtocolError(f"a packet of {size} bytes was announced")
    return size if len(data) >= size else 0
