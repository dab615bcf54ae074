"""``bench compare``: two recordings, or one and a shape; what is printed, left behind and refused."""

from __future__ import annotations

import json

import pytest
from run_examples import RunSpec, write_run

from bench.cli.app import app
from bench.cli.compare import Alignment, compare
from bench.cli.shapes import ShapeKind
from bench.errors import ConfigError, RecordingError, RecordingExistsError

AT_ORIGIN = 'kind = "static_marker"\nposition_m = [0.0, 0.0, 0.0]'


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    for name, spec in {
        "one": RunSpec(anchor=AT_ORIGIN),
        "two": RunSpec(anchor=AT_ORIGIN, n_cycles=2),
        "rest": RunSpec(anchor=AT_ORIGIN, robot=False, seconds=0.29),
    }.items():
        write_run(folder / f"{name}.mcap", spec)
    return folder


def test_two_runs_are_compared_as_from_the_command_line(runs, tmp_path, capsys):
    out = tmp_path / "out"
    both = [str(runs / "one.mcap"), str(runs / "two.mcap")]
    app(["compare", *both, "--align", "time", "--align", "space", "--output", str(out)], standalone_mode=False)
    said = capsys.readouterr().out
    for part in ("e of eq. (6):", "rms by coordinate:", "largest distance:", "aligned in space:", "page: "):
        assert part in said
    assert {path.name for path in out.iterdir()} == {"comparison.html", "difference.parquet", "summary.json"}
    with pytest.raises(RecordingExistsError, match=r"already holds comparison\.html"):
        app(["compare", *both, "--output", str(out)], standalone_mode=False)


def test_the_folder_is_named_after_both(runs, capsys):
    compare(runs / "one.mcap", runs / "two.mcap")
    assert (runs / "one-against-two" / "comparison.html").is_file()
    assert "aligned" not in capsys.readouterr().out


def test_a_run_is_compared_with_a_shape(runs, capsys):
    compare(runs / "rest.mcap", shape=ShapeKind.CIRCLE, radius_mm=400.0)
    summary = json.loads((runs / "rest-against-circle" / "summary.json").read_text("utf-8"))
    assert summary["e_mm"] < 0.1
    assert summary["second"] == "circle, r = 400 mm"
    assert "note: The shape stands still" in capsys.readouterr().out


def test_settings_of_another_file_are_used_for_both(runs, tmp_path):
    text = (
        "[cable]\nlength_m = 0.8\ndiameter_mm = 8.0\nmarker_arc_length_m = [0.06, 0.18, 0.30, 0.42, 0.54, 0.66]\n"
        'minimum_bend_radius_mm = 100.0\n[cable.anchor]\nkind = "none"\n[analysis]\narc_length_samples = 21\n'
    )
    (tmp_path / "other.toml").write_text(text, "utf-8")
    compare(runs / "one.mcap", runs / "two.mcap", config=tmp_path / "other.toml", output=tmp_path / "out")
    assert (tmp_path / "out" / "difference.parquet").is_file()


@pytest.mark.parametrize(
    ("second", "options", "sentence"),
    [
        (None, {}, r"Give either B\.mcap or --shape"),
        ("two.mcap", {"shape": ShapeKind.STRAIGHT}, r"Give either B\.mcap or --shape"),
        (None, {"shape": ShapeKind.STRAIGHT, "align": [Alignment.TIME]}, r"--align belongs to B\.mcap"),
        ("two.mcap", {"a_mm": 500.0}, "--a-mm belongs to --shape"),
        (None, {"shape": ShapeKind.CIRCLE}, "--shape circle needs --radius-mm"),
    ],
)
def test_what_does_not_belong_together_is_refused(runs, second, options, sentence):
    with pytest.raises(ConfigError, match=sentence):
        compare(runs / "one.mcap", runs / second if second else None, **options)


def test_a_file_that_is_not_there_is_named(runs):
    with pytest.raises(RecordingError, match=r"none\.mcap"):
        compare(runs / "one.mcap", runs / "none.mcap")


def test_a_file_in_the_place_of_the_folder_is_refused(runs, tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(RecordingExistsError, match="is a file, not a folder"):
        compare(runs / "one.mcap", runs / "two.mcap", output=tmp_path / "out")
