"""The state stream of a UR controller: every sample of it, in order, with the time it arrived.

A plain RTDE client that consumes the byte stream in order is the only kind that loses nothing; ur_rtde keeps the
newest sample only (it lost 0.9 to 67 % of a 500 Hz stream, see the decision records).
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from bench.config import RobotConfig
from bench.drivers.base import RecordSink
from bench.drivers.robot.ur.codec import PackageType
from bench.drivers.robot.ur.handshake import Session, start_session
from bench.drivers.robot.ur.link import RtdeLink
from bench.drivers.robot.ur.samples import SampleReader
from bench.errors import LinkLostError, ProtocolError
from bench.model import DeviceInfo, LogEntry, Severity
from bench.timing import Clock

__all__ = ["UrStateStream"]

logger = logging.getLogger(__name__)

SILENCE_S = 1.0
"""A controller sends at 125 to 500 Hz; stalls up to 0.4 s were survived on a busy machine, so 1 s is a lost link."""
LOST_HINT = "Look at the robot and its network cable; the cycle under way counts as interrupted."


class UrStateStream:
    """`StateStream` of a Universal Robots controller, by RTDE.

    Parameters
    ----------
    config : RobotConfig
        Address, rate and registers.
    clock : Clock
        Stamps arrivals; limits on the link are in the machine's own seconds.
    on_missed : callable, optional
        Called with the topic and the number of samples whenever the controller skipped some.
    on_lost : callable, optional
        Called once, from the reader thread, when the link is lost.
    connect_timeout_s : float
        Limit on connecting and on each answer: 3 s, which a controller that runs answers in milliseconds.
    """

    def __init__(
        self,
        config: RobotConfig,
        clock: Clock,
        *,
        on_missed: Callable[[str, int], None] | None = None,
        on_lost: Callable[[LinkLostError], None] | None = None,
        connect_timeout_s: float = 3.0,
        silence_s: float = SILENCE_S,
    ) -> None:
        self._config = config
        self._clock = clock
        self._on_missed = on_missed
        self._on_lost = on_lost
        self._connect_timeout_s = connect_timeout_s
        self._silence_s = silence_s
        self._send_lock = threading.Lock()
        self._link: RtdeLink | None = None
        self._session: Session | None = None
        self._thread: threading.Thread | None = None
        self._closing = False

    def open(self, sink: RecordSink) -> DeviceInfo:
        """Connect, set the recipes up and start pushing into `sink`; see `bench.drivers.base.StateStream`.

        The grant register keeps its value on the controller over a reconnect, so it is written 0 here.
        """
        if self._link is not None:
            raise LinkLostError(f"The state stream of {self._link.peer} is open already.")
        self._closing = False
        link = RtdeLink(self._config.host, self._config.rtde_port, self._clock, self._connect_timeout_s)
        try:
            session = start_session(link, self._config)
            reader = SampleReader(session, self._config.cycle, self._clock, sink, self._on_missed, peer=link.peer)
            link.set_timeout(self._silence_s)
            self._link, self._session = link, session
            self.grant_cycles(0)
        except BaseException:
            self._link = self._session = None
            link.close()
            raise
        self._thread = threading.Thread(target=self._read, args=(link, reader, sink), name="ur-state", daemon=True)
        self._thread.start()
        return self._describe(session)

    def _describe(self, session: Session) -> DeviceInfo:
        return DeviceInfo(
            device="robot",
            kind="ur",
            address=f"{self._config.host}:{self._config.rtde_port}",
            version=".".join(str(part) for part in session.version),
            rate_hz=session.rate_hz,
            detail={"recipe": ",".join(session.outputs.names), "left_out": ",".join(session.left_out)},
        )

    def grant_cycles(self, total: int) -> None:
        """Allow the program to have begun `total` cycles since it started.

        Raises
        ------
        LinkLostError
            The stream is not open, or the controller does not take it.
        """
        link, session = self._link, self._session
        if link is None or session is None:
            raise LinkLostError(
                f"Controller {self._config.host} cannot be granted a cycle: its state stream is not open."
            )
        try:
            with self._send_lock:
                link.send(PackageType.DATA, session.inputs.pack((total,)))
        except OSError as error:
            raise LinkLostError(f"The {link.peer} did not take the grant of cycle {total}.", hint=LOST_HINT) from error

    def close(self) -> None:
        """Stop the reader thread and close the connection. May be called twice, and after an error."""
        self._closing = True
        link, self._link, self._session = self._link, None, None
        if link is None:
            return
        link.interrupt()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()
        link.close()

    def _read(self, link: RtdeLink, reader: SampleReader, sink: RecordSink) -> None:
        """Body of the reader thread: until the link is closed, by us or by fate."""
        try:
            for arrival_ns, frame in link.take_waiting():
                reader.take(arrival_ns, [frame])
            while True:
                reader.take(*link.receive())
        except TimeoutError:
            error = LinkLostError(f"The {link.peer} sent nothing for {self._silence_s:g} s.", hint=LOST_HINT)
            self._report_lost(error, sink)
        except ProtocolError as fault:
            text = f"The {link.peer} is not understood any more: {fault.args[0]}"
            self._report_lost(LinkLostError(text, hint=LOST_HINT), sink)
        except LinkLostError as fault:
            self._report_lost(LinkLostError(fault.args[0], hint=LOST_HINT), sink)
        except Exception as fault:
            logger.exception("The reader of the %s failed", link.peer)
            self._report_lost(LinkLostError(f"The stream of the {link.peer} ended by a fault of bench: {fault}."), sink)
        finally:
            reader.finish()

    def _report_lost(self, error: LinkLostError, sink: RecordSink) -> None:
        if self._closing:
            return
        logger.info("%s", error)
        sink(LogEntry(self._clock.now_ns(), Severity.ERROR, "robot", str(error)))
        if self._on_lost is not None:
            self._on_lost(error)
