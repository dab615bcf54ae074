"""TRC files: tables with tabs."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from take_files import TrcTake, read_all, write

from bench.drivers.takes import read_take
from bench.errors import RecordingError
from bench.model import UNLABELED, StampKind

POINT = (1.0, 2.0, 3.0)


def test_named_markers_are_in_metres_on_the_grid_from_the_first_frame(tmp_path: Path) -> None:
    take = read_take(write(tmp_path, TrcTake(["base", "tip"], [[POINT, None], [None, POINT], [POINT] * 2]).text()))
    frames = list(take.frames)
    assert (take.info.format, take.info.rate_hz, take.info.units) == ("TRC", 120.0, "mm")
    assert take.info.marker_names == {0: "base", 1: "tip"}
    assert take.info.warnings == ()
    assert [frame.frame_number for frame in frames] == [1, 2, 3]
    assert [frame.device_ticks for frame in frames] == [0, 8_333_333, 16_666_667]
    assert {frame.stamp for frame in frames} == {StampKind.FRAME_GRID}
    assert [frame.ids.tolist() for frame in frames] == [[0], [1], [0, 1]]
    assert all((frame.flags & UNLABELED).all() for frame in frames)
    np.testing.assert_allclose(frames[2].points_m, [np.multiply(POINT, 1e-3)] * 2)


def test_unlabelled_markers_are_found_by_their_axes_wherever_they_stand(tmp_path: Path) -> None:
    text = TrcTake(["", ""], [[(1, 2, 3), (4, 5, 6)]], units="m").text()
    turned = text.replace("X1\tY1\tZ1\tX2\tY2\tZ2", "Z2\tX1\tY1\tX2\tY2\tZ1")
    (frame,) = read_all(write(tmp_path, turned))
    np.testing.assert_array_equal(frame.points_m, [[2, 3, 6], [4, 5, 1]])


def test_a_trailing_tab_carriage_returns_and_a_mark_do_no_harm(tmp_path: Path) -> None:
    lines = TrcTake(["a", "b"], [[POINT, None]] * 4).text().splitlines()
    text = "\ufeff" + "\t\r\n".join(lines) + "\t\r\n"
    frames = read_all(write(tmp_path, text))
    assert [frame.ids.tolist() for frame in frames] == [[0]] * 4


def test_a_take_that_begins_late_has_its_own_time_and_keeps_its_numbers(tmp_path: Path) -> None:
    frames = read_all(write(tmp_path, TrcTake(["a"], [[POINT]] * 2, rate="100", first_frame=501).text()))
    assert [(frame.frame_number, frame.device_ticks) for frame in frames] == [(501, 0), (502, 10_000_000)]


def test_times_on_no_grid_are_used_as_written_and_that_is_said(tmp_path: Path) -> None:
    text = TrcTake(["a"], [[POINT]] * 3).text().replace("0.017", "0.090")
    take = read_take(write(tmp_path, text))
    assert any("no grid of 120" in warning for warning in take.info.warnings)
    assert [frame.device_ticks for frame in take.frames][2] == 90_000_000


def test_fewer_frames_or_markers_than_promised_are_reported(tmp_path: Path) -> None:
    text = TrcTake(["a"], [[POINT]] * 3, promised=7).text().replace("7\t1\tmm", "7\t5\tmm")
    warnings = read_take(write(tmp_path, text)).info.warnings
    assert warnings == ("The header promises 7 frames, 3 were found.", "The header promises 5 markers, 1 were found.")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("1.000000\t2.000000", "1.000000\ttwo", r"line 7: 'two' in column 'a Y1' is no number"),
        ("1.000000\t2.000000", "1.000000\t", r"line 7: the marker 'a' has not all of X, Y and Z"),
        ("1.000000\t2.000000", "1.000000\t-inf", r"line 7: '-inf' in column 'a Y1' is no finite number"),
        ("1.000000\t2.000000", "1.000000", r"line 7: it has 4 cells where the header has 5"),
        ("\n1\t0.000", "\none\t0.000", r"line 7: 'one' in column Frame is no whole number"),
        ("\tmm\t", "\tcubit\t", r"length unit 'cubit' is not known"),
        ("120.00", "fast", r"the frame rate 'fast' is no rate"),
        ("X1\tY1\tZ1", "X1\tY1", r"line 5: marker 1 has not all of X, Y and Z"),
        ("X1\tY1\tZ1", "X1\tX1\tZ1", r"line 5: 'X1' in column 4 is there for the second time"),
        ("X1\tY1\tZ1", "X1\tY1\tQ1", r"line 5: 'Q1' in column 5 is no axis of a marker"),
        ("X1\tY1\tZ1", "\t\t", r"line 7: '1' in column 1 is no axis of a marker"),
        ("Frame#", "Bild", r"do not begin with frame number and time"),
        ("\t", " ", r"not separated by tabs"),
        ("\t", ",", r"not separated by tabs"),
    ],
)
def test_damage_is_named_with_its_place(old: str, new: str, said: str, tmp_path: Path) -> None:
    text = TrcTake(["a"], [[POINT]] * 2).text()
    assert old in text
    count = -1 if old in ("120.00", "\t") else 1
    with pytest.raises(RecordingError, match=said):
        read_all(write(tmp_path, text.replace(old, new, count)))


def test_a_file_of_nothing_but_its_header_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="it holds no frames"):
        read_take(write(tmp_path, TrcTake(["a"], []).text()))
    with pytest.raises(RecordingError, match="it ends within its header"):
        read_take(write(tmp_path, TrcTake(["a"], []).text()[:60] + "\n"))


coordinate = st.integers(-9_999_999, 9_999_999).map(lambda n: n / 1e6)
maybe_point = st.none() | st.tuples(coordinate, coordinate, coordinate)


@settings(max_examples=40, deadline=None)
@given(st.data(), st.booleans())
def test_what_is_written_is_read_back(data: st.DataObject, blank_line: bool) -> None:
    n = data.draw(st.integers(1, 5))
    frames = data.draw(st.lists(st.lists(maybe_point, min_size=n, max_size=n), min_size=1, max_size=6))
    if not any(point for frame in frames for point in frame):
        frames[0][0] = POINT
    text = TrcTake([f"m{i}" for i in range(n)], frames, units="m", blank_line=blank_line).text()
    with tempfile.TemporaryDirectory() as folder:
        read = read_all(write(Path(folder), text))
    assert len(read) == len(frames)
    for written, frame in zip(frames, read, strict=True):
        seen = [i for i, point in enumerate(written) if point]
        assert frame.ids.tolist() == seen
        np.testing.assert_array_equal(frame.points_m, np.array([written[i] for i in seen], np.float32).reshape(-1, 3))
