"""Optical trackers, behind one role: `bench.drivers.base.TrackerStream`."""

from __future__ import annotations

from collections.abc import Callable

from bench.config import TrackerConfig
from bench.drivers.base import TrackerStream
from bench.drivers.flight import FlightRecorder
from bench.drivers.tracker.natnet import NatNetTracker
from bench.errors import BenchError
from bench.timing import Clock

__all__ = ["make_tracker"]


def make_tracker(
    config: TrackerConfig,
    clock: Clock,
    *,
    on_missed: Callable[[str, int], None] | None = None,
    on_lost: Callable[[BenchError], None] | None = None,
    flight: FlightRecorder | None = None,
) -> TrackerStream:
    """Make the driver for the tracker of a configuration; nothing is connected yet.

    Parameters
    ----------
    on_missed : callable, optional
        Told ``(topic, n)`` when `n` more frames did not come, -1 when one of them came late.
    on_lost : callable, optional
        Told once when the tracker falls silent.
    flight : FlightRecorder, optional
        Keeps the last packets for the day on which the link ends badly.
    """
    return NatNetTracker(config, clock, on_missed=on_missed, on_lost=on_lost, flight=flight)
