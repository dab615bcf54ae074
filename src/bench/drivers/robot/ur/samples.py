"""From data packages to `RobotState`: stamps, sequence, gaps and controller restarts."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from bench.config import CycleConfig
from bench.drivers.base import RecordSink
from bench.drivers.robot.ur.codec import Frame, PackageType, TextMessage, decode_text
from bench.drivers.robot.ur.fields import make_picker
from bench.drivers.robot.ur.handshake import Session
from bench.drivers.robot.ur.versions import find_since
from bench.errors import ProtocolError
from bench.model import LogEntry, RobotState, Severity
from bench.timing import Clock, MinimumDelayFilter, patience_ns

__all__ = ["TOPIC", "SampleReader"]

logger = logging.getLogger(__name__)

TOPIC = "/robot/state"
NS_PER_S = 1e9
GAP_LOG_PERIOD_NS = 1_000_000_000
"""A controller that skips all the time would fill the log: one sentence a second, with the sum."""
SAME_CLOCK_S = 2.0
"""Over a break our clock and the controller's agree to its delays, which are below a second; if they do not, it
restarted meanwhile."""
LONGEST_TIME_S = 1e9
"""No controller has been on for 32 years."""
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
        self._cycle = cycle
        self._clock = clock
        self._sink = sink
        self._on_missed = on_missed
        self._peer = peer
        self._filter = MinimumDelayFilter(1.0)
        self._segment = 0
        self._is_resuming = False
        self._gaps = _GapLog(self.say)
        self.latest: RobotState | None = None
        """The newest sample, None before the first."""
        self.fresh_ns = clock.now_ns()
        """When the newest sample arrived, or the connection began."""
        self.n_runs = 0
        """How often the controller or its program began anew: what was granted before holds no more."""
        self._agree(session)

    def _agree(self, session: Session) -> None:
        self._recipe = session.outputs
        self._rate_hz = session.rate_hz
        try:
            self._pick = make_picker(session.outputs, self._cycle)
        except ValueError as error:
            raise ProtocolError(
                f"The {self._peer} is not understood: it {error}.", hint="Its software is one bench does not know."
            ) from error
        self._say_left_out(session)

    def _say_left_out(self, session: Session) -> None:
        """Tell what an old version explains from what nothing does."""
        since = {name: find_since(name, session.version) for name in session.left_out}
        too_new = ", ".join(f"{name} (since {version})" for name, version in since.items() if version)
        refused = ", ".join(name for name, version in since.items() if not version)
        if too_new:
            version = ".".join(map(str, session.version[:3]))
            self.say(Severity.INFO, f"The {self._peer} has software {version}, too old for {too_new}; left out.")
        if refused:
            self.say(Severity.WARN, f"The {self._peer} does not give {refused}; left out.")

    def resume(self, session: Session) -> None:
        """Go on over another connection, in a clock segment of its own. `ProtocolError` as at the beginning."""
        self._agree(session)
        self._segment += 1
        self._filter.reset()
        self._is_resuming = True
        self.fresh_ns = self._clock.now_ns()

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

    def finish(self, remark: str = "") -> None:
        """Say what is still unsaid, and a remark on the link if there is one; its stream has ended."""
        self._gaps.flush()
        if remark:
            self.say(Severity.INFO, remark)

    def _decode(self, arrival_ns: int, payload: bytes) -> RobotState:
        time_s, *values = self._pick(self._recipe.unpack(payload))
        if not 0.0 <= time_s <= LONGEST_TIME_S:
            raise ProtocolError(f"the controller time {time_s} arrived, which is none.")
        sequence = round(time_s * self._rate_hz)
        latest = self.latest
        if latest is not None and (sequence - 1 != latest.sequence or self._is_resuming):
            self._note_break(latest, arrival_ns, sequence, time_s)
        self._is_resuming = False
        capture_ns = self._filter.update(round(time_s * NS_PER_S), arrival_ns)
        state = RobotState(arrival_ns, capture_ns, sequence, self._segment, time_s, *values)
        if latest is not None and state.cycle_count < latest.cycle_count:
            self._note_new_program(latest, state)
        self.latest = state
        self.fresh_ns = arrival_ns
        return state

    def _note_break(self, latest: RobotState, arrival_ns: int, sequence: int, time_s: float) -> None:
        """Tell a gap from a restart of the controller, whose time begins again near 0."""
        is_restart = sequence < latest.sequence
        if self._is_resuming:
            is_restart = not _is_same_clock(latest, time_s, arrival_ns, self._clock)
        if is_restart:
            self._note_restart(latest, time_s)
        elif sequence > latest.sequence + 1:
            missed = sequence - latest.sequence - 1
            self._gaps.add(arrival_ns, missed, time_s)
            if self._on_missed is not None:
                self._on_missed(TOPIC, missed)

    def _note_restart(self, latest: RobotState, time_s: float) -> None:
        self.n_runs += 1
        if not self._is_resuming:
            self._segment += 1
            self._filter.reset()
        self.say(
            Severity.WARN,
            f"The {self._peer} restarted: its time went from {latest.controller_time_s:.3f} s to {time_s:.3f} s.",
        )

    def _note_new_program(self, latest: RobotState, state: RobotState) -> None:
        self.n_runs += 1
        self.say(
            Severity.INFO,
            f"The robot program began anew at controller time {state.controller_time_s:.3f} s: "
            f"its counter went from {latest.cycle_count} to {state.cycle_count}.",
        )

    def _push_text(self, payload: bytes) -> None:
        try:
            message = decode_text(payload)
        except ProtocolError:
            message = TextMessage(f"unreadable text {payload.hex()}", "", 2)
        source = f"{message.source}: " if message.source else ""
        self.say(SEVERITIES.get(message.level, Severity.INFO), f"The {self._peer} says: {source}{message.text}")

    def say(self, severity: Severity, text: str) -> None:
        """Log a sentence and push it as a record of the robot's."""
        logger.info("%s", text)
        self._sink(LogEntry(self._clock.now_ns(), severity, "robot", text))


def _is_same_clock(before: RobotState, time_s: float, arrival_ns: int, clock: Clock) -> bool:
    """Whether a controller's clock ran on since `before`, over a break; false: the controller restarted meanwhile.

    Parameters
    ----------
    before : RobotState
        The last sample before the break.
    time_s, arrival_ns : float, int
        Controller time and arrival of the first sample after it.
    clock : Clock
        Of the arrivals.
    """
    passed_ns = (time_s - before.controller_time_s) * NS_PER_S
    differs_ns = abs(passed_ns - (arrival_ns - before.arrival_ns))
    return passed_ns >= 0.0 and differs_ns <= patience_ns(clock, SAME_CLOCK_S)


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
