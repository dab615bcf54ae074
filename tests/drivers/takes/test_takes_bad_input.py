"""What spreadsheets, other languages and accidents make of an export: read whole, or refused in one sentence."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from take_files import MotiveTake, TrackingToolsTake, TrcTake, read_all, write

from bench.drivers.takes import read_take
from bench.errors import RecordingError

POINTS = [(1.0, 2.0, 3.0), (4.0, 5.0, 6.0)]
MOTIVE = MotiveTake(["Unlabeled 1", "Unlabeled 2"], [POINTS] * 4).text()
TRC = TrcTake(["a", "b"], [POINTS] * 4, units="m").text()
TOOLS = TrackingToolsTake([POINTS] * 4, bodies=False).text()
FORMATS = {"motive": MOTIVE, "trc": TRC, "tracking tools": TOOLS}
SEPARATOR = {"motive": ",", "trc": "\t", "tracking tools": ","}


def trailing(text: str, separator: str) -> str:
    return text.replace("\n", separator * 4 + "\n")


HARMLESS: dict[str, Callable[[str, str], str]] = {
    "as it is": lambda text, _: text,
    "byte-order mark": lambda text, _: "\ufeff" + text,
    "carriage returns": lambda text, _: text.replace("\n", "\r\n"),
    "old Mac line ends": lambda text, _: text.replace("\n", "\r"),
    "trailing separators": trailing,
    "mark, carriage returns and trailing separators": lambda text, sign: (
        "\ufeff" + trailing(text, sign).replace("\n", "\r\n")
    ),
    "spaces around the numbers": lambda text, _: re.sub(r"(?<=[,\t])([26]\.0+)(?=[,\t\n])", r" \1 ", text),
}


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("change", HARMLESS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_what_does_no_harm_changes_nothing(name: str, change: str, encoding: str, tmp_path: Path) -> None:
    text = HARMLESS[change](FORMATS[name], SEPARATOR[name])
    assert change == "as it is" or text != FORMATS[name]
    text = text.removeprefix("\ufeff") if encoding == "utf-16" else text  # which has its own mark
    take = read_take(write(tmp_path, text.encode(encoding)))
    frames = list(take.frames)
    assert take.info.warnings == ()
    assert len(frames) == 4
    for frame in frames:
        np.testing.assert_array_equal(frame.points_m, np.float32(POINTS))


@pytest.mark.parametrize("name", FORMATS)
def test_blank_lines_between_the_rows_are_passed_over(name: str, tmp_path: Path) -> None:
    lines = FORMATS[name].splitlines(keepends=True)
    text = "".join(lines[:-3]) + "\n" + lines[-3] + ",,,,\n".replace(",", SEPARATOR[name]) + "".join(lines[-2:]) + "\n"
    frames = read_all(write(tmp_path, text))
    assert len(frames) == 4


@pytest.mark.parametrize("start", ["2023-11-28 下午 10.27.58.765", "2023-11-28 10.27.58.765 DU.", "28.11.2023 22:27"])
def test_a_start_time_in_any_language_is_only_text(start: str, tmp_path: Path) -> None:
    take = MotiveTake(["Unlabeled 1"], [[POINTS[0]]], keys={"Capture Start Time": start})
    info = read_take(write(tmp_path, take.text())).info
    assert (info.capture_start, info.start_ns) == (start, 0)


def test_columns_without_a_value_are_markers_that_were_never_seen(tmp_path: Path) -> None:
    text = MotiveTake(["Unlabeled 1", "Unlabeled 2", "Unlabeled 3"], [[None, POINTS[0], None]] * 3).text()
    assert [frame.ids.tolist() for frame in read_all(write(tmp_path, text))] == [[1]] * 3


def test_names_with_commas_in_quotes_are_whole(tmp_path: Path) -> None:
    text = MotiveTake(['"Cable, left:Marker 1"', '"He said ""no"""'], [POINTS]).text()
    take = read_take(write(tmp_path, text))
    assert take.info.marker_names == {0: "Cable, left:Marker 1", 1: 'He said "no"'}
    np.testing.assert_array_equal(next(take.frames).points_m, np.float32(POINTS))


