"""What the live view does: read what the recorder has added, show it at the pace at which it happened."""

from __future__ import annotations

import heapq
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from operator import itemgetter

import numpy as np
import numpy.typing as npt

from bench.live.cable import LiveCable, TracedFrame
from bench.live.server import FORWARDED, LiveServer
from bench.live.status import LiveStatus
from bench.recording import BODIES, CLOCK, CYCLE, FRAME, LOG, POINTS, STATE, STATS, Message, Run, RunFollower
from bench.report.derived import CURVATURE, encode_curvature, share_of_limit
from bench.timing import RunClock, patience_ns

__all__ = ["show_run"]

LOOK_S = 0.1
"""Between two looks at the file; the recorder adds to it each second."""
PICTURES_PER_S = 20.0
"""Frames that are shown in one second of the machine's time: smooth for an eye, and 1 MB/s for the network."""
EASE_S = 0.3
"""By which the view lies behind what was read, so that a second that comes a little late is no pause."""
LONGEST_PAUSE_S = 2.0
"""A longer one in the recording (a computer that slept, a clock) is not waited for."""
_TOPICS = (FRAME, POINTS, BODIES, CLOCK, CYCLE, STATE, LOG, STATS)

Timed = tuple[int, Callable[[], None]]


def show_run(follower: RunFollower, server: LiveServer, stop: threading.Event) -> None:
    """Show a run until its file is finished or `stop` is set, which then shows the rest without waiting.

    Raises
    ------
    RecordingError
        The file cannot be read.
    """
    view = _View(follower, server, stop)
    past = follower.read()
    if past is not None:
        view.catch_up(past, follower.recent())
    while not follower.is_finished:
        is_last = stop.is_set()
        part = follower.read()
        if part is not None:
            view.show(part)
        elif is_last:
            return
        else:
            stop.wait(LOOK_S)


class _View:
    def __init__(self, follower: RunFollower, server: LiveServer, stop: threading.Event) -> None:
        self._server = server
        self._stop = stop
        self._cable = LiveCable(follower)
        self._status = LiveStatus()
        self._clock: RunClock | None = None

    def catch_up(self, past: Run, recent: Run) -> None:
        """Take in what was there before anybody watched, as far as it can be told at once."""
        past.load((STATE, LOG))  # few chunks hold them; the others are not read
        self._status.read_words(past)
        recent.load((CYCLE, STATS))
        self._status.read_counts(recent)
        self._cable.notice(recent)

    def show(self, part: Run) -> None:
        """Show one part of the run, which takes as long as it took."""
        part.load(_TOPICS)
        self._status.read_words(part)
        self._status.read_counts(part)
        self._cable.notice(part)
        speed = float(part.metadata.get("bench.run", {}).get("clock_speed", "1"))
        rows = _thin(part[FRAME].log_time_ns, round(speed * 1e9 / PICTURES_PER_S))
        cable = list(self._cable.trace(part, rows))
        pictures = heapq.merge(self._messages(part, rows), self._cables(part, cable), key=itemgetter(0))
        for host_ns, send in pictures:
            self._wait_until(host_ns, speed)
            send()
        self._server.show_status(self._status.values(self._cable.problem), self._status.host_ns)

    def _messages(self, part: Run, rows: npt.NDArray[np.int64]) -> Iterator[Timed]:
        shown = set(part[FRAME].log_time_ns[rows].tolist())
        for message in sorted(part.messages(FORWARDED), key=lambda one: one.log_time_ns):
            if message.topic != POINTS or message.log_time_ns in shown:
                yield message.log_time_ns, partial(self._forward, message)

    def _forward(self, message: Message) -> None:
        self._server.forward(message.topic, message.payload, message.log_time_ns)

    def _cables(self, part: Run, frames: list[TracedFrame]) -> Iterator[Timed]:
        limit_m = part.config.cable.minimum_bend_radius_mm * 1e-3
        for frame in frames:
            yield frame.arrival_ns, partial(self._draw, frame, limit_m)

    def _draw(self, frame: TracedFrame, limit_m: float) -> None:
        red = share_of_limit(frame.line_curvature_per_m, limit_m)
        self._server.draw_line(frame.line_m, red.tolist(), frame.arrival_ns)
        curve = frame.arc_length_m, frame.curvature_per_m, frame.sigma_per_m
        payload = encode_curvature(frame.capture_ns, frame.frame_number, frame.confidence, *curve)
        self._server.forward(CURVATURE, payload, frame.arrival_ns)

    def _wait_until(self, host_ns: int, speed: float) -> None:
        """Wait as long as it took in the run; a view that is late waits for nothing."""
        if self._stop.is_set():
            return
        clock = self._clock
        if clock is None or host_ns - clock.now_ns() > patience_ns(clock, LONGEST_PAUSE_S):
            clock = RunClock.start(speed)
            self._clock = clock = replace(clock, utc_ns=host_ns - patience_ns(clock, EASE_S))
        left_ns = host_ns - clock.now_ns()
        if left_ns > 0:
            self._stop.wait(left_ns / speed * 1e-9)


def _thin(times_ns: npt.NDArray[np.int64], step_ns: int) -> npt.NDArray[np.int64]:
    """Return the first row of each step of time."""
    _, first = np.unique(times_ns // step_ns, return_index=True)
    return first
