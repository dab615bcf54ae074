"""Counts what streams in, for the preflight and the screen. Fed from reader threads, read from the main one."""

from __future__ import annotations

import numpy as np

from bench.model import UNLABELED, RobotState, TrackerFrame

__all__ = ["FrameTally", "RobotTally"]


class RobotTally:
    """What the robot's state stream looks like so far."""

    def __init__(self) -> None:
        self._first: RobotState | None = None
        self._latest: RobotState | None = None
        self.n_states = 0

    def update(self, state: RobotState) -> None:
        """Take one state into account."""
        if self._first is None or state.segment != self._first.segment:
            self._first = state
            self.n_states = 0
        self._latest = state
        self.n_states += 1

    @property
    def device_rate_hz(self) -> float:
        """States per second of the controller's own time; 0 before the second."""
        if self._first is None or self._latest is None or self.n_states < 2:
            return 0.0
        span = self._latest.controller_time_s - self._first.controller_time_s
        return (self.n_states - 1) / span if span > 0 else 0.0


class FrameTally:
    """What the tracker's frames look like so far."""

    def __init__(self) -> None:
        self.n_frames = 0
        self.most_points = 0
        self.most_unlabeled = 0
        self.latest_points = 0
        self.nominal_rate_hz = float("nan")
        """What the tracker says its rate is."""
        self._first_ns = 0
        self._latest_ns = 0

    def update(self, frame: TrackerFrame) -> None:
        """Take one frame into account."""
        if self.n_frames == 0:
            self._first_ns = frame.arrival_ns
        self._latest_ns = frame.arrival_ns
        self.n_frames += 1
        self.latest_points = len(frame.flags)
        self.most_points = max(self.most_points, self.latest_points)
        self.most_unlabeled = max(self.most_unlabeled, int(np.count_nonzero(frame.flags & UNLABELED)))

    @property
    def rate_hz(self) -> float:
        """Frames per second of host time, by arrival; 0 before the second."""
        span_s = (self._latest_ns - self._first_ns) * 1e-9
        return (self.n_frames - 1) / span_s if self.n_frames > 1 and span_s > 0 else 0.0
