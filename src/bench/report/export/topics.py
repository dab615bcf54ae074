"""Topics of a recording as they were recorded, each as a Parquet file of plain columns."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from bench.errors import RecordingExistsError
from bench.recording import BODIES, POINTS, Columns, Run
from bench.report.tables import write_then_rename
from bench.report.writing import explain_write, in_system_words

__all__ = ["export_topics", "name_table"]

PER_POINT = ("residual_m", "ids", "flags")
OF_THE_FRAME = ("log_time_ns", "publish_time_ns", "sequence", "frame_number")
POSITIONS = ("offsets", "frame_index")
"""Places within the arrays of one reading; in a table, ``frame_number`` says what belongs together."""

Array = npt.NDArray[Any]


def export_topics(run: Run, topics: Iterable[str], folder: Path) -> dict[Path, int]:
    """Write each topic to a file of `folder`, in order of arrival, and return how many rows each has.

    A message is a row, a value a column, an array as many columns as it has numbers: ``q_rad_0`` to ``q_rad_5``. Of
    /tracker/points a point is a row. The recording is read part by part, so it may be larger than the memory.

    Raises
    ------
    RecordingExistsError
        One of the files exists: nothing is written then.
    RecordingError, DiskFullError
        A topic cannot be read or its file not be written.
    """
    paths = {topic: folder / name_table(topic) for topic in dict.fromkeys(topics)}
    if taken := [str(path) for path in paths.values() if path.exists()]:
        raise RecordingExistsError(f"{', '.join(taken)}: not overwritten.", hint="Choose another --output.")
    first_parts = run.read(paths, 0, 0)
    with explain_write(f"{folder} cannot be written", in_system_words):
        folder.mkdir(parents=True, exist_ok=True)
        return {path: _export(run, topic, first_parts[topic], path) for topic, path in paths.items()}


def name_table(topic: str) -> str:
    """Return the file's name: ``robot_state.parquet`` of /robot/state."""
    return topic.strip("/").replace("/", "_") + ".parquet"


def _export(run: Run, topic: str, empty: Columns, path: Path) -> int:
    schema = _make_table(topic, empty).schema.with_metadata({"bench.run_id": run.run_id, "bench.topic": topic})
    n_rows = 0

    def write(partial: Path) -> None:
        nonlocal n_rows
        with pq.ParquetWriter(partial, schema, compression="zstd") as writer:
            for part in run.stream([topic]):
                table = _make_table(topic, part[topic])
                writer.write_table(table.cast(schema))
                n_rows += table.num_rows

    write_then_rename(path, write)
    return n_rows


def _make_table(topic: str, columns: Columns) -> Any:
    if topic == POINTS:
        return pa.table(_split_points(columns))
    table: dict[str, Any] = {}
    for name, array in columns.items():
        if topic != BODIES or name not in POSITIONS:
            table |= _split_column(name, array)
    return pa.table(table)


def _split_points(columns: Columns) -> dict[str, Any]:
    """Return a row for each point; what else its frame has is in /tracker/frame."""
    frame = np.repeat(np.arange(len(columns.sequence)), np.diff(columns.offsets))
    of_frame = {name: columns[name][frame] for name in OF_THE_FRAME if name in columns}
    position_m = {f"{axis}_m": columns.points_m[:, i] for i, axis in enumerate("xyz")}
    return of_frame | position_m | {name: columns[name] for name in PER_POINT}


def _split_column(name: str, array: Array) -> dict[str, Any]:
    if array.dtype == object:
        return {name: pa.array([str(value) for value in array.tolist()], pa.string())}
    if array.ndim == 1:
        return {name: array}
    return {f"{name}_{i}": np.ascontiguousarray(array[:, i]) for i in range(array.shape[1])}
