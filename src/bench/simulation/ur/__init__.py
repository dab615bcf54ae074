"""A simulated Universal Robots controller that speaks RTDE and the dashboard over real sockets."""

from bench.simulation.ur.controller import UrController

__all__ = ["UrController"]
