"""Whatever a file holds, reading it as a take ends in frames or in one plain sentence."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from take_files import MotiveTake, TrackingToolsTake, write

from bench.drivers.takes import read_take
from bench.drivers.takes.grid import parse_start
from bench.errors import RecordingError

MOTIVE = MotiveTake(
    ["Pole:Marker1", "Unlabeled 2"],
    [[(0.1, 0.2, 0.3), None], [(0.1, 0.2, 0.3), (1.0, 2.0, 3.0)]],
    version="1.25",
    parents=["Pole", ""],
    bodies=["Pole"],
    poses=[[(0, 0, 0, 1, 0, 0, 0, 0)]] * 2,
).text()
TRACKING_TOOLS = TrackingToolsTake([[(0.1, 0.2, 0.3)], [(1.0, 2.0, 3.0)] * 2], version="1.1").text()


def read_or_refuse(data: bytes, folder: Path) -> int:
    """Return the number of frames, or -1 when the take is refused as it should be."""
    path = write(folder, data)
    try:
        take = read_take(path)
        n_frames = sum(1 for _ in take.frames)
    except RecordingError as error:
        assert path.name in str(error)
        return -1
    assert n_frames == take.info.frames_found
    return n_frames


@pytest.mark.parametrize("text", [MOTIVE, TRACKING_TOOLS])
def test_a_take_cut_at_any_byte_is_read_as_far_as_it_is_whole_or_refused(text: str, tmp_path: Path) -> None:
    data = text.encode()
    found = [read_or_refuse(data[:size], tmp_path) for size in range(len(data) + 1)]
    assert found == sorted(found)
    assert found[-1] == 2
    assert found[-2] == 1


@settings(max_examples=150, deadline=None)
@given(st.sampled_from([MOTIVE, TRACKING_TOOLS]), st.data())
def test_any_damaged_bytes_are_read_or_refused(text: str, data: st.DataObject) -> None:
    damaged = bytearray(text.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(damaged) - 1))
        damaged[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    with tempfile.TemporaryDirectory() as folder:
        read_or_refuse(bytes(damaged), Path(folder))


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=600))
@example(b"")
@example(b"\n\n")
@example(b"\xff\xfe")
@example(b"\xff\xfe\x00")
@example(b"\x02\x50")
@example(b"\x02\x50" + bytes(600))
@example(b"Format Version")
@example(b"Format Version\n")
@example(b"Format Version,1.23\n\n\nFrame\n")
@example(b"frame\n")
@example(b"frame,\n")
@example(b'frame,"')
def test_files_that_are_no_takes_are_refused(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        assert read_or_refuse(data, Path(folder)) == -1


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no such file"):
        read_take(tmp_path / "absent.csv")
    with pytest.raises(RecordingError, match="is a directory"):
        read_take(tmp_path)


@pytest.mark.parametrize(
    ("text", "start_ns"),
    [
        ("2016-01-05 03.49.50.755 PM", 1452008990_755_000_000),
        ("2016-01-05 12.00.00.000 AM", 1451952000_000_000_000),
        ("2016-01-05 15.49.50.755", 1452008990_755_000_000),
        ("2016-01-05 15:49:50", 1452008990_000_000_000),
        ("2016-01-05 15.49.50.755 PM", 0),
        ("2016-13-05 03.49.50.755 PM", 0),
        ("2023-11-28 10.27.58.765 DU.", 0),
        ("2023-11-28 下午 10.27.58.765", 0),
        ("9999-01-01 00.00.00.000", 0),
        ("", 0),
    ],
)
def test_only_unambiguous_start_times_are_understood(text: str, start_ns: int) -> None:
    assert parse_start(text)[0] == start_ns
