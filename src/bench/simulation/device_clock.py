"""A device's own clock: another origin, another unit and a few tens of ppm off."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DeviceClock"]


@dataclass(frozen=True, slots=True)
class DeviceClock:
    """A straight line between host time and the ticks a simulated device counts."""

    host_origin_ns: int
    """Host time at which the clock read `ticks_origin`."""
    ticks_origin: int
    ticks_per_s: float
    """The frequency the device claims."""
    drift_ppm: float = 0.0
    """How much faster than host time the clock really runs."""

    @property
    def _ticks_per_host_ns(self) -> float:
        return self.ticks_per_s * 1e-9 * (1.0 + self.drift_ppm * 1e-6)

    def ticks_at(self, host_ns: int) -> int:
        """Return what the clock reads at a host time."""
        return self.ticks_origin + round((host_ns - self.host_origin_ns) * self._ticks_per_host_ns)

    def host_ns_at(self, ticks: float) -> int:
        """Return the host time at which the clock reads `ticks`."""
        return self.host_origin_ns + round((ticks - self.ticks_origin) / self._ticks_per_host_ns)
