"""OptiTrack Motive: the NatNet protocol, and the client that records it."""

from bench.drivers.tracker.natnet.client import NatNetTracker

__all__ = ["NatNetTracker"]
