"""Motive CSV exports, real ones and ones written here."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from take_files import RIGID_BODY, WITH_MARKERS, WITHOUT_MARKERS, MotiveTake, read_all, write

from bench.drivers.takes import read_take
from bench.errors import RecordingError
from bench.model import StampKind

LABELED, UNLABELED = 0x0A, 0x12
POINT = (1.0, 2.0, 3.0)


def test_a_real_unlabeled_take_gives_every_frame_on_the_exact_grid() -> None:
    take = read_take(WITH_MARKERS)
    frames = list(take.frames)
    assert len(frames) == take.info.frames_found == take.info.frames_promised == 1353
    assert {len(frame.points_m) for frame in frames} == {15, 16, 17, 18}
    assert take.info.rate_hz == 360
    assert [frame.device_ticks for frame in frames] == [round(i * 1e9 / 360) for i in range(1353)]
    assert {frame.stamp for frame in frames} == {StampKind.FRAME_GRID}
    assert all((frame.flags == UNLABELED).all() for frame in frames)
    assert take.info.warnings == ()


def test_millimetres_become_metres_and_columns_keep_their_order() -> None:
    frame = next(read_take(WITH_MARKERS).frames)
    np.testing.assert_array_equal(frame.points_m[0], np.float32([2.659741943, -0.830793884, -2.862191650]))
    np.testing.assert_array_equal(frame.ids, np.arange(15))
    assert np.isnan(frame.residual_m).all()


def test_every_filled_cell_of_the_real_take_is_read() -> None:
    rows = [line.split(",")[2:] for line in WITH_MARKERS.read_text().splitlines()[7:]]
    filled = np.array([float(cell) for row in rows for cell in row if cell]) * 0.001
    read = np.concatenate([frame.points_m.ravel() for frame in read_take(WITH_MARKERS).frames])
    np.testing.assert_array_equal(read, filled.astype(np.float32))


def test_a_start_time_in_another_language_is_kept_as_text_only() -> None:
    info = read_take(WITH_MARKERS).info
    assert info.capture_start == "2023-11-28 10.27.58.765 DU."
    assert info.start_ns == 0
    assert "unknown" in info.time_origin


def test_a_take_exported_without_markers_is_refused_with_the_way_out() -> None:
    with pytest.raises(RecordingError, match=r"test_default.csv .*exported without markers.*'Markers'") as caught:
        read_take(WITHOUT_MARKERS)
    assert caught.value.exit_code == 5


def test_a_real_1_21_take_keeps_measured_markers_and_not_solved_ones() -> None:
    take = read_take(RIGID_BODY)
    frames = list(take.frames)
    assert len(frames) == 250
    assert {len(frame.points_m) for frame in frames} == {6}  # nine columns, three of them entirely blank
    np.testing.assert_array_equal(frames[0].flags, [UNLABELED] * 3 + [LABELED] * 3)
    np.testing.assert_array_equal(frames[0].points_m[3], np.float32([0.009933, 0.019160, 0.009812]))
    assert take.info.marker_names[3] == "Rigid Body 1:Marker1"


def test_the_rigid_body_of_a_real_take_has_pose_error_and_markers() -> None:
    take = read_take(RIGID_BODY)
    frames = list(take.frames)
    assert take.info.bodies == {1: "Rigid Body 1"}
    body = frames[0].bodies[0]
    assert body.position_m == (0.060002, 0.01915, 0.076611)
    assert body.quaternion_xyzw == (0.000035, 0.000016, -0.000030, -1.0)
    assert body.mean_error_m == 0.000004
    offsets = np.array(take.info.body_markers["Rigid Body 1"])
    for frame in frames:  # it hardly turns, so its markers stay where the offsets say, within the noise
        expected = offsets + frame.bodies[0].position_m
        np.testing.assert_allclose(frame.points_m[3:], expected, atol=4e-4)


def test_an_english_start_time_is_the_origin_of_the_times() -> None:
    take = read_take(RIGID_BODY)
    frame = next(take.frames)
    assert frame.capture_ns == 1452008990_755_000_000 == take.info.start_ns  # 2016-01-05 15:49:50.755
    assert frame.device_ticks == 0
    assert "time zone unknown" in take.info.time_origin


@pytest.mark.parametrize("version", ["1.2", "1.21", "1.22", "1.23", "1.24", "1.25"])
def test_every_version_of_the_column_layout_is_read(version: str, tmp_path: Path) -> None:
    take = MotiveTake(["Unlabeled 1", "Unlabeled 2"], [[POINT, None], [None, POINT]], version)
    frames = list(read_take(write(tmp_path, take.text())).frames)
    assert [frame.ids.tolist() for frame in frames] == [[0], [1]]


def test_a_timecode_column_parents_a_mark_and_a_spreadsheets_commas_do_no_harm(tmp_path: Path) -> None:
    text = MotiveTake(
        ["Pole:Marker1", "Unlabeled 9"],
        [[POINT, POINT]] * 3,
        version="1.25",
        timecode=True,
        parents=["Pole", ""],
        bodies=["Pole"],
        poses=[[(0, 0, 0, 1, 1, 2, 2.5, 0.001)], [None], [(0, 0, 0, 1, 1, 2, 2.5, 0.001)]],
    ).text()
    padded = "\ufeff" + "\r\n".join(line + ",,," for line in text.splitlines()) + "\r\n,,,,,,\r\n"
    take = read_take(write(tmp_path, padded))
    frames = list(take.frames)
    assert [len(frame.bodies) for frame in frames] == [1, 0, 1]
    assert frames[0].flags.tolist() == [LABELED, UNLABELED]
    assert take.info.body_markers == {"Pole": [[0.0, 0.0, 0.5]]}
    assert take.info.frames_promised == 3


def test_named_markers_of_no_rigid_body_are_the_cables_and_that_is_said(tmp_path: Path) -> None:
    take = read_take(write(tmp_path, MotiveTake(["Cable:Marker 001"], [[POINT]] * 2).text()))
    assert next(take.frames).flags.tolist() == [UNLABELED]
    assert any("Cable:Marker 001" in warning for warning in take.info.warnings)


def test_a_rigid_body_turned_a_quarter_has_its_markers_turned_back(tmp_path: Path) -> None:
    half = np.sqrt(0.5)
    text = MotiveTake(
        ["B:Marker1"], [[(1.0, 0.1, 0.0)]] * 2, bodies=["B"], poses=[[(0, 0, half, half, 1, 0, 0, 0)]] * 2
    )
    (marker,) = read_take(write(tmp_path, text.text())).info.body_markers["B"]
    np.testing.assert_allclose(marker, [0.1, 0, 0], atol=1e-6)


@pytest.mark.parametrize(("units", "metres"), [("Meters", 1.0), ("Centimeters", 0.01), ("Millimeters", 0.001)])
def test_the_headers_unit_counts(units: str, metres: float, tmp_path: Path) -> None:
    take = read_take(write(tmp_path, MotiveTake(["Unlabeled 1"], [[POINT]], units=units).text()))
    np.testing.assert_allclose(next(take.frames).points_m, [np.multiply(POINT, metres)], rtol=1e-6)


def test_a_range_that_begins_later_keeps_its_frame_numbers_on_the_grid(tmp_path: Path) -> None:
    text = MotiveTake(["Unlabeled 1"], [[POINT]] * 3, first_frame=1000, rate="59.94").text()
    frames = list(read_take(write(tmp_path, text)).frames)
    assert [frame.frame_number for frame in frames] == [1000, 1001, 1002]
    assert frames[1].device_ticks == round(1001 * 10**11 / 5994)


def test_an_export_that_keeps_the_captures_frame_numbers_follows_the_capture_rate(tmp_path: Path) -> None:
    take = MotiveTake(["Unlabeled 1"], [[POINT]] * 4, numbers=[0, 2, 4, 6], keys={"Export Frame Rate": "60.0"})
    read = read_take(write(tmp_path, take.text()))
    assert read.info.rate_hz == 120
    assert [frame.device_ticks for frame in read.frames][1] == round(2e9 / 120)


def test_times_on_no_grid_are_used_as_written_and_that_is_said(tmp_path: Path) -> None:
    take = MotiveTake(["Unlabeled 1"], [[POINT]] * 4).text().replace("0.008000", "0.012000")
    read = read_take(write(tmp_path, take))
    assert read.info.stamp is StampKind.FILE_TIME
    assert any("no grid of 120" in warning for warning in read.info.warnings)
    assert next(iter(list(read.frames)[1:])).device_ticks == 12_000_000


def test_fewer_rows_than_promised_are_reported_and_the_take_is_read(tmp_path: Path) -> None:
    take = read_take(write(tmp_path, MotiveTake(["Unlabeled 1"], [[POINT]] * 4, promised=9).text()))
    assert take.info.warnings == ("The header promises 9 frames, 4 were found.",)
    assert len(list(take.frames)) == 4


def test_a_last_line_without_an_end_is_left_out_and_reported(tmp_path: Path) -> None:
    text = MotiveTake(["Unlabeled 1"], [[POINT]] * 4).text()
    take = read_take(write(tmp_path, text[:-3]))
    assert take.info.frames_found == len(list(take.frames)) == 3
    assert "The last line (11) has no line end" in take.info.warnings[0]


def test_frames_that_repeat_are_left_out_and_counted(tmp_path: Path) -> None:
    take = read_take(write(tmp_path, MotiveTake(["Unlabeled 1"], [[POINT]] * 4, numbers=[0, 1, 1, 2]).text()))
    assert [frame.frame_number for frame in take.frames] == [0, 1, 2]
    assert take.info.warnings[0].startswith("1 frame is left out, in line 10: ")


def test_names_that_are_not_utf8_are_read_as_latin_1(tmp_path: Path) -> None:
    text = MotiveTake(["Prüfling:Marker1"], [[POINT]]).text()
    take = read_take(write(tmp_path, text.encode("latin-1")))
    assert take.info.marker_names == {0: "Prüfling:Marker1"}


def test_a_take_saved_by_a_spreadsheet_as_utf_16_is_read(tmp_path: Path) -> None:
    text = MotiveTake(["Unlabeled 1"], [[POINT]]).text()
    assert read_take(write(tmp_path, text.encode("utf-16"))).info.frames_found == 1


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("1.000000,2.000000", "1.000000,2.o", r"line 8: '2.o' in column 'Unlabeled 1 position Y' is no number"),
        ("1.000000,2.000000", "1.000000,", r"line 8: the marker 'Unlabeled 1' has not all of X, Y and Z"),
        ("1.000000,2.000000", "1.000000,inf", r"line 8: 'inf' in column .* is no finite number"),
        ("1.000000,2.000000", "1.000000,1e9", r"line 8: the marker 'Unlabeled 1' is more than 100000 m away"),
        ("1.000000,2.000000", "1.000000", r"line 8: it has 4 cells where the header has 5"),
        ("3.000000", "3.000000,4.0", r"line 8: it has 6 cells where the header has 5"),
        ("0,0.000000", "x,0.000000", r"line 8: 'x' in column Frame is no whole number"),
        ("0,0.000000", "0,", r"line 8: '' in column Time is no time"),
        ("1.23", "9.9", r"format version is '9.9'"),
        ("Meters", "Parsecs", r"length unit 'Parsecs' is not known"),
        ("120.000000", "fast", r"the frame rate 'fast' is no rate"),
        ("120.000000", "1e-99999999", r"the frame rate '1e-99999999' is no rate"),
        ("X,Y,Z", "X,Y,Y", r"does not give X, Y and Z once each for the marker 'Unlabeled 1'"),
        ("Frame,Time", "Rahmen,Zeit", r"no row that begins with 'Frame'"),
        ("Format Version,", "Format Version;", r"separated by semicolons and not by commas"),
    ],
)
def test_damage_is_named_with_its_place(old: str, new: str, said: str, tmp_path: Path) -> None:
    text = MotiveTake(["Unlabeled 1"], [[POINT]] * 2).text()
    with pytest.raises(RecordingError, match=said):
        read_all(write(tmp_path, text.replace(old, new, 2 if old == "120.000000" else 1)))


def test_a_take_in_which_nothing_is_seen_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no marker is seen in any of its 2 frames"):
        read_all(write(tmp_path, MotiveTake(["Unlabeled 1"], [[None]] * 2).text()))


coordinate = st.integers(-9_999_999, 9_999_999).map(lambda n: n / 1e6)
maybe_point = st.none() | st.tuples(coordinate, coordinate, coordinate)


@settings(max_examples=40, deadline=None)
@given(st.data(), st.sampled_from(["1.2", "1.21", "1.22", "1.25"]), st.booleans(), st.sampled_from(["\n", "\r\n"]))
def test_what_is_written_is_read_back(data: st.DataObject, version: str, timecode: bool, end: str) -> None:
    n = data.draw(st.integers(1, 5))
    frames = data.draw(st.lists(st.lists(maybe_point, min_size=n, max_size=n), min_size=1, max_size=6))
    if not any(point for frame in frames for point in frame):
        frames[0][0] = POINT
    names = [f"Unlabeled {1000 + i}" for i in range(n)]
    text = MotiveTake(names, frames, version, timecode=timecode).text().replace("\n", end)
    with tempfile.TemporaryDirectory() as folder:
        read = list(read_take(write(Path(folder), text)).frames)
    assert len(read) == len(frames)
    for written, frame in zip(frames, read, strict=True):
        seen = [i for i, point in enumerate(written) if point]
        assert frame.ids.tolist() == seen
        np.testing.assert_array_equal(frame.points_m, np.array([written[i] for i in seen], np.float32).reshape(-1, 3))
