"""``bench report``: where results go, what is refused, and which exit code comes back."""

from __future__ import annotations

import types
from pathlib import Path

import pytest
import typer
from synthetic_results import CONFIG, make_results

from bench.cli.report import report
from bench.config import parse_config
from bench.errors import BenchError, ConfigError, RecordingExistsError, RecordingUnfinishedError
from bench.model import Outcome


class Recordings:
    """Stands for the recordings and their analysis: a name decides the outcome, the settings used are kept."""

    def __init__(self) -> None:
        self.used = []

    def open_run(self, path: Path):
        if path.name.startswith("broken"):
            raise RecordingUnfinishedError(f"{path.name} is not a run file.")
        return types.SimpleNamespace(config=parse_config(CONFIG, "recorded"), name=path.name)

    def analyse_run(self, run, config, *, run_path: str):
        self.used.append(config)
        outcome = Outcome[run.name.split("-")[0].upper()] if "-" in run.name else Outcome.PASS
        return make_results(2, per_cycle=3, run_path=run_path, outcome=outcome, example=None)


@pytest.fixture
def recordings(monkeypatch):
    stand_in = Recordings()
    monkeypatch.setattr("bench.recording.open_run", stand_in.open_run)
    monkeypatch.setattr("bench.report.pipeline.analyse_run", stand_in.analyse_run)
    return stand_in


def code_of(*arguments, **options) -> int:
    with pytest.raises(typer.Exit) as caught:
        report(list(arguments), **options)
    return caught.value.exit_code


def test_the_results_stand_beside_the_run_by_default(recordings, tmp_path, capsys):
    assert code_of(tmp_path / "a.mcap") == 0
    names = {path.name for path in (tmp_path / "a").iterdir()}
    assert names == {"report.html", "summary.json", "cycles.parquet", "markers.parquet", "curvature.parquet"}
    said = capsys.readouterr().out
    first = ("PASS: No bend tighter", "cycles: 2 of 2 ok; every marker found in ", "smallest bend radius:")
    for part in (*first, "look at: Beside the clamps", "frames/s", "report.html"):
        assert part in said


@pytest.mark.parametrize(("name", "code"), [("pass-1", 0), ("fail-1", 1), ("error-1", 6)])
def test_the_outcome_decides_the_exit_code(recordings, tmp_path, name, code):
    assert code_of(tmp_path / f"{name}.mcap") == code


def test_several_runs_get_a_folder_each_and_the_largest_code_counts(recordings, tmp_path):
    runs = [tmp_path / "pass-1.mcap", tmp_path / "fail-2.mcap.active"]
    assert code_of(*runs, output=tmp_path / "out") == 1
    assert (tmp_path / "out" / "pass-1" / "report.html").is_file()
    assert (tmp_path / "out" / "fail-2" / "report.html").is_file()


def test_one_broken_run_does_not_keep_the_others_from_being_reported(recordings, tmp_path, capsys):
    assert code_of(tmp_path / "broken.mcap", tmp_path / "a.mcap") == 5
    assert (tmp_path / "a" / "report.html").is_file()
    said = capsys.readouterr()
    assert "broken.mcap is not a run file" in said.err
    assert [line for line in said.out.splitlines() if line.endswith("a.mcap:")] == [f"{tmp_path / 'a.mcap'}:"]


def test_a_single_broken_run_is_an_error_like_any_other(recordings, tmp_path):
    with pytest.raises(BenchError, match="is not a run file"):
        report([tmp_path / "broken.mcap"])
    assert not (tmp_path / "broken").exists()


def test_results_that_exist_are_refused_before_anything_is_done(recordings, tmp_path):
    code_of(tmp_path / "a.mcap")
    with pytest.raises(RecordingExistsError, match=r"report\.html"):
        report([tmp_path / "a.mcap"])
    assert len(recordings.used) == 1


def test_a_file_in_the_place_of_the_folder_is_refused(recordings, tmp_path):
    (tmp_path / "a").write_text("")
    with pytest.raises(RecordingExistsError, match="is a file, not a folder"):
        report([tmp_path / "a.mcap"])


def test_a_run_without_the_usual_ending_gets_a_folder_of_another_name(recordings, tmp_path):
    assert code_of(tmp_path / "pass-run") == 0
    assert (tmp_path / "pass-run-report" / "report.html").is_file()


def test_two_runs_of_one_name_are_refused_at_once(recordings, tmp_path):
    with pytest.raises(ConfigError, match="More than one run"):
        report([tmp_path / "x" / "a.mcap", tmp_path / "y" / "a.mcap"], output=tmp_path / "out")


def test_config_replaces_the_analysis_and_the_limits_and_nothing_else(recordings, tmp_path, capsys):
    text = CONFIG.replace("bend_radius_mm = 60.0", "bend_radius_mm = 75.0\nstretch = 0.05")
    text = (
        text.replace("192.168.0.10", "10.0.0.1").replace("0.06, 0.18", "0.05, 0.18")
        + "[analysis]\nmarker_noise_mm = 0.7\n"
    )
    (tmp_path / "other.toml").write_text(text, "utf-8")
    code_of(tmp_path / "a.mcap", config=tmp_path / "other.toml")
    used = recordings.used[0]
    assert used.cable.minimum_bend_radius_mm == 75.0
    assert used.cable.stretch == 0.05
    assert used.analysis.marker_noise_mm == 0.7
    assert used.robot.host == "192.168.0.10"
    assert used.cable.arc_length_m[0] == 0.06
    assert "other marker places" in capsys.readouterr().err
