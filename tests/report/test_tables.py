"""The tables hold what was found, in the types that were promised, and never replace a file."""

import itertools
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from run_examples import RunSpec, write_run

from bench.errors import RecordingError, RecordingExistsError
from bench.recording import open_run
from bench.report import tables
from bench.report.pipeline import analyse_run
from bench.report.results import Results
from bench.report.tables import TABLE_FILES, write_tables


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    write_run(path, RunSpec(n_cycles=3, change_points=lambda i, values: None if i == 5 else values))
    return analyse_run(open_run(path))


def lists(table: pa.Table, name: str) -> np.ndarray:
    column = table[name].combine_chunks()
    return column.flatten().to_numpy(zero_copy_only=False).reshape(len(table), column.type.list_size)


def test_the_columns_have_the_promised_types(results: Results, tmp_path: Path) -> None:
    paths = write_tables(results, tmp_path / "out")
    assert [path.name for path in paths] == list(TABLE_FILES)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(TABLE_FILES)
    keys = {"frame_number": "int64", "time_ns": "int64", "cycle_index": "int64", "cycle_phase": "double"}
    markers = {"source": pa.list_(pa.int16(), 6), "position_m": pa.list_(pa.float32(), 18), "confidence": pa.float32()}
    markers |= {"marker_confidence": pa.list_(pa.float32(), 6), "reason": pa.list_(pa.uint8(), 6)}
    curvature = {"curvature_per_m": pa.list_(pa.float32(), 100), "sigma_per_m": pa.list_(pa.float32(), 100)}
    for name, own in (("markers", markers), ("curvature", curvature)):
        schema = pq.read_schema(tmp_path / "out" / f"{name}.parquet")
        assert {field.name: str(field.type) for field in schema if field.name in keys} == keys
        assert {field.name: field.type for field in schema if field.name not in keys} == own
    cycles = pq.read_schema(tmp_path / "out" / "cycles.parquet")
    assert [str(cycles.field(name).type) for name in ("cycle_index", "start_ns", "end_ns", "n_frames")] == ["int64"] * 4
    assert str(cycles.field("verdict").type) == "string"
    floats = [field.name for field in cycles if str(field.type) == "double"]
    assert floats == [
        "duration_s",
        "complete_fraction",
        "max_curvature_per_m",
        "max_curvature_sigma_per_m",
        "max_curvature_arc_length_m",
        "min_bend_radius_mm",
        "mean_curvature_per_m",
    ]


def test_what_is_read_back_is_what_was_found(results: Results, tmp_path: Path) -> None:
    write_tables(results, tmp_path)
    markers, curvature = pq.read_table(tmp_path / "markers.parquet"), pq.read_table(tmp_path / "curvature.parquet")
    frames = results.frames
    for table in (markers, curvature):
        for name in ("frame_number", "time_ns", "cycle_index", "cycle_phase"):
            np.testing.assert_array_equal(table[name].to_numpy(), getattr(frames, name))
    np.testing.assert_array_equal(lists(markers, "source"), frames.source)
    np.testing.assert_array_equal(lists(markers, "position_m").reshape(frames.position_m.shape), frames.position_m)
    np.testing.assert_array_equal(lists(curvature, "curvature_per_m"), frames.curvature_per_m)
    np.testing.assert_array_equal(lists(curvature, "sigma_per_m"), frames.sigma_per_m)
    metadata = pq.read_schema(tmp_path / "curvature.parquet").metadata
    assert json.loads(metadata[b"arc_length_m"]) == results.arc_length_m.tolist()
    cycles = pq.read_table(tmp_path / "cycles.parquet").to_pydict()
    assert cycles["verdict"] == results.cycles.verdict
    assert cycles["min_bend_radius_mm"] == results.cycles.min_bend_radius_mm.tolist()


def test_floats_are_compressed_by_byte_planes(results: Results, tmp_path: Path) -> None:
    write_tables(results, tmp_path)
    group = pq.ParquetFile(tmp_path / "curvature.parquet").metadata.row_group(0)
    columns = {group.column(i).path_in_schema: group.column(i) for i in range(group.num_columns)}
    for name in ("curvature_per_m.list.element", "sigma_per_m.list.element", "cycle_phase"):
        assert "BYTE_STREAM_SPLIT" in columns[name].encodings
        assert columns[name].compression == "ZSTD"


def test_row_groups_end_where_cycles_end(results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "ROWS_PER_GROUP", 100)
    write_tables(results, tmp_path)
    file = pq.ParquetFile(tmp_path / "markers.parquet")
    index = [file.read_row_group(i)["cycle_index"].to_numpy() for i in range(file.num_row_groups)]
    assert len(index) >= 3
    assert all(a[-1] != b[0] for a, b in itertools.pairwise(index))
    assert np.array_equal(np.concatenate(index), results.frames.cycle_index)


def test_the_summary_is_plain_json_with_what_is_needed_to_repeat_it(results: Results, tmp_path: Path) -> None:
    write_tables(results, tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text("utf-8"), parse_constant=lambda name: pytest.fail(name))
    assert summary["outcome"] == "ERROR"  # one frame is missing
    assert summary["n_cycles"] == 3
    assert summary["cycles_by_verdict"]["ok"] == 3
    assert summary["min_bend_radius_mm"] == pytest.approx(results.cycles.min_bend_radius_mm.min())
    assert summary["config_sha256"] == results.config_sha256
    assert summary["methods"] == results.methods
    assert summary["arc_length_m"] == results.arc_length_m.tolist()
    assert summary["versions"]["bench"]


@pytest.mark.parametrize("taken", TABLE_FILES)
def test_a_folder_with_results_is_left_as_it_is(results: Results, tmp_path: Path, taken: str) -> None:
    (tmp_path / taken).write_text("mine")
    with pytest.raises(RecordingExistsError, match=f"already holds {taken}"):
        write_tables(results, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [taken]
    assert (tmp_path / taken).read_text() == "mine"


def test_a_folder_that_cannot_be_made_is_one_sentence(results: Results, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be written to"):
        write_tables(results, tmp_path / "file" / "out")


def test_results_without_frames_or_cycles_are_tables_too(tmp_path: Path) -> None:
    write_run(tmp_path / "empty.mcap", RunSpec(robot=False, change_points=lambda *_: None))
    empty = analyse_run(open_run(tmp_path / "empty.mcap"))
    write_tables(empty, tmp_path / "out")
    assert pq.read_table(tmp_path / "out" / "markers.parquet").num_rows == 0
    assert pq.read_table(tmp_path / "out" / "cycles.parquet").num_rows == 0
    assert json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))["min_bend_radius_mm"] is None
