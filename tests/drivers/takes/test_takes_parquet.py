"""Tables of sorted markers, as bench writes them, read as takes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from take_files import read_all, write

from bench.drivers.takes import read_take
from bench.errors import RecordingError
from bench.model import UNLABELED, StampKind

START_NS = 1_700_000_000_123_456_789


def make_table(n: int = 5, k: int = 2, **columns: Any) -> pa.Table:
    position_m = np.arange(3.0 * k * n, dtype=np.float32)
    position_m[3:6] = np.nan
    values = {
        "frame_number": pa.array(np.arange(100, 100 + n)),
        "time_ns": pa.array(START_NS + np.arange(n) * 8_333_333),
        "confidence": pa.array(np.ones(n, np.float32)),
        "position_m": pa.FixedSizeListArray.from_arrays(pa.array(position_m), 3 * k),
    }
    return pa.table(values | columns)


def write_table(folder: Path, table: pa.Table) -> Path:
    pq.write_table(table, folder / "markers.parquet")
    return folder / "markers.parquet"


def test_positions_gaps_numbers_and_times_are_those_of_the_table(tmp_path: Path) -> None:
    take = read_take(write_table(tmp_path, make_table()))
    frames = list(take.frames)
    assert (take.info.format, take.info.rate_hz, take.info.warnings) == ("Parquet", 120.0, ())
    assert take.info.marker_names == {0: "M1", 1: "M2"}
    assert [frame.frame_number for frame in frames] == list(range(100, 105))
    assert [frame.capture_ns for frame in frames] == [START_NS + i * 8_333_333 for i in range(5)]
    assert {frame.stamp for frame in frames} == {StampKind.FILE_TIME}
    assert [frame.ids.tolist() for frame in frames] == [[0]] + [[0, 1]] * 4
    assert all((frame.flags & UNLABELED).all() for frame in frames)
    np.testing.assert_array_equal(frames[4].points_m.ravel(), np.arange(24.0, 30.0))


def test_a_long_table_is_read_in_parts_and_tells_its_progress(tmp_path: Path) -> None:
    told: list[float] = []
    take = read_take(write_table(tmp_path, make_table(10_000)), told.append)
    assert len(list(take.frames)) == 10_000
    assert told == sorted(told)
    assert len(told) == 3
    assert told[-1] == 1.0


def test_rows_that_go_back_are_left_out_and_the_first_is_named(tmp_path: Path) -> None:
    numbers = pa.array(np.array([100, 101, 100, 102, 103]))
    take = read_take(write_table(tmp_path, make_table(frame_number=numbers)))
    assert [frame.frame_number for frame in take.frames] == [100, 101, 102, 103]
    assert "1 frame is left out, in line 3: " in take.info.warnings[0]


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (make_table().drop_columns(["position_m"]), "it is no table of markers that can be read"),
        (make_table(time_ns=pa.array(np.zeros(5))), "its columns are not those of a table of markers"),
        (make_table(position_m=pa.array([[1.0, 2.0, 3.0]] * 5)), "its columns are not those of a table of markers"),
        (make_table().slice(0, 0), "it holds no frames"),
        (make_table(frame_number=pa.array([1, 2, -3, 4, 5])), "rows 1 and on: not all have a time, and a frame number"),
        (
            make_table(frame_number=pa.array([1, 2, None, 4, 5])),
            "rows 1 and on: not all have a time, and a frame number",
        ),
        (make_table(time_ns=pa.array([1, 2, None, 4, 5])), "rows 1 and on: not all have a time"),
        (
            make_table(position_m=pa.array([[1.0, 2.0, 3.0], *[None] * 4], pa.list_(pa.float32(), 3))),
            "rows 1 and on: not all have positions",
        ),
        (
            make_table(position_m=pa.array([[1e9, 2.0, 3.0]] * 5, pa.list_(pa.float32(), 3))),
            "it has points more than 100000 m away",
        ),
        (
            make_table(position_m=pa.array([[np.nan] * 3] * 5, pa.list_(pa.float32(), 3))),
            "no marker is seen in any of its 5 frames",
        ),
    ],
    ids=range(10),
)
def test_another_table_is_refused_in_one_sentence(table: pa.Table, said: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=f"markers.parquet cannot be read: {said}"):
        read_all(write_table(tmp_path, table))


def test_a_damaged_table_is_read_or_refused(tmp_path: Path) -> None:
    data = write_table(tmp_path, make_table(50)).read_bytes()
    rng = np.random.default_rng(1)
    refused = 0
    for size in [4, 8, 12, len(data) // 2, len(data) - 1]:
        with pytest.raises(RecordingError, match="no table of markers that can be read"):
            read_all(write(tmp_path, data[:size], "cut.parquet"))
    for _ in range(100):
        damaged = bytearray(data)
        for place in rng.integers(4, len(data), 3):
            damaged[place] = rng.integers(256)
        try:
            read_all(write(tmp_path, bytes(damaged), "damaged.parquet"))
        except RecordingError:
            refused += 1
    assert refused > 10
