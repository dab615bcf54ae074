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
from bench.drivers.flight import FlightRecorder
from bench.drivers.robot.ur.codec import PackageType
from bench.drivers.robot.ur.handshake import Session, start_session
from bench.drivers.robot.ur.link import RtdeLink
from bench.drivers.robot.ur.samples import SampleReader
from bench.errors import BenchError, LinkLostError, ProtocolError
from bench.model import DeviceInfo, RobotState, Severity
from bench.timing import Clock, patience_ns

__all__ = ["UrStateStream"]

logger = logging.getLogger(__name__)

SILENCE_S = 1.0
"""A controller sends at 125 to 500 Hz; stalls up to 0.4 s were survived on a busy machine, so 1 s is a lost link."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 2.0
"""Between attempts to reconnect: doubled each time, as a controller that boots takes a minute to answer."""
LOST_HINT = "Look at the robot and its network cable; the cycle under way counts as interrupted."
NOT_RUNNING = (0, 1)
"""Runtime states of a program that is over: stopping, stopped."""


class UrStateStream:
    """`StateStream` of a Universal Robots controller, by RTDE.

    Parameters
    ----------
    config : RobotConfig
        Address, rate and registers.
    clock : Clock
        Stamps arrivals; limits on the link are in the machine's own seconds.
    on_missed : callable, optional
        Called with the topic and the number of samples whenever the controller skipped some, or a lost link did.
    on_lost : callable, optional
        Called once for each loss of the link, from the reader thread.
    on_restored : callable, optional
        Called once for each lost link that is back, from the reader thread: samples come again, cycles can be granted.
    reconnect_s : float
        How long to try to reconnect after each loss; 0: a loss is final. After it the loss is final too.
    connect_timeout_s : float
        Limit on connecting and on each answer: 3 s, which a controller that runs answers in milliseconds.
    silence_s : float
        A link that delivers nothing for so long is lost.
    flight : FlightRecorder, optional
        Keeps the last packets for the day on which the link ends badly.
    """

    def __init__(
        self,
        config: RobotConfig,
        clock: Clock,
        *,
        on_missed: Callable[[str, int], None] | None = None,
        on_lost: Callable[[LinkLostError], None] | None = None,
        on_restored: Callable[[], None] | None = None,
        reconnect_s: float = 0.0,
        connect_timeout_s: float = 3.0,
        silence_s: float = SILENCE_S,
        flight: FlightRecorder | None = None,
    ) -> None:
        self._config = config
        self._clock = clock
        self._on_missed = on_missed
        self._on_lost = on_lost
        self._on_restored = on_restored
        self._reconnect_s = reconnect_s
        self._connect_timeout_s = connect_timeout_s
        self._silence_s = silence_s
        self._flight = flight or FlightRecorder("robot", clock)
        self._lock = threading.Lock()
        self._link: RtdeLink | None = None
        self._session: Session | None = None
        """Set while cycles can be granted: not before the handshake, not over a lost link."""
        self._reader: SampleReader | None = None
        self._granted = self._granted_run = 0
        """The last grant, and `SampleReader.n_runs` as it was written."""
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()

    def open(self, sink: RecordSink) -> DeviceInfo:
        """Connect, set the recipes up and start pushing into `sink`; see `bench.drivers.base.StateStream`.

        The grant register keeps its value on the controller over a reconnect, so it is written 0 here.
        """
        if self._thread is not None:
            raise LinkLostError(f"The state stream of controller {self._config.host} is open already.")
        self._closing.clear()
        try:
            link, session, reader = self._start(sink)
        except ProtocolError as error:
            raise self._flight.keep(error) from error.__cause__
        self._thread = threading.Thread(target=self._run, args=(link, reader), name="ur-state", daemon=True)
        self._thread.start()
        return self._describe(session, link)

    def _start(self, sink: RecordSink) -> tuple[RtdeLink, Session, SampleReader]:
        link, session = self._connect(self._connect_timeout_s)
        try:
            reader = SampleReader(session, self._config.cycle, self._clock, sink, self._on_missed, peer=link.peer)
            self._reader, self._session = reader, session
            self.grant_cycles(0)
        except BaseException:
            self._drop(link)
            raise
        return link, session, reader

    def _describe(self, session: Session, link: RtdeLink) -> DeviceInfo:
        return DeviceInfo(
            device="robot",
            kind="ur",
            address=f"{self._config.host}:{self._config.rtde_port}",
            version=".".join(str(part) for part in session.version),
            rate_hz=session.rate_hz,
            detail={
                "recipe": ",".join(session.outputs.names),
                "left_out": ",".join(session.left_out),
                "stamped_by": link.stamps.stamped_by,
            },
        )

    def grant_cycles(self, total: int) -> None:
        """Allow the program to have begun `total` cycles since it started.

        Raises
        ------
        LinkLostError
            The stream is not open, its link is lost, or the controller does not take it.
        """
        with self._lock:
            link, session = self._link, self._session
            if link is None or session is None:
                reason = "its state stream is not open" if self._thread is None else "the link to it is lost"
                raise LinkLostError(f"Controller {self._config.host} cannot be granted a cycle: {reason}.")
            self._write_grant(link, session, total)

    def _write_grant(self, link: RtdeLink, session: Session, total: int) -> None:
        if session.inputs is None:
            return
        try:
            link.send(PackageType.DATA, session.inputs.pack((total,)))
        except OSError as error:
            raise LinkLostError(f"The {link.peer} did not take the grant of cycle {total}.", hint=LOST_HINT) from error
        self._granted = total
        self._granted_run = 0 if self._reader is None else self._reader.n_runs

    def close(self) -> None:
        """Stop the reader thread and close the connection. May be called twice, and after an error."""
        with self._lock:
            self._closing.set()
            self._session = None
            link, thread = self._link, self._thread
        if link is not None:
            link.interrupt()
        if thread is not None and thread is not threading.current_thread():
            thread.join()
        self._thread = None
        if link is not None:
            self._drop(link)

    def _connect(self, timeout_s: float) -> tuple[RtdeLink, Session]:
        link = RtdeLink(self._config.host, self._config.rtde_port, self._clock, timeout_s, self._flight)
        with self._lock:
            self._link = link
            if self._closing.is_set():
                link.interrupt()
        try:
            session = start_session(link, self._config)
            link.set_timeout(self._silence_s)
        except BaseException:
            self._drop(link)
            raise
        return link, session

    def _drop(self, link: RtdeLink) -> None:
        """Close a link; the controller releases the grant register, and nothing can be granted."""
        with self._lock:
            self._session = None
            if self._link is link:
                self._link = None
        link.close()

    def _run(self, link: RtdeLink, reader: SampleReader) -> None:
        """Body of the reader thread: until the stream is closed, or its link lost for good."""
        current: RtdeLink | None = link
        try:
            while current is not None:
                error = self._follow(current, reader)
                self._drop(current)
                reader.finish(current.stamps.remark())
                if error is None or self._closing.is_set():
                    return
                self._report_lost(error, reader)
                current = self._restore(reader)
        except Exception as fault:
            logger.exception("The reader of the %s failed", link.peer)
            self._report_lost(
                LinkLostError(f"The stream of the {link.peer} ended by a fault of bench: {fault}."), reader
            )

    def _follow(self, link: RtdeLink, reader: SampleReader) -> LinkLostError | None:
        """Read until the link is lost, and return how; None if the stream is closed."""
        try:
            self._read(link, reader, self._closing.is_set)
        except LinkLostError as error:
            return error
        return None

    def _read(self, link: RtdeLink, reader: SampleReader, is_enough: Callable[[], bool]) -> None:
        """Take what arrives until it is enough; `LinkLostError` when the link is lost."""
        try:
            for arrival_ns, frame in link.take_waiting():
                reader.take(arrival_ns, [frame])
            while not is_enough():
                arrival_ns, frames = link.receive()
                reader.take(arrival_ns, frames)
                if frames:
                    self._verify_fresh(arrival_ns, reader)
        except TimeoutError as fault:
            text = f"The {link.peer} sent nothing for {self._silence_s:g} s."
            raise LinkLostError(text, hint=LOST_HINT) from fault
        except ProtocolError as fault:
            text = f"The {link.peer} is not understood any more: {fault.args[0]}"
            raise LinkLostError(text, hint=LOST_HINT) from fault
        except LinkLostError as fault:
            raise LinkLostError(fault.args[0], hint=LOST_HINT) from fault

    def _verify_fresh(self, arrival_ns: int, reader: SampleReader) -> None:
        """Raise `TimeoutError` if the controller sends whatever else, but no samples."""
        if arrival_ns - reader.fresh_ns > patience_ns(self._clock, self._silence_s):
            raise TimeoutError

    def _report_lost(self, error: LinkLostError, reader: SampleReader) -> None:
        if self._closing.is_set():
            return
        reader.say(Severity.ERROR, str(self._flight.keep(error)))
        if self._on_lost is not None:
            self._on_lost(error)

    def _restore(self, reader: SampleReader) -> RtdeLink | None:
        """Connect again, as often as the limit allows; None if it cannot be, or the stream is closed."""
        lost_ns = self._clock.now_ns()
        deadline_ns = lost_ns + patience_ns(self._clock, self._reconnect_s)
        pause_s, last_reason = FIRST_PAUSE_S, ""
        while (left_s := (deadline_ns - self._clock.now_ns()) * 1e-9 / self._clock.speed) > 0.0:
            if self._closing.wait(min(pause_s, left_s)):
                return None
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)
            try:
                link = self._reconnect(reader, max(left_s, FIRST_PAUSE_S))
            except BenchError as error:
                last_reason = self._say_reason(str(error.args[0]), last_reason, reader)
                continue
            away_s = (self._clock.now_ns() - lost_ns) * 1e-9
            reader.say(Severity.INFO, f"The link to the {link.peer} is back after {away_s:.1f} s.")
            if self._on_restored is not None:
                self._on_restored()
            return link
        if self._reconnect_s > 0.0 and not self._closing.is_set():
            reader.say(Severity.ERROR, f"The link to the robot did not come back within {self._reconnect_s:g} s.")
        return None

    def _say_reason(self, reason: str, last_reason: str, reader: SampleReader) -> str:
        """Say why an attempt failed, once for each reason in a row."""
        if reason != last_reason and not self._closing.is_set():
            reader.say(Severity.WARN, reason)
        return reason

    def _reconnect(self, reader: SampleReader, left_s: float) -> RtdeLink:
        """Connect once, read the first sample and settle the grant by it.

        Raises
        ------
        BenchError
            The controller cannot be reached, refuses the recipe, or is lost again before it sends a sample.
        """
        link, session = self._connect(min(self._connect_timeout_s, left_s))
        try:
            before = reader.latest
            reader.resume(session)
            self._read(link, reader, lambda: reader.latest is not before)
            self._settle_grant(link, session, reader)
        except BaseException:
            self._drop(link)
            raise
        return link

    def _settle_grant(self, link: RtdeLink, session: Session, reader: SampleReader) -> None:
        """Write the grant again to the program run that had it, 0 to any other: that must not move unbidden."""
        with self._lock:
            is_kept = self._granted_run == reader.n_runs and _may_go_on(reader.latest, self._granted)
            if not is_kept and self._granted:
                text = f"The robot program is not the one that was granted {self._granted} cycles; it gets none."
                reader.say(Severity.WARN, text)
                self._granted = 0
            self._write_grant(link, session, self._granted)
            self._session = session


def _may_go_on(state: RobotState | None, granted: int) -> bool:
    return state is not None and state.runtime_state not in NOT_RUNNING and state.cycle_count <= granted
