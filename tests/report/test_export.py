"""Sorted markers as files of other programs: what was written is read back as a take."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from run_examples import RunSpec, write_run
from synthetic_results import make_results

from bench.drivers.takes import read_take
from bench.errors import AnalysisError, RecordingError, RecordingExistsError
from bench.model import DeviceInfo
from bench.recording import Run, open_run
from bench.report.export import ExportFormat
from bench.report.export.c3d_file import write_c3d
from bench.report.export.formats import export_markers
from bench.report.export.markers import SortedMarkers, place_on_grid
from bench.report.export.tables import write_csv, write_trc
from bench.report.pipeline import analyse_run
from bench.report.results import Results
from bench.report.tables import write_tables

START_NS = 1_700_000_000_123_000_000
NAN = float("nan")

Write = Callable[[SortedMarkers, Path], None]
WRITERS: dict[str, tuple[Write, int]] = {"csv": (write_csv, 0), "trc": (write_trc, 1), "c3d": (write_c3d, 0)}
"""And the number of each format's first frame."""


def make_markers(position_m: np.ndarray, row: list[int], rate_hz: float = 100.0, up_axis: str = "") -> SortedMarkers:
    n_markers = position_m.shape[1]
    names = tuple(f"M{i}" for i in range(1, n_markers + 1))
    return SortedMarkers(
        "cable, the first", names, rate_hz, np.array(row), position_m.astype(np.float32), START_NS, 7, up_axis
    )


def assert_read_back(markers: SortedMarkers, kind: str, path: Path) -> None:
    """Check that the file holds every row of the grid, every position and every gap."""
    write, first = WRITERS[kind]
    write(markers, path)
    take = read_take(path)
    frames = list(take.frames)
    assert take.info.rate_hz == markers.rate_hz
    assert take.info.frames_promised == take.info.frames_found == markers.n_rows
    assert tuple(take.info.marker_names.values()) == markers.names
    assert [frame.frame_number for frame in frames] == list(range(first, first + markers.n_rows))
    assert [frame.device_ticks for frame in frames] == [round(i * 1e9 / markers.rate_hz) for i in range(markers.n_rows)]
    read_m = np.full((markers.n_rows, len(markers.names), 3), np.nan)
    for i, frame in enumerate(frames):
        read_m[i, frame.ids] = frame.points_m
    written_m = np.full_like(read_m, np.nan)
    written_m[markers.row] = markers.position_m
    np.testing.assert_allclose(read_m, written_m, rtol=2e-7, atol=1e-9)  # float32 in metres and in millimetres


metres = st.floats(-50, 50, width=32)
maybe_point = st.just((NAN, NAN, NAN)) | st.tuples(metres, metres, metres)


@settings(max_examples=40, deadline=None)
@given(st.data(), st.sampled_from(["csv", "trc"]), st.sampled_from([100.0, 360.0, 59.94, 119.998763]))
def test_what_is_exported_is_imported_equal(data: st.DataObject, kind: str, rate_hz: float) -> None:
    n = data.draw(st.integers(1, 4))
    steps = data.draw(st.lists(st.integers(1, 3), max_size=8))
    points = [[data.draw(maybe_point) for _ in range(n)] for _ in range(len(steps) + 1)]
    points[0][0] = (1.0, 2.0, 3.0)
    markers = make_markers(np.array(points), [0, *np.cumsum(steps, dtype=int).tolist()], rate_hz)
    with tempfile.TemporaryDirectory() as folder:
        assert_read_back(markers, kind, Path(folder) / f"a.{kind}")


