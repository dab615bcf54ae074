"""The state stream of a Modbus controller: it has to be asked, so bench asks it on a fixed grid of time."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from bench.config import ModbusRobotConfig
from bench.drivers.base import RecordSink
from bench.drivers.flight import FlightRecorder
from bench.drivers.robot.modbus.heartbeat import Beater, BeatWatch
from bench.drivers.robot.modbus.link import ModbusLink
from bench.drivers.robot.modbus.samples import SampleMaker, read_signals
from bench.drivers.robot.modbus.signals import SignalReader, write_signal
from bench.errors import DeviceError, DeviceStateError, DeviceTimeoutError, LinkLostError, ProtocolError
from bench.model import DeviceInfo, LogEntry, Severity
from bench.timing import Clock, patience_ns

__all__ = ["ModbusStateStream"]

logger = logging.getLogger(__name__)

TOPIC = "/robot/state"
FAILED_PAUSE_S = 0.1
"""Machine time before a controller that failed is asked again: it may be starting."""
MOST_BEHIND = 25
"""Polls that are made up for after a stall of this machine, so that the rate holds; beyond it they are left out."""
LOG_PERIOD_S = 1.0
LOST_HINT = "Look at the controller and its network cable; the cycle under way counts as interrupted."


class ModbusStateStream:
    """`StateStream` of a controller with a Modbus TCP server.

    A poll that fails is a missed sample and a line in the log. A connection that breaks is made again with the next
    poll; a link without a good answer for `[robot] silence_s` is lost.

    Parameters
    ----------
    config : ModbusRobotConfig
        Address and register map.
    clock : Clock
        Paces the polls and stamps them; limits on the link are in the machine's own seconds.
    on_missed : callable, optional
        Called with the topic and the number of polls that were not answered with a state.
    on_lost : callable, optional
        Called once for each loss of the link or of the controller's heartbeat, from the polling thread.
    on_restored : callable, optional
        Called once for each loss that is over, from the polling thread.
    reconnect_s : float
        How long to go on polling after a loss; 0: a loss is final.
    flight : FlightRecorder, optional
        Keeps the last packets for the day on which the link ends badly.
    """

    def __init__(
        self,
        config: ModbusRobotConfig,
        clock: Clock,
        *,
        on_missed: Callable[[str, int], None] | None = None,
        on_lost: Callable[[LinkLostError], None] | None = None,
        on_restored: Callable[[], None] | None = None,
        reconnect_s: float = 0.0,
        flight: FlightRecorder | None = None,
    ) -> None:
        self._config = config
        self._clock = clock
        self._on_missed = on_missed
        self._on_lost = on_lost
        self._on_restored = on_restored
        self._reconnect_s = reconnect_s
        self._flight = flight or FlightRecorder("robot", clock)
        self._link = ModbusLink(config, self._flight.trace)
        self._reader = SignalReader(config.map, read_signals(config.map))
        out, back = config.map.heartbeat_out, config.map.heartbeat_in
        self._beater = Beater(out, config.map, clock) if out and not config.observe_only else None
        self._beats = BeatWatch(back, clock) if back else None
        self._maker: SampleMaker | None = None
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()
        self._sink: RecordSink = _nowhere
        self._good_ns = self._lost_ns = self._said_ns = 0
        self._said = ""
        self._good_number = -1
        self._is_lost = self._was_silent = False

    def open(self, sink: RecordSink) -> DeviceInfo:
        """Connect, read everything once and start polling into `sink`; see `bench.drivers.base.StateStream`.

        The controller keeps the grants of the last run, so they are withdrawn here.
        """
        if self._thread is not None:
            raise LinkLostError(f"The state stream of the {self._link.peer} is open already.")
        self._closing.clear()
        self._sink = sink
        try:
            self._link.connect()
            origin_ns = self._clock.now_ns()
            self._maker = SampleMaker(self._config.map, self._link.peer, sink, origin_ns)
            self._maker.make(self._reader.read(self._link, self._clock), 0)
            if not self._config.observe_only:
                self._write_grant(self._maker, 0)
        except BaseException as error:
            self._link.close()
            if isinstance(error, ProtocolError | DeviceTimeoutError | LinkLostError):
                self._flight.keep(error)
            raise
        self._good_ns, self._good_number = self._clock.now_ns(), -1
        arguments = (self._maker, origin_ns)
        self._thread = threading.Thread(target=self._run, args=arguments, name="modbus-state", daemon=True)
        self._thread.start()
        return self._describe()

    def _describe(self) -> DeviceInfo:
        config = self._config
        detail = {
            "requests": ", ".join(str(block) for block in self._reader.blocks),
            "signals": ", ".join(config.map.signals),
            "cycle_accuracy_s": f"{1.0 / config.poll_rate_hz:g}",
            "observe_only": str(config.observe_only).lower(),
        }
        if config.map.heartbeat_out is not None:
            detail["heartbeat_promise"] = config.map.heartbeat_out.promise
        return DeviceInfo("robot", "modbus", f"{config.host}:{config.port}", rate_hz=config.poll_rate_hz, detail=detail)

    def grant_cycles(self, total: int) -> None:
        """Allow the program to have begun `total` cycles since it started.

        0 withdraws all grants, after a loss that is final too, should the controller still listen.

        Raises
        ------
        LinkLostError
            The stream is not open, its link is lost, or the controller does not take it.
        DeviceStateError
            bench only observes.
        """
        if self._config.observe_only:
            raise DeviceStateError(
                f"The {self._link.peer} is only observed: no cycle can be granted.", hint="See [robot] observe_only."
            )
        maker, thread = self._maker, self._thread
        is_withdrawn = total == 0  # which must be tried even where nobody watches any more
        if maker is None or thread is None or not (thread.is_alive() or is_withdrawn):
            raise LinkLostError(f"The {self._link.peer} cannot be granted a cycle: its state stream is not open.")
        try:
            self._write_grant(maker, total)
        except DeviceError as error:
            raise LinkLostError(
                f"The {self._link.peer} did not take the grant of cycle {total}: {error.args[0]}", hint=LOST_HINT
            ) from error

    def _write_grant(self, maker: SampleMaker, total: int) -> None:
        grant = self._config.map.grant
        if total == 0:
            maker.count_from_here()
        if grant is not None:
            write_signal(self._link, self._config.map, grant, maker.grant_value(total))

    def close(self) -> None:
        """Stop polling and close the connection. May be called twice, and after an error."""
        self._closing.set()
        thread, self._thread = self._thread, None
        if thread is not None and thread is not threading.current_thread():
            thread.join()
        self._link.close()

    def _run(self, maker: SampleMaker, origin_ns: int) -> None:
        """Body of the polling thread: until closed, or until a loss is final."""
        period_ns, slot, number = 1e9 / self._config.poll_rate_hz, 0, 0
        try:
            while not self._closing.is_set():
                self._clock.sleep_until_ns(origin_ns + round(slot * period_ns))
                if not self._closing.is_set() and not self._poll(maker, number):
                    return
                due = (self._clock.now_ns() - origin_ns) / period_ns
                slot = max(slot + 1, int(due) - MOST_BEHIND)
                number += 1
        except Exception as fault:
            logger.exception("Polling the %s failed", self._link.peer)
            text = f"The polling of the {self._link.peer} ended by a fault of bench: {fault}."
            self._report_lost(LinkLostError(text))

    def _poll(self, maker: SampleMaker, number: int) -> bool:
        """Ask once. False when the link is lost for good."""
        trouble: DeviceError | None = None
        try:
            reading = self._reader.read(self._link, self._clock)
            if self._beater is not None:
                self._beater.beat(self._link)
        except DeviceError as error:
            trouble = error
            self._say_trouble(error)
            pause_ns = patience_ns(self._clock, FAILED_PAUSE_S)
            self._clock.sleep_until_ns(self._clock.now_ns() + pause_ns)
        else:
            if self._was_silent:
                maker.reconnected()
            self._was_silent = False
            self._good_ns = reading.after_ns
            if self._beats is not None:
                self._beats.take(reading.raw["heartbeat_in"])
            self._sink(maker.make(reading, number))
            self._count_missed(number)
        return self._judge(trouble)

    def _count_missed(self, number: int) -> None:
        missed, self._good_number = number - self._good_number - 1, number
        if missed and self._on_missed is not None:
            self._on_missed(TOPIC, missed)

    def _judge(self, trouble: DeviceError | None) -> bool:
        loss = self._find_loss(trouble)
        now_ns = self._clock.now_ns()
        if loss is not None and not self._is_lost:
            self._is_lost, self._lost_ns = True, now_ns
            self._report_lost(loss)
        elif loss is None and self._is_lost:
            self._is_lost = False
            self._log(Severity.INFO, f"The {self._link.peer} is back.")
            if self._on_restored is not None:
                self._on_restored()
        return not (self._is_lost and now_ns - self._lost_ns >= patience_ns(self._clock, self._reconnect_s))

    def _find_loss(self, trouble: DeviceError | None) -> LinkLostError | None:
        if trouble is not None:  # whether the heart beats cannot be told then
            if self._clock.now_ns() - self._good_ns <= patience_ns(self._clock, self._longest_silence_s):
                return None
            self._was_silent = True
            text = f"The {self._link.peer} gave no state for {self._longest_silence_s:g} s. {trouble.args[0]}"
            return LinkLostError(text, hint=LOST_HINT)
        if self._beats is not None and self._beats.is_late:
            text = f"The heartbeat of the {self._link.peer} has not changed for {self._beats.signal.max_age_s:g} s."
            if self._beats.signal.on_loss == "lost":
                return LinkLostError(text, hint=LOST_HINT)
            self._say_once_a_second(Severity.WARN, text)
        return None

    @property
    def _longest_silence_s(self) -> float:
        """How long there may be no state: no longer than a heartbeat may be away, for it is part of the state."""
        if self._beats is None or self._beats.signal.on_loss != "lost":
            return self._config.silence_s
        return min(self._config.silence_s, self._beats.signal.max_age_s)

    def _say_trouble(self, error: DeviceError) -> None:
        self._say_once_a_second(Severity.WARN, str(error))

    def _say_once_a_second(self, severity: Severity, text: str) -> None:
        now_ns = self._clock.now_ns()
        if text != self._said or now_ns - self._said_ns >= patience_ns(self._clock, LOG_PERIOD_S):
            self._said, self._said_ns = text, now_ns
            self._log(severity, text)

    def _report_lost(self, error: LinkLostError) -> None:
        if self._closing.is_set():
            return
        self._log(Severity.ERROR, str(self._flight.keep(error)))
        if self._on_lost is not None:
            self._on_lost(error)

    def _log(self, severity: Severity, text: str) -> None:
        logger.info("%s", text)
        self._sink(LogEntry(self._clock.now_ns(), severity, "robot", text))


def _nowhere(_record: object) -> None:
    """Take what nobody wants yet."""
