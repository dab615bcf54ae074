"""Qualisys Track Manager (QTM) through Qualisys' own client library, which is an extra."""

from bench.drivers.tracker.qualisys.client import QualisysTracker

__all__ = ["QualisysTracker"]