@pytest.mark.parametrize("kind", WRITERS)
def test_more_rows_than_are_written_at_once_keep_their_gaps(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    position_m = rng.normal(0, 1, (6000, 3, 3))
    position_m[rng.random((6000, 3)) < 0.2] = np.nan
    row = np.sort(rng.choice(9000, 6000, replace=False))
    markers = make_markers(position_m, (row - row[0]).tolist(), 360.0)
    assert_read_back(markers, kind, tmp_path / f"a.{kind}")


def test_a_c3d_file_says_which_axis_is_up_and_marks_gaps_by_their_residual(tmp_path: Path) -> None:
    position_m = np.array([[[1.0, 2.0, 3.0], [NAN, NAN, NAN]]])
    write_c3d(make_markers(position_m, [0], up_axis="z"), tmp_path / "a.c3d")
    content = ezc3d.c3d(str(tmp_path / "a.c3d"))
    assert content["parameters"]["POINT"]["Y_SCREEN"]["value"] == ["+Z"]
    assert content["data"]["meta_points"]["residuals"][0, :, 0].tolist() == [0.0, -1.0]
    assert content["data"]["points"][:3, 0, 0].tolist() == [1000.0, 2000.0, 3000.0]


@pytest.mark.parametrize(("kind", "told"), [("csv", True), ("c3d", True), ("trc", False)])
def test_the_axis_that_is_up_is_kept_where_the_format_has_a_place_for_it(kind: str, told: bool, tmp_path: Path) -> None:
    for axis in "xyz":
        path = tmp_path / f"{axis}.{kind}"
        WRITERS[kind][0](make_markers(np.ones((1, 2, 3)), [0], up_axis=axis), path)
        assert read_take(path).info.detail.get("up_axis") == (axis if told else None)


def test_a_c3d_file_cannot_count_so_many_frames(tmp_path: Path) -> None:
    markers = make_markers(np.ones((2, 1, 3)), [0, 65_535])
    with pytest.raises(RecordingError, match="has 65536 frames, and a C3D file counts 65535 at most") as caught:
        write_c3d(markers, tmp_path / "a.c3d")
    assert "csv" in caught.value.hint
    assert list(tmp_path.iterdir()) == []


def test_a_c3d_file_that_did_not_fit_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ezc3d.c3d.write", lambda _self, path: Path(path).write_bytes(b"cut"))
    with pytest.raises(RecordingError, match="did not fit"):
        write_c3d(make_markers(np.ones((2, 1, 3)), [0, 1]), tmp_path / "a.c3d")
    assert list(tmp_path.iterdir()) == []


# the grid


def test_rows_follow_the_trackers_numbers_although_its_clock_drifts() -> None:
    number = np.arange(100, 100_000, 3)
    time_ns = (number / 360 * (1 + 42e-6) * 1e9).astype(np.int64)
    np.testing.assert_array_equal(place_on_grid(number, time_ns, 360.0), number - 100)


def test_a_tracker_that_was_restarted_goes_on_where_its_time_says() -> None:
    number = np.array([500, 501, 502, 0, 1, 2, 90_000])
    time_s = np.array([0.0, 0.01, 0.02, 5.0, 5.01, 5.02, 5.05])
    row = place_on_grid(number, (time_s * 1e9).astype(np.int64), 100.0)
    assert row.tolist() == [0, 1, 2, 500, 501, 502, 505]


def test_a_frame_that_comes_twice_has_a_row_of_its_own() -> None:
    row = place_on_grid(np.array([4, 5, 5, 6]), np.array([0, 10, 10, 20]) * 1_000_000, 100.0)
    assert row.tolist() == [0, 1, 2, 3]


# a run


@pytest.fixture(scope="module")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Results]:
    path = tmp_path_factory.mktemp("export") / "run.mcap"
    write_run(path, RunSpec(n_cycles=2, devices=[DeviceInfo("tracker", "natnet", "192.0.2.20", rate_hz=100.0)]))
    run = open_run(path)
    return run, analyse_run(run)


@pytest.mark.parametrize("kind", list(ExportFormat))
def test_a_run_is_exported_in_every_format_and_never_over_a_file(
    kind: ExportFormat, analysed: tuple[Run, Results], tmp_path: Path
) -> None:
    path = tmp_path / f"run.{kind}"
    export_markers(*analysed, kind, path)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    before = path.read_bytes()
    with pytest.raises(RecordingExistsError, match="is not overwritten"):
        export_markers(*analysed, kind, path)
    assert path.read_bytes() == before


