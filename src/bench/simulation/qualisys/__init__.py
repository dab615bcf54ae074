"""A simulated Qualisys Track Manager: its real-time protocol over TCP."""

from bench.simulation.qualisys.server import QualisysServer

__all__ = ["QualisysServer"]
