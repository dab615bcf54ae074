"""What is done with each packet once QTM streams."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from bench.drivers.base import RecordSink
from bench.drivers.tracker.complaints import Complaint
from bench.drivers.tracker.counting import FrameCounter, Place
from bench.drivers.tracker.qualisys.frames import read_bodies, read_points
from bench.errors import ProtocolError
from bench.model import LogEntry, Severity, StampKind, TrackerFrame
from bench.timing import Clock, MinimumDelayFilter

__all__ = ["TICKS_PER_S", "FrameStream", "Packet"]

POINTS_TOPIC = "/tracker/points"
TICKS_PER_S = 1_000_000
"""QTM counts microseconds since the measurement began."""


class Packet(Protocol):
    """The part of `qtm_rt.QRTPacket` that is used: its own decoding makes a tuple of every number."""

    timestamp: int
    framenumber: int
    data: bytes
    components: dict[object, int]
    """Where each component's content begins, by an enum of its type."""


class FrameStream:
    """Turns packets into records; its methods are called from the reader's loop alone."""

    def __init__(self, clock: Clock, sink: RecordSink, on_missed: Callable[[str, int], None]) -> None:
        self._clock = clock
        self._sink = sink
        self._on_missed = on_missed
        self._counter = FrameCounter()
        self._filter = MinimumDelayFilter(1e9 / TICKS_PER_S)
        self._segment = -1
        self._missed = Complaint("Frames missed", Severity.WARN, clock, sink)
        self._twice = Complaint("Frames received twice and recorded once", Severity.INFO, clock, sink)
        self._broken = Complaint("Packets that cannot be read", Severity.WARN, clock, sink)
        self.newest_frame_ns = 0
        """Arrival of the newest frame; of the connection before the first."""
        self.has_frame = False
        """Whether a frame has come over this connection."""

    def begin(self) -> None:
        """Begin a clock segment: a new connection may be to a new measurement."""
        self._segment += 1
        self._counter = FrameCounter()
        self._filter.reset()
        self.newest_frame_ns = self._clock.now_ns()
        self.has_frame = False

    def take(self, packet: Packet) -> None:
        """Deal with one packet. A broken one is counted and told, never an error."""
        arrival_ns = self._clock.now_ns()
        try:
            self._take_frame(packet, arrival_ns)
        except ProtocolError as error:
            self._broken.add(str(error.args[0]))

    def keep_up(self) -> None:
        """Tell what waits to be told."""
        for complaint in (self._missed, self._twice, self._broken):
            complaint.tell()

    def finish(self) -> None:
        """Tell all that was not told yet."""
        for complaint in (self._missed, self._twice, self._broken):
            complaint.tell(at_once=True)

    def _take_frame(self, packet: Packet, arrival_ns: int) -> None:
        places = {getattr(kind, "value", 0): start for kind, start in packet.components.items()}
        points = read_points(packet.data, places)
        bodies = read_bodies(packet.data, places)
        if not self._count(packet.framenumber, packet.timestamp):
            return
        self.newest_frame_ns, self.has_frame = arrival_ns, True
        self._sink(
            TrackerFrame(
                arrival_ns=arrival_ns,
                capture_ns=self._filter.update(packet.timestamp, arrival_ns),
                frame_number=packet.framenumber,
                device_ticks=packet.timestamp,
                stamp=StampKind.TRACKER_TIME,
                points_m=points.points_m,
                ids=points.ids,
                flags=points.flags,
                residual_m=points.residual_m,
                bodies=bodies,
                segment=self._segment,
            )
        )

    def _count(self, number: int, ticks: int) -> bool:
        """Count one frame; False if it is there already."""
        place, change = self._counter.place(number, ticks)
        if place is Place.DUPLICATE:
            self._twice.add(f"The latest is frame {number}.")
            return False
        if change:
            self._on_missed(POINTS_TOPIC, change)
        if change > 0:
            self._missed.add(f"The latest gap ends before frame {number}.", change)
        elif place is Place.RESTART:
            self._segment += 1
            self._filter.reset()
            text = f"The tracker counts its frames anew, from {number}: clock segment {self._segment} begins."
            self._sink(LogEntry(self._clock.now_ns(), Severity.WARN, "tracker", text))
        return True