@pytest.mark.parametrize("kind", ["csv", "c3d", "trc"])
def test_an_exported_run_is_the_same_cable_on_the_trackers_grid(
    kind: str, analysed: tuple[Run, Results], tmp_path: Path
) -> None:
    run, results = analysed
    export_markers(run, results, ExportFormat(kind), tmp_path / f"a.{kind}")
    frames = list(read_take(tmp_path / f"a.{kind}").frames)
    place = results.frames.frame_number - results.frames.frame_number[0]
    assert len(frames) == place[-1] + 1
    for row, expected in zip(place, results.frames.position_m, strict=True):
        seen = np.isfinite(expected[:, 0])
        assert frames[row].ids.tolist() == np.flatnonzero(seen).tolist()
        np.testing.assert_allclose(frames[row].points_m, expected[seen], rtol=2e-7, atol=1e-9)


def test_parquet_is_the_reports_own_table(analysed: tuple[Run, Results], tmp_path: Path) -> None:
    run, results = analysed
    export_markers(run, results, ExportFormat.PARQUET, tmp_path / "a.parquet")
    write_tables(results, tmp_path / "report")
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "report" / "markers.parquet").read_bytes()


def test_parquet_is_imported_with_every_position_and_time(analysed: tuple[Run, Results], tmp_path: Path) -> None:
    run, results = analysed
    export_markers(run, results, ExportFormat.PARQUET, tmp_path / "a.parquet")
    frames = list(read_take(tmp_path / "a.parquet").frames)
    assert [frame.frame_number for frame in frames] == results.frames.frame_number.tolist()
    assert [frame.capture_ns for frame in frames] == results.frames.time_ns.tolist()
    for frame, expected in zip(frames, results.frames.position_m, strict=True):
        seen = np.isfinite(expected[:, 0])
        assert frame.ids.tolist() == np.flatnonzero(seen).tolist()
        np.testing.assert_array_equal(frame.points_m, expected[seen])


def test_the_time_of_the_first_frame_is_in_the_header(analysed: tuple[Run, Results], tmp_path: Path) -> None:
    run, results = analysed
    export_markers(run, results, ExportFormat.CSV, tmp_path / "a.csv")
    info = read_take(tmp_path / "a.csv").info
    assert 0 <= results.frames.time_ns[0] - info.start_ns < 1_000_000  # to the millisecond


def test_a_run_in_which_nothing_was_sorted_is_refused(analysed: tuple[Run, Results], tmp_path: Path) -> None:
    run, results = analysed
    blind = dataclasses.replace(results.frames, position_m=np.full_like(results.frames.position_m, np.nan))
    with pytest.raises(AnalysisError, match="No marker of the cable was found in any of the"):
        export_markers(run, dataclasses.replace(results, frames=blind), ExportFormat.CSV, tmp_path / "a.csv")
    assert list(tmp_path.iterdir()) == []


def test_frames_on_no_grid_are_refused(analysed: tuple[Run, Results], tmp_path: Path) -> None:
    run, results = analysed
    frames = results.frames
    late = dataclasses.replace(frames, time_ns=frames.time_ns * 1000)
    with pytest.raises(AnalysisError, match="spread over"):
        export_markers(run, dataclasses.replace(results, frames=late), ExportFormat.TRC, tmp_path / "a.trc")


def test_a_tracker_that_states_no_rate_has_the_one_its_frames_came_at(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap", RunSpec(n_cycles=1, devices=[DeviceInfo("tracker", "natnet", "192.0.2.20")]))
    run = open_run(tmp_path / "run.mcap")
    results = analyse_run(run)
    export_markers(run, results, ExportFormat.CSV, tmp_path / "a.csv")
    assert read_take(tmp_path / "a.csv").info.rate_hz == pytest.approx(100.0, rel=1e-3)
    one = make_results(1, 1)
    seen = dataclasses.replace(one.frames, position_m=np.ones_like(one.frames.position_m))
    with pytest.raises(AnalysisError, match="frame rate is not known"):
        export_markers(run, dataclasses.replace(one, frames=seen), ExportFormat.CSV, tmp_path / "b.csv")


def test_a_folder_that_is_not_there_is_one_sentence(analysed: tuple[Run, Results], tmp_path: Path) -> None:
    for kind in ExportFormat:
        with pytest.raises(RecordingError, match="cannot be written: no such file"):
            export_markers(*analysed, kind, tmp_path / "absent" / f"a.{kind}")
