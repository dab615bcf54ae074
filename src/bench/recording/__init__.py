"""The run file: written while the test runs, read as numpy columns afterwards."""

from bench.recording.files.output import active_path, final_path, rename_new
from bench.recording.files.part_names import find_first
from bench.recording.messages.cdr import encode
from bench.recording.messages.pointcloud import encode_cloud, split_stamp
from bench.recording.messages.schemas import load_schema
from bench.recording.messages.topics import (
    BODIES,
    CLOCK,
    CYCLE,
    FRAME,
    LOG,
    POINTS,
    ROBOT,
    STATE,
    STATS,
    TOPICS,
    Message,
)
from bench.recording.reading.columns import Columns
from bench.recording.reading.following import RunFollower
from bench.recording.reading.reader import Run, open_run
from bench.recording.reading.status import RunStatus
from bench.recording.salvage.salvage import Salvaged, salvage_copy, salvage_in_place
from bench.recording.writing.writer import RunWriter

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
    "active_path",
    "encode",
    "encode_cloud",
    "final_path",
    "find_first",
    "load_schema",
    "open_run",
    "rename_new",
    "salvage_copy",
    "salvage_in_place",
    "split_stamp",
]
