"""Optical trackers, behind one role: `bench.drivers.base.TrackerStream`."""

from __future__ import annotations

from collections.abc import Callable

from bench.config import AnyTrackerConfig
from bench.drivers.base import TrackerStream
from bench.drivers.flight import FlightRecorder
from bench.drivers.tracker.natnet import NatNetTracker
from bench.errors import BenchError, ConfigError
from bench.timing import Clock

__all__ = ["make_tracker"]


def make_tracker(
    config: AnyTrackerConfig,
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
        Keeps the last packets for the day on which the link ends badly; not of a tracker whose maker's library reads
        the network.

    Raises
    ------
    ConfigError
        The tracker's maker has a library of its own, which is not installed.
    """
    if config.kind == "natnet":
        return NatNetTracker(config, clock, on_missed=on_missed, on_lost=on_lost, flight=flight)
    try:
        from bench.drivers.tracker.qualisys.client import QualisysTracker
    except ImportError as error:
        raise ConfigError(
            f"[tracker] kind = 'qualisys' needs the library qtm-rt: {error}.",
            hint="Install it with: pip install 'cable-bench[qualisys]'",
        ) from error
    return QualisysTracker(config, clock, on_missed=on_missed, on_lost=on_lost)
