"""Sorted markers as `bench export` and `bench report` write them: the table ``markers.parquet``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from bench.drivers.takes.grid import MAX_FRAME_NUMBER, Survey, file_ticks
from bench.drivers.takes.rows import Rows, Stamps, make_frames
from bench.drivers.takes.take import MAX_POSITION_M, TICKS_PER_S, UNLABELED_FLAGS, Take, TakeInfo, unreadable
from bench.drivers.takes.text import Progress
from bench.model import StampKind

__all__ = ["is_parquet", "read_parquet"]

MAGIC = b"PAR1"
TIMES = ["frame_number", "time_ns"]
POSITIONS = "position_m"
ROWS_AT_ONCE = 4096
EXPORT_AGAIN = "Export it again with bench export."


def is_parquet(start: bytes) -> bool:
    """Whether a file that begins with `start` is a Parquet file."""
    return start.startswith(MAGIC)


def read_parquet(path: Path, progress: Progress | None = None) -> Take:
    """Read a table of sorted markers. Raises as `bench.drivers.takes.read_take` does.

    A frame's time is the one of the table: host time, from the first frame. All points are unlabeled, and a point's
    id is its marker's place along the cable, from 0.
    """
    table = _MarkerTable(path)
    survey = Survey()
    for stamps in table.stamps(progress):
        survey.add(stamps)
    info = TakeInfo(
        format="Parquet",
        version="",
        rate_hz=survey.median_rate_hz or float("nan"),
        stamp=StampKind.FILE_TIME,
        units="meters",
        frames_promised=table.n_rows,
        frames_found=survey.n_frames,
        marker_names={i: f"M{i + 1}" for i in range(table.n_markers)},
        start_ns=table.start_ns,
        time_origin="the table's own times, of the host",
        warnings=tuple(survey.warnings(table.n_rows)),
    )
    return Take(info, make_frames(path.name, table.rows(), file_ticks, info))


class _MarkerTable:
    """The file, verified to have the columns that are needed."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = parquet.ParquetFile(path)
            schema = self._file.schema_arrow
            kinds = [schema.field(name).type for name in (*TIMES, POSITIONS)]
        except (pa.ArrowException, OSError, KeyError, ValueError) as error:
            raise unreadable(path.name, "it is no table of markers that can be read", EXPORT_AGAIN) from error
        positions = kinds.pop()
        is_list = pa.types.is_fixed_size_list(positions) and pa.types.is_float32(positions.value_type)
        if kinds != [pa.int64(), pa.int64()] or not is_list or positions.list_size % 3 or not positions.list_size:
            raise unreadable(path.name, "its columns are not those of a table of markers", EXPORT_AGAIN)
        self.n_markers = positions.list_size // 3
        self.n_rows = self._file.metadata.num_rows
        if self.n_rows == 0:
            raise unreadable(path.name, "it holds no frames", EXPORT_AGAIN)
        self.start_ns = self._first_time_ns()

    def _first_time_ns(self) -> int:
        first = next(self._batches(TIMES), None)
        if first is None or not first.column(1)[0].is_valid:
            raise unreadable(self._path.name, "its first frame has no time", EXPORT_AGAIN)
        return int(first.column(1)[0].as_py())

    def stamps(self, progress: Progress | None) -> Iterator[Stamps]:
        done = 0
        for batch in self._batches(TIMES):
            yield self._stamps(batch, done)
            done += batch.num_rows
            if progress is not None:
                progress(done / self.n_rows)

    def rows(self) -> Iterator[Rows]:
        done = 0
        for batch in self._batches([*TIMES, POSITIONS]):
            stamps = self._stamps(batch, done)
            values = batch.column(2).flatten().to_numpy(zero_copy_only=False)
            if len(values) != 3 * self.n_markers * batch.num_rows:
                raise unreadable(self._path.name, f"rows {done + 1} and on: not all have positions", EXPORT_AGAIN)
            points_m = values.reshape(batch.num_rows, self.n_markers, 3)
            seen = np.isfinite(points_m).all(axis=2)
            if not (np.abs(points_m[seen]) < MAX_POSITION_M).all():
                raise unreadable(self._path.name, f"it has points more than {MAX_POSITION_M:g} m away", EXPORT_AGAIN)
            ids = np.nonzero(seen)[1].astype(np.uint32)
            flags = np.full(len(ids), UNLABELED_FLAGS, np.uint32)
            nothing = np.full(len(ids), np.nan, np.float32)
            yield Rows(stamps, seen.sum(axis=1), points_m[seen], ids, flags, nothing)
            done += batch.num_rows

    def _stamps(self, batch: pa.RecordBatch, done: int) -> Stamps:
        number, time_ns = (batch.column(i).to_numpy(zero_copy_only=False) for i in range(2))
        has_all = not (batch.column(0).null_count or batch.column(1).null_count)
        if not has_all or number.min() < 0 or number.max() > MAX_FRAME_NUMBER:
            what = f"rows {done + 1} and on: not all have a time, and a frame number from 0 to {MAX_FRAME_NUMBER}"
            raise unreadable(self._path.name, what, EXPORT_AGAIN)
        return Stamps(done + np.arange(1, len(number) + 1), number, (time_ns - self.start_ns) / TICKS_PER_S)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        """Yield the rows, some at a time. `RecordingError` if a page of them is damaged."""
        try:
            for batch in self._file.iter_batches(ROWS_AT_ONCE, columns=columns):
                yield batch.select(columns)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise unreadable(self._path.name, "it is cut off or damaged", EXPORT_AGAIN) from error
