"""From data packages to `RobotState`: stamps, sequence, gaps and controller restarts."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from bench.config import CycleConfig
from bench.drivers.base import RecordSink
from bench.drivers.robot.ur.codec import Frame, PackageType, TextMessage, decode_text
from bench.drivers.robot.ur.fields import make_picker
from bench.drivers.robot.ur.handshake import Session
from bench.errors import ProtocolError
from bench.model import LogEntry, RobotState, Severity
from bench.timing import Clock, MinimumDelayFilter

__all__ = ["TOPIC", "SampleReader"]

logger = logging.getLogger(__name__)

TOPIC = "/robot/state"
NS_PER_S = 1e9
GAP_LOG_PERIOD_NS = 1_000_000_000
"""A controller that skips all the time would fill the log: one sentence a second, with the sum."""
SEVERITIES = {0: Severity.ERROR, 1: Severity.ERROR, 2: Severity.WARN, 3: Severity.INFO}


class SampleReader:
    """Decodes frames and pushes records; belongs to the reader thread.

    Parameters
    ----------
    session : Session
        What was agreed with the controller.
    cycle : CycleConfig
        The registers that tell the cycles.
    clock : Clock
        Stamps log entries.
    sink : RecordSink
        Where the records go.
    on_missed : callable or None
        Called with the topic and the number of samples the controller skipped.
    peer : str
        The controller, for messages.

    Raises
    ------
    ProtocolError
        The controller gives a field another width than its guide says.
    """

    def __init__(
        self,
        session: Session,
        cycle: CycleConfig,
        clock: Clock,
        sink: RecordSink,
        on_missed: Callable[[str, int], None] | None = None,
        *,
        peer: str = "controller",
    ) -> None:
        self._recipe = session.outputs
        self._rate_hz = session.rate_hz
        self._clock = clock
        self._sink = sink
        self._on_missed = on_missed
        self._peer = peer
        try:
            self._pick = make_picker(session.outputs, cycle)
        except ValueError as error:
            raise ProtocolError(
                f"The {peer} is not understood: it {error}.", hint="Its software is one bench does not know."
            ) from error
        self._filter = MinimumDelayFilter(1.0)
        self._segment = 0
        self._last_sequence: int | None = None
        self._gaps = _GapLog(self._say)
        if session.left_out:
            self._say(Severity.WARN, f"The {peer} does not give {', '.join(session.left_out)}; left out.")

    def take(self, arrival_ns: int, frames: Sequence[Frame]) -> None:
        """Decode the frames that arrived together and push what they hold.

        Raises
        ------
        ProtocolError
            A data package does not fit the recipe.
        """
        for kind, payload in frames:
            if kind == PackageType.DATA:
                self._sink(self._decode(arrival_ns, payload))
            elif kind == PackageType.TEXT:
                self._push_text(payload)

    def finish(self) -> None:
        """Say what is still unsaid; the stream has ended."""
        self._gaps.flush()

    def _decode(self, arrival_ns: int, payload: bytes) -> RobotState:
        time_s, *values = self._pick(self._recipe.unpack(payload))
        try:
            sequence = round(time_s * self._rate_hz)
        except (ValueError, OverflowError) as error:
            raise ProtocolError(f"the controller time {time_s} arrived, which is none.") from error
        if sequence - 1 != self._last_sequence and self._last_sequence is not None:
            self._note_break(arrival_ns, sequence, time_s)
        self._last_sequence = sequence
        capture_ns = self._filter.update(round(time_s * NS_PER_S), arrival_ns)
        return RobotState(arrival_ns, capture_ns, sequence, self._segment, time_s, *values)

    def _note_break(self, arrival_ns: int, sequence: int, time_s: float) -> None:
        """Tell a gap from a restart of the controller, whose time begins again near 0."""
        last = self._last_sequence or 0
        if sequence < last:
            self._segment += 1
            self._filter.reset()
            self._say(
                Severity.WARN,
                f"The {self._peer} restarted: its time fell from {last / self._rate_hz:.3f} s to {time_s:.3f} s.",
            )
        elif sequence > last + 1:
            missed = sequence - last - 1
            self._gaps.add(arrival_ns, missed, time_s)
            if self._on_missed is not None:
                self._on_missed(TOPIC, missed)

    def _push_text(self, payload: bytes) -> None:
        try:
            message = decode_text(payload)
        except ProtocolError:
            message = TextMessage(f"unreadable text {payload.hex()}", "", 2)
        source = f"{message.source}: " if message.source else ""
        self._say(SEVERITIES.get(message.level, Severity.INFO), f"The {self._peer} says: {source}{message.text}")

    def _say(self, severity: Severity, text: str) -> None:
        logger.info("%s", text)
        self._sink(LogEntry(self._clock.now_ns(), severity, "robot", text))


class _GapLog:
    """Writes the first gap at once and sums up those that follow within a second."""

    def __init__(self, say: Callable[[Severity, str], None]) -> None:
        self._say = say
        self._said_ns: int | None = None
        self._pending = 0
        self._time_s = 0.0

    def add(self, arrival_ns: int, missed: int, time_s: float) -> None:
        self._pending += missed
        self._time_s = time_s
        if self._said_ns is None or arrival_ns - self._said_ns >= GAP_LOG_PERIOD_NS:
            self._said_ns = arrival_ns
            self.flush()

    def flush(self) -> None:
        if self._pending:
            text = f"{self._pending} samples never came, the last before controller time {self._time_s:.3f} s."
            self._say(Severity.WARN, text)
            self._pending = 0
