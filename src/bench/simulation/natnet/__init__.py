"""The simulated tracker: NatNet over real UDP sockets, as OptiTrack Motive speaks it."""

from bench.simulation.natnet.server import NatNetServer

__all__ = ["NatNetServer"]