def test_numbers_in_quotes_are_numbers(tmp_path: Path) -> None:
    for name, text in FORMATS.items():
        quoted = re.sub(r"(?<=[,\t])(\d\.0{6,8})(?=[,\t])", r'"\1"', text)
        assert '"2.0' in quoted
        frames = read_all(write(tmp_path, quoted))
        assert [len(frame.points_m) for frame in frames] == [2] * 4, name


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("promised", [2, 9])
def test_a_wrong_count_of_rows_is_said(name: str, promised: int, tmp_path: Path) -> None:
    old = {"motive": "Frames,4", "trc": "\t4\t2\t", "tracking tools": "framecount,4"}[name]
    take = read_take(write(tmp_path, FORMATS[name].replace(old, old.replace("4", str(promised)))))
    assert take.info.warnings == (f"The header promises {promised} frames, 4 were found.",)
    assert len(list(take.frames)) == 4


@pytest.mark.parametrize("name", FORMATS)
def test_a_last_row_that_is_cut_is_left_out_and_said(name: str, tmp_path: Path) -> None:
    take = read_take(write(tmp_path, FORMATS[name][:-4]))
    assert len(list(take.frames)) == 3
    n_lines = FORMATS[name].count("\n")
    assert take.info.warnings[0] == f"The last line ({n_lines}) has no line end and may be cut, so it is left out."


@pytest.mark.parametrize("name", FORMATS)
def test_frames_that_repeat_or_go_back_are_left_out_and_the_first_is_named(name: str, tmp_path: Path) -> None:
    lines = FORMATS[name].splitlines(keepends=True)
    again = [*lines[:-1], lines[-2], lines[-3], lines[-1]]
    take = read_take(write(tmp_path, "".join(again)))
    assert len(list(take.frames)) == 4
    assert take.info.warnings == (
        f"2 frames are left out, the first of them in line {len(lines)}: repeated, or back in number or in time.",
    )


def test_a_time_that_goes_back_alone_leaves_its_frame_out(tmp_path: Path) -> None:
    take = read_take(write(tmp_path, TOOLS.replace("frame,2,0.02", "frame,2,0.00")))
    assert [frame.frame_number for frame in take.frames] == [0, 1, 3]
    assert take.info.warnings[0].startswith("1 frame is left out, in line 7: ")


@pytest.mark.parametrize("text", ["nan", "NaN", "NAN"])
def test_no_number_in_words_is_a_gap_in_tables(text: str, tmp_path: Path) -> None:
    for table in (MOTIVE, TRC):
        odd = table.replace("1.000000", text).replace("2.000000", text).replace("3.000000", text)
        assert [frame.ids.tolist() for frame in read_all(write(tmp_path, odd))] == [[1]] * 4


