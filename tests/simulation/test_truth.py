import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from bench.errors import RecordingError, RecordingExistsError
from bench.simulation.cable import PlaceTable
from bench.simulation.path import JointPath
from bench.simulation.program import PathProgram
from bench.simulation.truth import TruthWriter
from bench.simulation.wear import WearTable

ARC_LENGTH = np.linspace(0.1, 0.9, 5)
PLACES = np.linspace(0.0, 1.0, 33)
CURVATURE = PlaceTable(np.sin(2 * np.pi * PLACES)[:, None] * np.arange(1.0, 6.0))
START = 1_700_000_000_000_000_000
PATH = JointPath()


def open_writer(path):
    return TruthWriter(path, WearTable([CURVATURE], 0), ARC_LENGTH, n_markers=3, facts={"tracker_stamp_delay_s": 0.002})


def put_cycles(writer, n_frames):
    program = PathProgram(cycle_s=1.0, path=PATH)
    program.play()
    motions = []
    for index in range(n_frames):
        now = START + index * 10_000_000
        program.tick(now, 10**6)
        motions.append(program.motion_at(now))
        writer.put(500 + index, now, motions[-1], np.array([index % 3, -1, 2], dtype=np.int16))
    return motions


def test_the_file_holds_one_row_for_each_frame(tmp_path):
    path = tmp_path / "truth.parquet"
    writer = open_writer(path)
    motions = put_cycles(writer, 4321)
    writer.close()
    table = pq.read_table(path)
    assert table.column_names == [
        "frame_number",
        "time_ns",
        "cycle_index",
        "cycle_phase",
        "source",
        "curvature_per_m",
    ]
    assert [str(field.type) for field in table.schema][:4] == ["int64", "int64", "int64", "double"]
    assert table.schema.field("source").type.list_size == 3
    assert table["frame_number"].to_pylist() == list(range(500, 4821))
    assert table["time_ns"][7].as_py() == START + 70_000_000
    assert table["source"][4].as_py() == [1, -1, 2]
    assert pq.ParquetFile(path).metadata.num_row_groups == 3
    running = [m.cycle_running for m in motions]
    assert [i >= 0 for i in table["cycle_index"].to_pylist()] == [r == 1 for r in running]


def test_the_cycle_under_way_is_numbered_from_0_and_outside_it_is_minus_1_and_nan(tmp_path):
    path = tmp_path / "truth.parquet"
    writer = open_writer(path)
    motions = put_cycles(writer, 300)
    writer.close()
    table = pq.read_table(path)
    cycle, phase = table["cycle_index"].to_numpy(), table["cycle_phase"].to_numpy()
    running = np.array([m.cycle_running for m in motions]) == 1
    np.testing.assert_array_equal(cycle[running], np.array([m.cycle_count for m in motions])[running])
    np.testing.assert_array_equal(phase[running], np.array([m.phase for m in motions])[running])
    assert set(cycle[running].tolist()) == {0, 1, 2}
    assert set(cycle[~running].tolist()) == {-1}
    assert np.isnan(phase[~running]).all()
    assert table["cycle_phase"].null_count == 0


def test_curvature_is_a_magnitude_at_the_arc_lengths_of_the_metadata(tmp_path):
    path = tmp_path / "truth.parquet"
    writer = open_writer(path)
    motions = put_cycles(writer, 150)
    writer.close()
    table = pq.read_table(path)
    assert json.loads(table.schema.metadata[b"arc_length_m"]) == ARC_LENGTH.tolist()
    assert json.loads(table.schema.metadata[b"scene"]) == {"tracker_stamp_delay_s": 0.002}
    expected = np.abs([CURVATURE.at(m.place) for m in motions])
    np.testing.assert_allclose(table["curvature_per_m"].to_pylist(), expected, rtol=1e-6, atol=1e-9)


def test_while_it_is_written_the_file_has_another_name(tmp_path):
    path = tmp_path / "truth.parquet"
    writer = open_writer(path)
    assert not path.exists()
    assert (tmp_path / "truth.parquet.active").exists()
    writer.close()
    writer.close()
    assert [p.name for p in tmp_path.iterdir()] == ["truth.parquet"]
    assert pq.read_table(path).num_rows == 0


@pytest.mark.parametrize("name", ["truth.parquet", "truth.parquet.active"])
def test_an_existing_file_is_refused_and_left_as_it_is(tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(RecordingExistsError, match="exists already and is not overwritten"):
        open_writer(tmp_path / "truth.parquet")
    assert (tmp_path / name).read_text() == "mine"


def test_a_file_that_appears_in_the_meantime_is_not_overwritten(tmp_path):
    path = tmp_path / "truth.parquet"
    writer = open_writer(path)
    path.write_text("mine")
    with pytest.raises(RecordingExistsError, match=r"the truth is in .*\.active"):
        writer.close()
    assert path.read_text() == "mine"


def test_a_folder_that_does_not_exist_is_one_sentence(tmp_path):
    with pytest.raises(RecordingError, match="cannot be created"):
        open_writer(tmp_path / "nowhere" / "truth.parquet")


def test_a_discarded_file_leaves_nothing_behind(tmp_path):
    writer = open_writer(tmp_path / "truth.parquet")
    put_cycles(writer, 10)
    writer.discard()
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_written_is_said_at_the_end_and_stops_nothing(tmp_path, monkeypatch):
    writer = open_writer(tmp_path / "truth.parquet")

    def fail(rows):
        raise OSError("no space left on device")

    monkeypatch.setattr(writer, "_write", fail)
    put_cycles(writer, 4500)
    with pytest.raises(RecordingError, match="incomplete: no space left on device"):
        writer.close()
    assert not (tmp_path / "truth.parquet").exists()
