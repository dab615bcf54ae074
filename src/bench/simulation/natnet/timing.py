"""When the simulated tracker stamps, sends and delivers what it saw."""

from __future__ import annotations

from bench.config import SimulationConfig

__all__ = ["RECEIVED_AFTER_S", "TRANSMIT_AFTER_S", "stamp_delay_s"]

RECEIVED_AFTER_S = 0.0046
"""From mid-exposure to camera data received: median of 518 real frames."""
TRANSMIT_AFTER_S = 0.00541
"""From mid-exposure to transmit, of the same."""


def stamp_delay_s(simulation: SimulationConfig) -> float:
    """Return how much later than the true exposure the tracker's best stamp says it was."""
    return simulation.tracker_stamp_delay_ms * 1e-3
