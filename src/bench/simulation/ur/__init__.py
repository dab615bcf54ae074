"""A simulated Universal Robots controller that speaks RTDE, the dashboard and the Robot API over real sockets."""

from bench.simulation.ur.controller import UrController
from bench.simulation.ur.kinds import KINDS, ControllerKind

__all__ = ["KINDS", "ControllerKind", "UrController"]
