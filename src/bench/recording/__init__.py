"""The run file: written while the test runs, read as numpy columns afterwards."""

from bench.recording.columns import Columns
from bench.recording.output import rename_new
from bench.recording.reader import Run, RunStatus, open_run
from bench.recording.salvage import Salvaged, salvage_copy, salvage_in_place
from bench.recording.topics import BODIES, CLOCK, CYCLE, FRAME, LOG, POINTS, ROBOT, STATE, STATS
from bench.recording.writer import RunWriter

__all__ = [
    "BODIES",
    "CLOCK",
    "CYCLE",
    "FRAME",
    "LOG",
    "POINTS",
    "ROBOT",
    "STATE",
    "STATS",
    "Columns",
    "Run",
    "RunStatus",
    "RunWriter",
    "Salvaged",
    "open_run",
    "rename_new",
    "salvage_copy",
    "salvage_in_place",
]
