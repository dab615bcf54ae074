"""What is done with each packet once the tracker streams: frames, clock answers and the server's remarks."""

from __future__ import annotations

import logging
from collections.abc import Callable

from bench.drivers.base import RecordSink
from bench.drivers.tracker.complaints import Complaint
from bench.drivers.tracker.counting import FrameCounter, Place
from bench.drivers.tracker.natnet.bitstream import Bitstream
from bench.drivers.tracker.natnet.frame import BITSTREAM_CHANGED, EDIT_MODE, MODELS_CHANGED, NEWEST_KNOWN
from bench.drivers.tracker.natnet.link import CommandLink
from bench.drivers.tracker.natnet.messages import (
    ServerInfo,
    decode_echo_response,
    decode_server_info,
    decode_text,
    encode_echo_request,
)
from bench.drivers.tracker.natnet.models import RigidBodyModel
from bench.drivers.tracker.natnet.records import capture_stamp, make_record
from bench.drivers.tracker.natnet.wire import Message, Version, dotted, encode_packet, split_packet, verify_whole
from bench.errors import ProtocolError
from bench.model import ClockSample, ClockSource, LogEntry, Severity, StampKind
from bench.timing import Clock, EchoFilter, MinimumDelayFilter, patience_ns

__all__ = ["POINTS_TOPIC", "FrameStream"]

logger = logging.getLogger(__name__)

POINTS_TOPIC = "/tracker/points"
ECHO_NS = 250_000_000
"""Time of the clock between two clock questions, as NaturalPoint's own library has it."""
SHORTEST_ECHO_S = 0.05
"""Machine time between two questions, should the clock run much faster than the machine."""
MOST_QUESTIONS = 16
"""Questions that may wait for their answer: 4 s. Older ones are given up."""
MODELS_PAUSE_S = 1.0
"""Machine time between two requests for the model definitions: the bit that asks for it stays set for a while."""
CLOCK_JUMP_S = 10.0
"""Machine time: a clock that reads so much else began anew. Networks and busy machines hold packets back for less."""
LARGEST_CORRECTION_NS = 3_600_000_000_000
"""A capture time an hour from its arrival comes from a broken stamp, not from a slow network."""


