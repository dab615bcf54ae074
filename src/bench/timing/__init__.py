"""Host time, and the maps from device time to it."""

from bench.timing.clock import Clock, ManualClock, RunClock, patience_ns
from bench.timing.clockmap import ClockMap, EchoFilter, MinimumDelayFilter, estimate_echo_map, estimate_hull_map

__all__ = [
    "Clock",
    "ClockMap",
    "EchoFilter",
    "ManualClock",
    "MinimumDelayFilter",
    "RunClock",
    "estimate_echo_map",
    "estimate_hull_map",
    "patience_ns",
]
