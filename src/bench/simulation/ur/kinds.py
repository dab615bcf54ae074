"""The generations of UR controllers that are simulated, by what a client can tell them apart."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CB3", "E_SERIES", "KINDS", "POLYSCOPE_X", "ControllerKind"]


@dataclass(frozen=True, slots=True)
class ControllerKind:
    """One generation."""

    version: tuple[int, int, int, int]
    """Of its software: major, minor, bugfix, build. It has no outputs that came later."""
    rate_hz: float
    """Its own tick."""
    has_remote_control: bool
    """Whether commands from outside must be allowed at the pendant."""
    has_dashboard: bool
    """Whether its program is controlled by the dashboard; else by the Robot API."""


E_SERIES = ControllerKind((5, 15, 0, 126652), 500.0, has_remote_control=True, has_dashboard=True)
CB3 = ControllerKind((3, 15, 8, 106339), 125.0, has_remote_control=False, has_dashboard=True)
POLYSCOPE_X = ControllerKind((10, 12, 0, 0), 500.0, has_remote_control=True, has_dashboard=False)
KINDS = {"e-series": E_SERIES, "cb3": CB3, "polyscope-x": POLYSCOPE_X}
"""By the words of `[simulation] controller`."""
