"""Topics as Parquet: every value of the recording is in its table, and nothing is overwritten."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from run_examples import RunSpec, write_run

from bench.cli.export import export
from bench.errors import ConfigError, RecordingError, RecordingExistsError
from bench.recording import BODIES, FRAME, POINTS, ROBOT, Run, open_run
from bench.report.export import ExportFormat
from bench.report.export.topics import export_topics


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    path = tmp_path_factory.mktemp("recorded") / "run.mcap"
    write_run(path, RunSpec())
    return open_run(path)


def test_a_table_holds_every_value_of_its_topic(run: Run, tmp_path: Path) -> None:
    rows = export_topics(run, run.topics, tmp_path / "all")
    assert {path.name: n for path, n in rows.items()}["robot_state.parquet"] == run.topics[ROBOT]
    for topic in run.topics.keys() - {POINTS, BODIES}:
        table = pq.read_table(tmp_path / "all" / (topic.strip("/").replace("/", "_") + ".parquet"))
        assert table.num_rows == run.topics[topic]
        for name, array in run[topic].items():
            names = [name] if array.ndim == 1 else [f"{name}_{i}" for i in range(array.shape[1])]
            read = np.stack([table[one].to_numpy() for one in names], axis=1).reshape(array.shape)
            np.testing.assert_array_equal(read, array, err_msg=name)


def test_the_table_of_points_has_a_row_for_each(run: Run, tmp_path: Path) -> None:
    (path,) = export_topics(run, [POINTS], tmp_path / "points")
    table, points = pq.read_table(path), run[POINTS]
    position_m = np.stack([table[name].to_numpy() for name in ("x_m", "y_m", "z_m")], axis=1)
    assert position_m.tobytes() == points.points_m.tobytes()
    np.testing.assert_array_equal(table["frame_number"], np.repeat(points.frame_number, np.diff(points.offsets)))
    np.testing.assert_array_equal(table["flags"], points.flags)
    assert table.schema.metadata[b"bench.topic"] == b"/tracker/points"


def test_a_topic_without_messages_is_an_empty_table(run: Run, tmp_path: Path) -> None:
    (path,) = export_topics(run, ["/log"], tmp_path / "log")
    assert pq.read_schema(path).field("text").type == "string"
    assert pq.read_table(path).num_rows == 0


def test_nothing_is_written_where_one_of_the_files_exists(run: Run, tmp_path: Path) -> None:
    (tmp_path / "robot_state.parquet").write_text("mine")
    with pytest.raises(RecordingExistsError, match=r"robot_state\.parquet: not overwritten"):
        export_topics(run, [FRAME, ROBOT], tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["robot_state.parquet"]


def test_an_unknown_topic_is_named_with_the_known_ones(run: Run, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="'/robot' is no topic of a run file; there are: /robot/state"):
        export_topics(run, ["/robot"], tmp_path)


def test_a_folder_that_cannot_be_made_is_one_sentence(run: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be written"):
        export_topics(run, [FRAME], tmp_path / "file" / "inside")


def test_the_command_exports_what_it_can_of_an_unfinished_file(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap.active"
    cut.write_bytes(run.path.read_bytes()[:-2000])
    export(cut, ExportFormat.PARQUET, topics=["all"])
    assert "unfinished: " in capsys.readouterr().out
    assert pq.read_table(tmp_path / "cut.topics" / "tracker_frame.parquet").num_rows == open_run(cut).topics[FRAME]


@pytest.mark.parametrize(("format_", "config"), [("csv", None), ("parquet", Path("bench.toml"))])
def test_what_does_not_go_with_a_topic_is_refused(run: Run, format_: str, config: Path | None) -> None:
    with pytest.raises(ConfigError, match="--topic goes with --format parquet"):
        export(run.path, ExportFormat(format_), config=config, topics=["all"])
