"""The run file: written while the test runs, read as numpy columns afterwards."""

from bench.recording.cdr import encode
from bench.recording.columns import Columns
from bench.recording.following import RunFollower
from bench.recording.output import rename_new
from bench.recording.part_names import find_first
from bench.recording.pointcloud import encode_cloud, split_stamp
from bench.recording.reader import Run, open_run
from bench.recording.salvage import Salvaged, salvage_copy, salvage_in_place
from bench.recording.schemas import load_schema
from bench.recording.status import RunStatus
from bench.recording.topics import BODIES, CLOCK, CYCLE, FRAME, LOG, POINTS, ROBOT, STATE, STATS, TOPICS, Message
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
    "TOPICS",
    "Columns",
    "Message",
    "Run",
    "RunFollower",
    "RunStatus",
    "RunWriter",
    "Salvaged",
    "encode",
    "encode_cloud",
    "find_first",
    "load_schema",
    "open_run",
    "rename_new",
    "salvage_copy",
    "salvage_in_place",
    "split_stamp",
]