class FrameStream:
    """Turns packets into records. Used by the reader thread alone.

    Parameters
    ----------
    clock_hz : int
        Frequency of the tracker's clock; 0 before NatNet 3, which cannot be asked for it: then the smallest delay of
        the last frames gives their host time.
    """

    def __init__(
        self,
        link: CommandLink,
        clock: Clock,
        sink: RecordSink,
        bitstream: Bitstream,
        clock_hz: int,
        on_missed: Callable[[str, int], None],
        *,
        keep_packets: Callable[[str], str] = lambda _reason: "",
    ) -> None:
        self._link = link
        self._clock = clock
        self._sink = sink
        self._bitstream = bitstream
        self._clock_hz = clock_hz
        self._on_missed = on_missed
        self._keep_packets = keep_packets
        self._counter = FrameCounter()
        self._echo = EchoFilter()
        self._one_way = MinimumDelayFilter(1.0)
        self._asked: dict[int, None] = {}
        self._next_echo_ns = 0
        self._next_models_ns = 0
        self._newest_ticks = 0
        self._segment = 0
        self._params = 0
        self._version: Version = ()
        self._is_back = False
        self._missed = Complaint("Frames missed", Severity.WARN, clock, sink)
        self._late = Complaint("Frames late, out of order", Severity.INFO, clock, sink)
        self._twice = Complaint("Frames received twice and recorded once", Severity.INFO, clock, sink)
        self._broken = Complaint("Packets that cannot be read", Severity.WARN, clock, sink)
        self.newest_frame_ns = 0
        """Arrival of the newest frame; of the start before the first."""
        self.answers_since_frame = 0
        """Clock answers since the newest frame: the tracker lives, but streams nothing."""
        self.is_dismissed = False
        """Whether the tracker took its leave."""
        self.on_server: Callable[[ServerInfo], None] = lambda _server: None
        """Told when the tracker says who it is, which it does when it is asked to connect again."""

    def start(self) -> None:
        """Begin to wait for the first frame, and ask the clock at once, so that all but the first can be mapped."""
        self.newest_frame_ns = self._clock.now_ns()
        self._ask_clock()

    def go_on(self, bitstream: Bitstream | None, clock_hz: int) -> None:
        """Expect frames again after a silence.

        Parameters
        ----------
        bitstream : Bitstream, optional
            Of a tracker that was changed meanwhile, and so counts its frames anew; None if it is as before.
        clock_hz : int
        """
        self.is_dismissed = False
        self._clock_hz = clock_hz
        self._is_back = True
        if bitstream is None:
            self._bitstream.doubt()
        else:
            self._bitstream = bitstream
            self._counter.begin_anew()
            self._begin_segment("The tracker was changed")
        self._link.send(encode_packet(Message.REQUEST_MODELDEF))
        self._ask_clock()

    def take(self, packet: bytes, arrival_ns: int) -> None:
        """Deal with one packet. A broken one is counted and told, never an error."""
        try:
            message, payload = split_packet(packet)
            if message == Message.FRAMEOFDATA:
                verify_whole(packet)
                self._take_frame(payload, arrival_ns)
            else:
                self._take_other(message, payload, arrival_ns)
        except ProtocolError as error:
            where = self._keep_packets(str(error)) if self._broken.total == 0 else ""
            self._broken.add(f"{error} It begins with {packet[:16].hex()}. {where}".rstrip())

    def keep_up(self, now_ns: int) -> None:
        """Ask the clock when its turn has come, and tell what waits to be told."""
        if now_ns >= self._next_echo_ns:
            self._ask_clock()
        for complaint in self._complaints:
            complaint.tell()

    def finish(self) -> None:
        """Tell all that was not told yet."""
        for complaint in self._complaints:
            complaint.tell(at_once=True)

    @property
    def _complaints(self) -> tuple[Complaint, ...]:
        return self._missed, self._late, self._twice, self._broken

    def _take_frame(self, payload: bytes, arrival_ns: int) -> None:
        frame = self._bitstream.decode_frame(payload)
        if self._bitstream.version != self._version:
            self._note_version(self._bitstream.version)
        ticks, stamp = capture_stamp(frame)
        self.newest_frame_ns = arrival_ns
        self.answers_since_frame = 0
        if self._is_back:
            self._watch_for_new_clock(ticks, arrival_ns)
        if not self._count(frame.frame_number, ticks):
            return
        capture_ns = self._to_host_ns(ticks, stamp, arrival_ns)
        self._sink(make_record(frame, ticks, stamp, arrival_ns, capture_ns, self._segment))
        if frame.params != self._params or frame.params & MODELS_CHANGED:
            self._note_params(frame.params, arrival_ns)

    def _count(self, number: int, ticks: int) -> bool:
        """Count one frame; False if it is there already."""
        place, change = self._counter.place(number, ticks, after_silence=self._is_back)
        self._is_back = False
        if place is Place.DUPLICATE:
            self._twice.add(f"The latest is frame {number}.")
            return False
        if change:
            self._on_missed(POINTS_TOPIC, change)
        if place is Place.LATE:
            self._late.add(f"The latest is frame {number}; it no longer counts as missed.")
        elif change:
            self._missed.add(f"The latest gap ends before frame {number}.", change)
        elif place is Place.RESTART:
            self._begin_segment(f"The tracker counts its frames anew, from {number}", ticks < self._newest_ticks)
        if place is not Place.LATE:
            self._newest_ticks = ticks
        return True

    def _begin_segment(self, why: str, has_new_clock: bool = True) -> None:
        self._segment += 1
        self._say(Severity.WARN, f"{why}: clock segment {self._segment} begins.")
        if has_new_clock:
            self._echo.reset()
            self._one_way.reset()
        self._asked.clear()
        self._ask_clock()

    def _watch_for_new_clock(self, ticks: int, arrival_ns: int) -> None:
        """Begin a segment if the clock reads something else altogether: the tracker's PC was restarted."""
        limit_ns = patience_ns(self._clock, CLOCK_JUMP_S)
        if self._echo.map is not None and abs(self._echo.map.to_host_ns(ticks) - arrival_ns) > limit_ns:
            self._counter.begin_anew()
            self._begin_segment("The tracker's clock was restarted")

    def _to_host_ns(self, ticks: int, stamp: StampKind, arrival_ns: int) -> int:
        if stamp is StampKind.TRACKER_TIME:
            return self._one_way.update(ticks, arrival_ns)
        if self._echo.map is None:
            return arrival_ns
        capture_ns = self._echo.map.to_host_ns(ticks)
        return capture_ns if abs(capture_ns - arrival_ns) < LARGEST_CORRECTION_NS else arrival_ns

    def _note_version(self, version: Version) -> None:
        before, self._version = self._version, version
        if before:
            self._say(
                Severity.WARN, f"The tracker's frames are of NatNet {dotted(version)}, before of {dotted(before)}."
            )
        if version > NEWEST_KNOWN:
            known = dotted(NEWEST_KNOWN)
            self._say(
                Severity.INFO,
                f"The tracker's frames are of NatNet {dotted(version)}, and bench knows {known}: what is new in them "
                "is skipped.",
            )

    def _note_params(self, params: int, now_ns: int) -> None:
        begun = params & ~self._params
        self._params = params
        if begun & EDIT_MODE:
            self._say(Severity.WARN, "Motive is in Edit mode: it plays back a take instead of measuring.")
        if begun & BITSTREAM_CHANGED:
            self._bitstream.doubt()
        if params & MODELS_CHANGED and now_ns >= self._next_models_ns:
            self._next_models_ns = now_ns + patience_ns(self._clock, MODELS_PAUSE_S)
            self._link.send(encode_packet(Message.REQUEST_MODELDEF))

    def _take_other(self, message: int, payload: bytes, arrival_ns: int) -> None:
        if message == Message.ECHORESPONSE:
            self._take_echo(payload, arrival_ns)
        elif message == Message.MODELDEF:
            self._take_models(payload)
        elif message == Message.MESSAGESTRING:
            self._say(Severity.INFO, f"The tracker says: {decode_text(payload)[:200]}")
        elif message == Message.SERVERINFO:
            self.on_server(decode_server_info(payload))
        elif message in (Message.DISCONNECT, Message.DISCONNECTBYTIMEOUT):
            self.is_dismissed = True
        else:
            logger.debug("message %d of %d bytes is of no use", message, len(payload))

    def _ask_clock(self) -> None:
        """Ask what the tracker's clock reads, if it is one that can be asked."""
        if self._clock_hz == 0:
            return
        while len(self._asked) >= MOST_QUESTIONS:
            del self._asked[next(iter(self._asked))]
        send_ns = self._clock.now_ns()
        self._asked[send_ns] = None
        self._link.send(encode_echo_request(send_ns))
        self._next_echo_ns = send_ns + max(ECHO_NS, patience_ns(self._clock, SHORTEST_ECHO_S))

    def _take_echo(self, payload: bytes, arrival_ns: int) -> None:
        send_ns, ticks = decode_echo_response(payload)
        if send_ns not in self._asked:
            return
        del self._asked[send_ns]
        self._watch_for_new_clock(ticks, arrival_ns)
        self.answers_since_frame += 1
        sample = ClockSample(ClockSource.TRACKER, send_ns, ticks, arrival_ns, float(self._clock_hz), self._segment)
        self._sink(sample)
        self._echo.update(sample.send_ns, sample.device_ticks, sample.receive_ns, 1e9 / sample.ticks_per_s)

    def _take_models(self, payload: bytes) -> None:
        models = self._bitstream.decode_models(payload)
        names = [f"{one.name} ({one.body_id})" for one in models if isinstance(one, RigidBodyModel)]
        self._say(Severity.INFO, "The tracker's rigid bodies are now: " + (", ".join(names) or "none") + ".")

    def _say(self, severity: Severity, text: str) -> None:
        self._sink(LogEntry(self._clock.now_ns(), severity, "tracker", text))
