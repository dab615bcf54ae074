"""What the analysis found, as an MCAP file for viewers: it stands beside the run file, which is never rewritten.

Every message is ros2msg + CDR, as in the run file, so that whatever opens the one opens the other, and both together.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mcap.writer import CompressionType, Writer

from bench.analysis import interpolate_curve
from bench.model import CycleEventKind, StampKind, TrackerFrame
from bench.recording import CYCLE, TOPICS, Message, encode, encode_cloud, load_schema, split_stamp
from bench.report.results import Results
from bench.report.tables import write_then_rename
from bench.report.writing import explain_write

__all__ = [
    "CURVATURE",
    "CURVATURE_SCHEMA",
    "DERIVED_NAME",
    "LINE",
    "encode_curvature",
    "share_of_limit",
    "write_derived",
]

DERIVED_NAME = "derived.mcap"
MARKERS, LINE, CURVATURE = "/cable/markers", "/cable/line", "/cable/curvature"
CURVATURE_SCHEMA = "bench_msgs/msg/CableCurvature"
_SCHEMAS = {
    MARKERS: "sensor_msgs/msg/PointCloud2",
    LINE: "visualization_msgs/msg/Marker",
    CURVATURE: CURVATURE_SCHEMA,
    CYCLE: TOPICS[CYCLE].schema,
}
_LINE_WIDTH_M = 0.004
_LINE_STRIP = 4  # visualization_msgs/msg/Marker

Array = npt.NDArray[Any]


def write_derived(results: Results, folder: Path) -> Path:
    """Write ``derived.mcap``: the sorted markers, the cable's line, its curvature, and the cycles.

    All frames in which a marker was found are in it; line and curvature only where a curve could be drawn.

    Raises
    ------
    RecordingExistsError
        The file exists.
    RecordingError, DiskFullError
        The folder cannot be written.
    """
    path = folder / DERIVED_NAME
    with explain_write(f"{path} cannot be written"):
        write_then_rename(path, lambda partial: _write(results, partial))
    return path


def _write(results: Results, path: Path) -> None:
    with path.open("wb") as stream:
        writer: Any = Writer(stream, compression=CompressionType.LZ4)
        writer.start(profile="ros2", library="bench report")
        channels = {}
        for topic, name in _SCHEMAS.items():
            schema = writer.register_schema(name, "ros2msg", load_schema(name).text.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        about = {"run": results.run_path, "config_sha256": results.config_sha256, **results.methods}
        writer.add_metadata("bench.derived", about)
        ordered = heapq.merge(_frame_messages(results), _cycle_messages(results), key=attrgetter("log_time_ns"))
        for number, one in enumerate(ordered):
            sequence = number if one.sequence is None else one.sequence
            times = one.log_time_ns, one.payload, one.publish_time_ns
            writer.add_message(channels[one.topic], *times, sequence & 0xFFFFFFFF)
        writer.finish()


def _frame_messages(results: Results) -> Iterator[Message]:
    frames = results.frames
    for row in np.argsort(frames.time_ns, kind="stable").tolist():
        time_ns, number = int(frames.time_ns[row]), int(frames.frame_number[row])
        found = np.flatnonzero(frames.source[row] >= 0)
        if len(found):
            cloud = encode_cloud(_as_frame(time_ns, number, frames.position_m[row, found], found))
            yield Message(MARKERS, time_ns, time_ns, number, cloud)
        if np.isfinite(frames.curvature_per_m[row]).any():
            yield Message(LINE, time_ns, time_ns, number, _encode_line(results, row))
            yield Message(CURVATURE, time_ns, time_ns, number, encode_curvature(time_ns, number, *_curve(results, row)))


def _as_frame(time_ns: int, number: int, points_m: npt.NDArray[np.float32], index: Array) -> TrackerFrame:
    """Return the sorted markers as a frame whose ids are their indices from the anchor."""
    return TrackerFrame(
        arrival_ns=time_ns,
        capture_ns=time_ns,
        frame_number=number,
        device_ticks=0,
        stamp=StampKind.FRAME_GRID,
        points_m=points_m,
        ids=index.astype(np.uint32),
        flags=np.zeros(len(index), np.uint32),
        residual_m=np.full(len(index), np.nan, np.float32),
    )


def _encode_line(results: Results, row: int) -> bytes:
    """Encode the curve through the markers, green where straight and red where it reaches the cable's limit."""
    frames, places = results.frames, results.arc_length_m
    line = interpolate_curve(frames.position_m[row], results.marker_arc_length_m, places)
    limit_m = results.config.cable.minimum_bend_radius_mm * 1e-3
    red = share_of_limit(frames.curvature_per_m[row], limit_m)
    seen = np.isfinite(line[:, 0])
    sec, nanosec = split_stamp(int(frames.time_ns[row]))
    values = {
        "header": {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": "lab"},
        "ns": "cable",
        "type": _LINE_STRIP,
        "pose": {"orientation": {"w": 1.0}},
        "scale": {"x": _LINE_WIDTH_M},
        "color": {"g": 1.0, "a": 1.0},
        "points": [{"x": x, "y": y, "z": z} for x, y, z in line[seen].tolist()],
        "colors": [{"r": r, "g": 1.0 - r, "b": 0.2, "a": 1.0} for r in red[seen].tolist()],
    }
    return encode(load_schema(_SCHEMAS[LINE]), values)


def share_of_limit(curvature_per_m: Array, limit_m: float) -> Array:
    """Return the curvature (G,) as a share of what the smallest radius allows, 0…1; 0 where it is unknown."""
    return np.asarray(np.clip(np.nan_to_num(curvature_per_m.astype(np.float64) * limit_m), 0.0, 1.0))


def _curve(results: Results, row: int) -> tuple[float, Array, Array, Array]:
    frames = results.frames
    return float(frames.confidence[row]), results.arc_length_m, frames.curvature_per_m[row], frames.sigma_per_m[row]


def encode_curvature(
    capture_ns: int,
    frame_number: int,
    confidence: float,
    arc_length_m: Array,
    curvature_per_m: Array,
    sigma_per_m: Array,
) -> bytes:
    """Encode the curvature (G,) of one frame, somewhere finite, as ``bench_msgs/msg/CableCurvature``."""
    largest = float(np.nanmax(curvature_per_m))
    values = {
        "capture_ns": capture_ns,
        "frame_number": frame_number,
        "max_curvature_per_m": largest,
        "min_bend_radius_mm": 1e3 / largest if largest > 0 else float("inf"),
        "confidence": confidence,
        "arc_length_m": arc_length_m.tolist(),
        "curvature_per_m": curvature_per_m.tolist(),
        "sigma_per_m": sigma_per_m.tolist(),
    }
    return encode(load_schema(CURVATURE_SCHEMA), values)


def _cycle_messages(results: Results) -> Iterator[Message]:
    cycles = results.cycles
    events = [
        (int(time_ns), int(index), kind, verdict)
        for kind, times in ((CycleEventKind.STARTED, cycles.start_ns), (CycleEventKind.COMPLETED, cycles.end_ns))
        for time_ns, index, verdict in zip(times, cycles.cycle_index, cycles.verdict, strict=True)
    ]
    for time_ns, index, kind, verdict in sorted(events):
        values = {
            "host_ns": time_ns,
            "cycle_index": index,
            "controller_time_s": float("nan"),
            "kind": int(kind),
            "detail": verdict if kind is CycleEventKind.COMPLETED else "",
        }
        yield Message(CYCLE, time_ns, time_ns, None, encode(load_schema(_SCHEMAS[CYCLE]), values))
