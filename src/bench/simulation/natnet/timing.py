"""When the simulated tracker stamps what it saw, and when that leaves for the network."""

from __future__ import annotations

import numpy as np

from bench.config import SimulationConfig

__all__ = ["FrameTiming", "Stamps", "stamp_delay_s"]

Stamps = tuple[int, int, int]
"""Ticks of mid-exposure (0 with USB cameras), camera data received, transmit."""

SHORTEST_STEP_S = 5e-5
"""Between two stamps of one frame, whatever is drawn."""
NETWORK_S = 0.0006
"""Shortest way from the transmit stamp to the network."""
TAIL_S = 0.00017
"""Mean of what comes on top; together 6.2 ms after mid-exposure at the median and 6.9 ms at 99 %, as in real frames."""
SHORTEST_LATE_S = 0.001
"""A late frame is late by this at least: more than the usual spread."""


class FrameTiming:
    """Draws the times of one frame after another.

    Parameters
    ----------
    simulation : SimulationConfig
    ticks_per_s : float
        Of the tracker's clock.
    rng : numpy.random.Generator
    """

    def __init__(self, simulation: SimulationConfig, ticks_per_s: float, rng: np.random.Generator) -> None:
        self._rng = rng
        self._hz = ticks_per_s
        self._usb = simulation.usb_cameras
        self._delay_s = simulation.tracker_stamp_delay_ms * 1e-3
        # The stamps' errors are independent, and the interval between two frames has twice their variance.
        jitter_ms = simulation.tracker_jitter_ms / np.sqrt(2.0)
        way_ms = max(simulation.transmit_after_ms - simulation.received_after_ms, 0.0)
        way_sd_ms = max(simulation.transmit_sd_ms**2 - simulation.received_sd_ms**2, 0.0) ** 0.5
        self._mean_s = np.array([0.0, simulation.received_after_ms, way_ms]) * 1e-3
        self._sd_s = np.array([jitter_ms, simulation.received_sd_ms, way_sd_ms]) * 1e-3
        self._late_share = simulation.late_share
        self._latest_s = simulation.latest_ms * 1e-3

    def draw(self, ticks: int) -> tuple[Stamps, int]:
        """Return the stamps of a frame exposed at `ticks`, and after how many nanoseconds it leaves."""
        error_s, received_s, way_s = (self._mean_s + self._sd_s * self._rng.normal(size=3)).tolist()
        received_s = max(received_s, SHORTEST_STEP_S)
        transmit_s = received_s + max(way_s, SHORTEST_STEP_S)
        leaves_s = transmit_s + NETWORK_S + self._draw_tail()
        mid = 0 if self._usb else ticks + round((self._delay_s + error_s) * self._hz)
        received, transmit = (
            ticks + round((self._delay_s + after_s) * self._hz) for after_s in (received_s, transmit_s)
        )
        return (mid, received, transmit), round(leaves_s * 1e9)

    def _draw_tail(self) -> float:
        tail_s = self._rng.exponential(TAIL_S)
        if self._late_share and self._rng.random() < self._late_share:
            tail_s += self._rng.uniform(min(SHORTEST_LATE_S, self._latest_s), self._latest_s)
        return float(min(tail_s, self._latest_s))


def stamp_delay_s(simulation: SimulationConfig) -> float:
    """Return how much later than the exposure the tracker's best stamp says it was, on average."""
    after_ms = simulation.received_after_ms if simulation.usb_cameras else 0.0
    return (simulation.tracker_stamp_delay_ms + after_ms) * 1e-3
