"""Takes: files that a tracker's own software recorded, read as the frames a live tracker would have sent."""

from bench.drivers.takes.read import read_take
from bench.drivers.takes.take import Take, TakeInfo

__all__ = ["Take", "TakeInfo", "read_take"]
