"""Takes: files that a tracker's own software recorded, read as the frames a live tracker would have sent."""

from bench.drivers.takes.read import read_take
from bench.drivers.takes.take import TICKS_PER_S, Take, TakeInfo

__all__ = ["TICKS_PER_S", "Take", "TakeInfo", "read_take"]
