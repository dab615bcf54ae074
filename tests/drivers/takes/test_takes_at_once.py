"""A block is read at once, and cell by cell where it is odd: both give the same, and real files need only the first."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from take_files import RIGID_BODY, WITH_MARKERS, MotiveTake, TrackingToolsTake, TrcTake, read_all, write

from bench.drivers.takes import columns, read_take, tracking_rows
from bench.errors import RecordingError
from bench.model import TrackerFrame

POINT = (1.0, 2.0, 3.0)


@contextmanager
def never_at_once() -> Iterator[None]:
    with (
        mock.patch.object(columns, "_parse", return_value=None),
        mock.patch.object(tracking_rows, "_read_plain", return_value=None),
    ):
        yield


@contextmanager
def always_at_once() -> Iterator[None]:
    failure = AssertionError("read cell by cell")
    with (
        mock.patch.object(columns.ColumnTable, "_read_line_by_line", side_effect=failure),
        mock.patch.object(tracking_rows, "_read_line_by_line", side_effect=failure),
    ):
        yield


def assert_same(quick: list[TrackerFrame], careful: list[TrackerFrame]) -> None:
    assert len(quick) == len(careful)
    for one, other in zip(quick, careful, strict=True):
        for name in ("points_m", "ids", "flags", "residual_m"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert (one.frame_number, one.device_ticks) == (other.frame_number, other.device_ticks)
        assert repr(one.bodies) == repr(other.bodies)  # NaN differs from itself


def assert_read_alike(path: Path) -> None:
    with always_at_once():
        quick = read_all(path)
    with never_at_once():
        assert_same(quick, read_all(path))


@pytest.mark.parametrize("path", [WITH_MARKERS, RIGID_BODY], ids=lambda path: path.stem)
def test_real_files_are_read_at_once_and_alike(path: Path) -> None:
    assert_read_alike(path)


@pytest.mark.parametrize(
    "text",
    [
        MotiveTake(
            ["a", "b"], [[POINT, None], [None, None]], bodies=["p"], poses=[[None], [(0, 0, 0, 1, 1, 2, 3, 0)]]
        ).text(),
        MotiveTake(["a"], [[POINT]] * 3, timecode=True).text(),
        MotiveTake(["a"], [[POINT]] * 3).text().replace("\n", ",,\n"),
        TrcTake(["a", "b"], [[POINT, None], [None, None]]).text(),
        TrcTake(["a"], [[POINT]] * 3).text().replace("\n", "\t\n"),
        TrackingToolsTake([[POINT] * 3, [], [POINT]], extended=True).text(),
        TrackingToolsTake([[POINT] * 3, [], [POINT]], version="1.1").text(),
        TrackingToolsTake([[POINT] * 3, [], [POINT]], version="1.1", bodies=False).text().replace(",marker", ""),
    ],
    ids=range(8),
)
def test_every_layout_is_read_at_once_and_alike(text: str, tmp_path: Path) -> None:
    assert_read_alike(write(tmp_path, text))
    assert_read_alike(write(tmp_path, text.replace("\n", "\r\n").encode("utf-16")))


odd = st.sampled_from(
    ["", " ", "nan", "-0", "+1.5", "1e-3", "0x1", "1.5.", "--", "١", '"2.5"', '"', "1e400", "x", "1,5"]
)


@settings(max_examples=100, deadline=None)
@given(st.data(), st.sampled_from(["motive", "trc", "tools"]))
def test_odd_cells_are_read_alike_or_refused_alike(data: st.DataObject, kind: str) -> None:
    text = {
        "motive": MotiveTake(["a", "b"], [[POINT, POINT]] * 3),
        "trc": TrcTake(["a", "b"], [[POINT, POINT]] * 3),
        "tools": TrackingToolsTake([[POINT, POINT]] * 3, bodies=False),
    }[kind].text()
    sign = "\t" if kind == "trc" else ","
    lines = text.splitlines()
    for row in data.draw(st.lists(st.integers(-3, -1), min_size=1, max_size=3)):
        cells = lines[row].split(sign)
        cells[data.draw(st.integers(0, len(cells) - 1))] = data.draw(odd)
        lines[row] = sign.join(cells)
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder), "\n".join(lines) + "\n")
        quick = read_or_refuse(path)
        with never_at_once():
            careful = read_or_refuse(path)
    if isinstance(quick, list) and isinstance(careful, list):
        assert_same(quick, careful)
    else:
        assert quick == careful


def read_or_refuse(path: Path) -> list[TrackerFrame] | str:
    try:
        return read_all(path)
    except RecordingError as error:
        return str(error)


def test_a_frame_number_that_fills_the_head_of_its_line_is_read_alike(tmp_path: Path) -> None:
    text = MotiveTake(["a"], [[POINT]] * 3).text().replace("\n1,0.008000,", "\n1,0.008" + "0" * 80 + ",")
    assert_read_alike(write(tmp_path, text))


def test_the_progress_of_looking_through_a_file_ascends_to_its_end(tmp_path: Path) -> None:
    text = MotiveTake(["a"], [[POINT]] * 4).text()
    head, row = text.rsplit("\n", 2)[0] + "\n", "{},0.0,1.000000,2.000000,3.000000\n"
    path = write(tmp_path, head + "".join(row.format(i) for i in range(4, 60_000)))
    told: list[float] = []
    read_take(path, told.append)
    assert len(told) > 1
    assert told == sorted(told)
    assert told[-1] == 1.0