REFUSED = [
    ("motive", ("5.000000", "inf"), r"line 8: 'inf' in column 'Unlabeled 2 position Y' is no finite number"),
    ("motive", ("5.000000", "-Infinity"), r"line 8: '-Infinity' in column 'Unlabeled 2 position Y' is no finite"),
    ("motive", ("5.000000", '"5,5"'), r"line 8: '5,5' in column 'Unlabeled 2 position Y' .* decimal comma"),
    ("motive", ("5.000000", "5,000000"), r"line 8: it has 9 cells where the header has 8"),
    ("motive", ("5.000000", "#REF!"), r"line 8: '#REF!' in column 'Unlabeled 2 position Y' is no number"),
    ("motive", ("5.000000", "1_000"), r"line 8: '1_000' in column 'Unlabeled 2 position Y' is no number"),
    ("motive", ("5.000000", "nan"), r"line 8: the marker 'Unlabeled 2' has not all of X, Y and Z"),
    (
        "motive",
        ("Length Units,Meters", "Length Units,Meters,Length Units,Feet"),
        r"line 1: .*'Meters' in column \d+ and",
    ),
    ("motive", ("Length Units,Meters", "Length Units,Smoots"), r"its length unit 'Smoots' is not known"),
    ("motive", ("(Seconds)", "(Milliseconds)"), r"line 7: 'Time \(Milliseconds\)' in column 2 is no time in seconds"),
    ("motive", ("0,0.000000", "-1,0.000000"), r"line 8: '-1' in column Frame is no whole number"),
    ("motive", ("0,0.000000", "0,-0.5"), r"line 8: '-0.5' in column Time is no time"),
    ("motive", (",", ";"), r"its cells are separated by semicolons and not by commas"),
    ("motive", (",", "\t"), r"its cells are separated by tabs and not by commas"),
    ("motive", ("Marker", "Bone"), r"it was exported without markers"),
    ("trc", ("5.000000", "inf"), r"line 7: 'inf' in column 'b Y2' is no finite number"),
    ("trc", ("5.000000", "5,000000"), r"line 7: '5,000000' in column 'b Y2' is no number: it has a decimal comma"),
    ("trc", ("5.000000", "5.000000\t1"), r"line 7: it has 9 cells where the header has 8"),
    ("trc", ("\tm\t", "\tm/mm\t"), r"its length unit 'm/mm' is not known"),
    ("tracking tools", ("5.00000000", "inf"), r"line 5: 'inf' in column y of marker 2 is no finite number"),
    ("tracking tools", ("5.00000000", "nan"), r"line 5: 'nan' in column y of marker 2 is no number"),
    ("tracking tools", ("5.00000000", '"5,5"'), r"line 5: '5,5' in column y of marker 2 .* decimal comma"),
    ("tracking tools", ("frame,0,", "frame,0.5,"), r"line 5: '0.5' in column frame number is no whole number"),
    ("tracking tools", ("frame,0,0.00000000", "frame,0,-1"), r"line 5: -1 s is no time of a take"),
]


@pytest.mark.parametrize(("name", "change", "said"), REFUSED, ids=[f"{name}: {new}" for name, (_, new), _ in REFUSED])
def test_what_cannot_be_read_is_one_sentence_with_its_place(
    name: str, change: tuple[str, str], said: str, tmp_path: Path
) -> None:
    old, new = change
    text = FORMATS[name]
    assert old in text
    with pytest.raises(RecordingError, match=said) as caught:
        read_all(write(tmp_path, text.replace(old, new, -1 if old in (",", "Marker") else 1)))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", FORMATS)
def test_an_odd_cell_far_down_a_long_file_has_the_right_line(name: str, tmp_path: Path) -> None:
    lines = FORMATS[name].splitlines(keepends=True)
    head, row = lines[:-4], lines[-4]
    first = "frame,0," if name == "tracking tools" else f"0{SEPARATOR[name]}" if name == "motive" else "1\t"
    time_s = "0.00000000" if name == "tracking tools" else "0.000"
    assert row.startswith(first + time_s)
    new_first = first.replace("0", "{}") if name != "trc" else "{}\t"
    rows = [
        row.replace(first + time_s, new_first.format(i) + f"{i / 100:.6f}", 1) for i in range(20_000)
    ]  # 1.3 MB: more than a block
    rows[19_000] = rows[19_000].replace("5.0", "5.o", 1)
    with pytest.raises(RecordingError, match=rf"line {len(head) + 19_001}: '5\.o\d+' in column"):
        read_all(write(tmp_path, "".join([*head, *rows])))


def test_a_file_without_lines_is_refused_before_it_fills_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bench.drivers.takes.text.MAX_LINE_BYTES", 3 << 20)
    path = write(tmp_path, MOTIVE.encode() + b"1," * (5 << 20))
    with pytest.raises(RecordingError, match="line 12: it is longer than 3 MB"):
        read_all(path)
