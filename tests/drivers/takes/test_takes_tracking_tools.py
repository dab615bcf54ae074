"""Tracking Tools CSV exports: the row layout."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from take_files import TrackingToolsTake, read_all, write

from bench.drivers.takes import read_take
from bench.errors import RecordingError
from bench.model import NO_ID, StampKind

POINTS = [(1.0, 2.0, 3.0), (4.0, 5.0, 6.0)]


def test_a_1_0_take_has_no_ids_no_flags_and_the_files_own_times(tmp_path: Path) -> None:
    take = read_take(write(tmp_path, TrackingToolsTake([POINTS] * 5).text()))
    frames = list(take.frames)
    assert (take.info.version, take.info.rate_hz, take.info.stamp) == ("1.0", 100.0, StampKind.FILE_TIME)
    assert [frame.device_ticks for frame in frames] == [0, 10_000_000, 20_000_000, 30_000_000, 40_000_000]
    assert frames[0].ids.tolist() == [NO_ID, NO_ID]
    assert frames[0].flags.tolist() == [0, 0]
    np.testing.assert_array_equal(frames[0].points_m, np.float32(POINTS))
    assert take.info.warnings == ()


def test_the_rigid_body_has_its_name_pose_and_marker_offsets(tmp_path: Path) -> None:
    written = TrackingToolsTake([POINTS] * 2)
    take = read_take(write(tmp_path, written.text()))
    assert take.info.bodies == {7: "gripper"}
    assert take.info.body_markers == {"gripper": [list(offset) for offset in written.offsets]}
    (body,) = next(take.frames).bodies
    assert (body.body_id, body.position_m, body.quaternion_xyzw) == (7, (0.1, 0.2, 0.3), (0.0, 0.0, 0.0, 1.0))


def test_1_1_points_have_ids_and_names(tmp_path: Path) -> None:
    take = read_take(write(tmp_path, TrackingToolsTake([POINTS] * 2, version="1.1").text()))
    assert take.info.version == "1.1"
    assert next(take.frames).ids.tolist() == [1000, 1000]
    assert take.info.marker_names == {1000: "marker"}


def test_a_1_1_body_may_give_an_id_with_each_offset(tmp_path: Path) -> None:
    text = 'info,version,1.1\nrigidbody,"p",1,2,1,2,3,11,4,5,6,12\nframe,0,0.0,0,1,1,2,3,5,a\n'
    assert read_take(write(tmp_path, text)).info.body_markers == {"p": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]}


def test_the_extended_rows_after_a_frame_are_passed_over(tmp_path: Path) -> None:
    take = read_take(write(tmp_path, TrackingToolsTake([POINTS] * 3, extended=True).text()))
    assert len(list(take.frames)) == 3
    assert take.info.bodies == {7: "gripper"}
    assert take.info.warnings == ()


def test_the_rate_is_the_median_step_even_when_frames_are_missing(tmp_path: Path) -> None:
    lines = TrackingToolsTake([POINTS] * 9, step_s=0.004).text().splitlines()
    del lines[8:11]
    take = read_take(write(tmp_path, "\n".join(lines) + "\n"))
    assert take.info.rate_hz == 250.0
    assert take.info.warnings == ("The header promises 9 frames, 6 were found.",)


def test_frames_may_hold_no_points_and_no_bodies(tmp_path: Path) -> None:
    take = read_take(write(tmp_path, "info,framecount,2\nframe,0,0.0,0,0\nframe,1,0.1,0,1,1,2,3,0\n"))
    assert [len(frame.points_m) for frame in take.frames] == [0, 1]


def test_lines_of_an_unknown_kind_are_counted(tmp_path: Path) -> None:
    text = TrackingToolsTake([POINTS] * 2).text() + "skeleton,1,2\nskeleton,3\n\n"
    take = read_take(write(tmp_path, text))
    assert take.info.warnings == ("2 lines that begin with 'skeleton' are not known and were skipped.",)


def test_a_last_line_without_an_end_is_left_out_and_reported(tmp_path: Path) -> None:
    take = read_take(write(tmp_path, TrackingToolsTake([POINTS] * 3).text()[:-1]))
    assert len(list(take.frames)) == 2
    assert len(take.info.warnings) == 2
    assert "may be cut" in take.info.warnings[0]
    assert "promises 3 frames, 2 were found" in take.info.warnings[1]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("2.00000000", "2.0x", r"line 6: '2.0x' in column y of marker 1 is no number"),
        ("2.00000000", "", r"line 6: '' in column y of marker 1 is no number"),
        ("2.00000000", "nan", r"line 6: 'nan' in column y of marker 1 is no number"),
        ("2.00000000", "1e300", r"line 6: 1e300 m in column y of marker 1 is no position"),
        (",2,1.00000000", ",3,1.00000000", r"line 6: 3 markers are promised, and it ends after 24 cells"),
        (",2,1.00000000", ",many,1.00000000", r"line 6: 'many' in column marker count is no whole number"),
        ("frame,0,", "frame,zero,", r"line 6: 'zero' in column frame number is no whole number"),
        ("frame,0,0.00000000", "frame,0,later", r"line 6: 'later' in column time is no number"),
        ("frame,0,0.00000000,1", "frame,0,0.00000000,100000", r"line 6: it ends after"),
        ("framecount,2", "framecount,two", r"line 3: 'two' in column framecount"),
        ("righthanded", "info,version,7", r"its version is '7'"),
        ('"gripper",7,3', '"gripper",7,4', r"line 5: rigid body 'gripper' promises 4 markers and gives 9 cells"),
    ],
)
def test_damage_is_named_with_its_place(old: str, new: str, said: str, tmp_path: Path) -> None:
    text = TrackingToolsTake([POINTS] * 2).text()
    assert old in text
    with pytest.raises(RecordingError, match=said):
        read_all(write(tmp_path, text.replace(old, new, 1)))


def test_a_take_without_frames_or_points_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="it holds no frames"):
        read_take(write(tmp_path, TrackingToolsTake([]).text()))
    with pytest.raises(RecordingError, match="no marker is seen in any of its 2 frames"):
        read_all(write(tmp_path, TrackingToolsTake([[], []]).text()))


coordinate = st.integers(-(10**9), 10**9).map(lambda n: n / 1e8)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.lists(st.tuples(coordinate, coordinate, coordinate), max_size=6), min_size=1, max_size=6).filter(any),
    st.sampled_from(["", "1.0", "1.1"]),
)
def test_what_is_written_is_read_back(frames: list[list[tuple[float, float, float]]], version: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        take = read_take(write(Path(folder), TrackingToolsTake(frames, version).text()))
        read = [frame.points_m for frame in take.frames]
    assert len(read) == len(frames)
    for written, points in zip(frames, read, strict=True):
        np.testing.assert_array_equal(points, np.array(written, np.float32).reshape(-1, 3))


@pytest.mark.parametrize(("name", "least", "most"), [("cable_a_clean", 17, 17), ("cable_a_hard", 13, 24)])
def test_a_recorded_cable_is_read_whole(shared_data: Path, name: str, least: int, most: int) -> None:
    take = read_take(shared_data / "cable" / f"{name}.csv")
    assert take.info.rate_hz == 100.0
    with np.load(shared_data / "cable" / f"{name}.truth.npz") as truth:
        frames = list(take.frames)
        assert len(frames) == len(truth["source"])
        assert {min(counts := [len(frame.points_m) for frame in frames]), max(counts)} == {least, most}
        for frame, source, xyz in zip(frames[::50], truth["source"][::50], truth["xyz"][::50], strict=True):
            seen = source >= 0  # the truth has no noise, the points have
            np.testing.assert_allclose(frame.points_m[source[seen]], xyz[seen], atol=1e-3)
