"""One slow cycle judged, on the simulated bench over real sockets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import typer
from bench_command import bench as run_command
from bench_command import simulated_file

import bench.run
from bench.cli.check import check
from bench.config import Config, load_config
from bench.errors import ConfigError
from bench.model import ExitStatus
from bench.recording import ROBOT, open_run
from bench.run import RunOptions, RunSummary, RunView
from bench.run.progress import Ending
from bench.simulation.markers import Markers
from bench.simulation.scene import make_cable, make_path

SCENE = "[simulation]\nplacement_sd_mm = 3.0\ncamera_count = 3"
SLOW_CAMERAS = (("tracker_rate_hz = 100", "tracker_rate_hz = 60"), ("cycle_s = 2.0", "cycle_s = 1.5"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return where a check of a bench with much to find is, and what it said."""
    folder = tmp_path_factory.mktemp("optics")
    config = simulated_file(
        folder,
        ("[simulation]", SCENE),
        ("tracker_rate_hz = 100", "tracker_rate_hz = 60"),
        ("cycle_s = 2.0", "cycle_s = 1.5"),
    )
    process = run_command("check", "--cycle", config, "--speed", "4", "--output", folder / "a.mcap")
    assert process.returncode == 0, process.stderr + process.stdout
    (folder / "said.txt").write_text(process.stdout, encoding="utf-8")
    return folder


def read_said(folder: Path) -> str:
    return (folder / "said.txt").read_text(encoding="utf-8")


def test_all_four_items_stand_in_one_table(folder: Path) -> None:
    table = read_said(folder).split("The optics, by the first cycle in")[1]
    for start in ("warn frame rate      60", "warn markers seen", "ok   common view", "warn marker places"):
        assert f"  {start}" in table
    assert "(limit: within 1 mm of [cable])" in table
    assert table.rstrip().endswith("Ready, with warnings.")


def test_the_line_to_paste_has_the_markers_where_they_really_are(folder: Path) -> None:
    config = load_config(folder / "simulated.toml")
    truth = Markers(config, make_cable(config, make_path(config))).arc_length_m
    line = next(line for line in read_said(folder).splitlines() if line.startswith("marker_arc_length_m = ["))
    measured = [float(value) for value in line.split("[")[1].rstrip("]").split(", ")]
    assert measured == pytest.approx(truth, abs=0.001)
    assert measured != pytest.approx(config.cable.arc_length_m, abs=0.002)


def test_pasted_into_the_configuration_the_lines_pass_their_checks(folder: Path) -> None:
    said = read_said(folder).splitlines()
    places = next(line for line in said if line.startswith("marker_arc_length_m = ["))
    speed = next(line for line in said if line.startswith("max_speed_m_s = "))
    text = (folder / "simulated.toml").read_text(encoding="utf-8")
    lines = [places if line.startswith("marker_arc_length_m") else line for line in text.splitlines()]
    lines.insert(lines.index("[cable]") + 1, speed)
    better = folder / "better.toml"
    better.write_text("\n".join(lines), encoding="utf-8")
    said_now = run_command("check", "--recording", folder / "a.mcap", better).stdout
    assert "ok   marker places" in said_now
    assert "marker_arc_length_m = [" not in said_now
    assert "max_speed_m_s =" not in said_now


def test_the_cycle_is_driven_slowly_and_the_slider_is_back_afterwards(folder: Path) -> None:
    robot = open_run(folder / "a.mcap")[ROBOT]
    assert set(robot.speed_fraction[(robot.runtime_state == 2) & (robot.cycle_running == 1)]) == {0.25}
    assert robot.speed_fraction[-1] == 1.0
    assert robot.runtime_state[-1] == 1
    assert "will drive one cycle, with the speed slider at 25%" in read_said(folder)


def test_a_recording_is_judged_by_its_own_configuration_without_a_bench(folder: Path) -> None:
    process = run_command("check", "--recording", folder / "a.mcap")
    assert process.returncode == 0, process.stderr
    assert process.stdout.split(".mcap:")[1] == read_said(folder).split("a.mcap:")[1]


def test_a_cycle_that_is_not_driven_to_its_end_is_not_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def drive(_config: Config, options: RunOptions, _view: RunView) -> RunSummary:
        ending = Ending(ExitStatus.ABORT, "aborted by the operator")
        return RunSummary(options.output, ending, 0, 1, {}, 0, 0.0, ["The speed slider was left low."])

    monkeypatch.setattr(bench.run, "run", drive)
    with pytest.raises(typer.Exit) as caught:
        check(cycle=True, output=tmp_path / "a.mcap")
    assert caught.value.exit_code == 4
    said = capsys.readouterr().out
    assert "warning: The speed slider was left low." in said
    assert "The optics were not judged: aborted by the operator." in said


@pytest.mark.parametrize(
    "options",
    [
        {"cycle": True, "watch": True},
        {"watch": True, "recording": Path("a.mcap")},
        {"cycle": True, "recording": Path("a.mcap")},
        {"output": Path("a.mcap")},
        {"speed": 4.0},
    ],
)
def test_options_that_do_not_go_together_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"one can be given|belong to --cycle"):
        check(**options)
