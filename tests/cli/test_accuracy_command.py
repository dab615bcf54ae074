"""``bench accuracy``: the study, a recorded shape, and what is refused."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from bench_command import bench, one_sentence

from bench.cli.accuracy import accuracy
from bench.cli.shapes import ShapeKind
from bench.config import parse_config
from bench.errors import AnalysisError, ConfigError, RecordingError, RecordingExistsError
from bench.model import NO_ID, StampKind, TrackerFrame
from bench.recording import RunWriter
from bench.timing import ManualClock

T0_NS = 1_700_000_000_000_000_000
TOML = """
[run]
name = "template"
[cable]
length_m = 2.5
diameter_mm = 8.0
marker_count = 8
marker_spacing_m = 0.3
shorten = 0.4
minimum_bend_radius_mm = 60.0
[cable.anchor]
kind = "none"
[analysis]
cycles = "whole"
"""
EVEN = tuple(0.3 * (i + 1) for i in range(8))
HOW_TO = Path(__file__).parents[2] / "docs" / "how-to" / "prove-your-set-up.md"


def write_circle(
    path: Path, radius_m: float = 0.4, n_frames: int = 30, toml: str = TOML, places_m: Sequence[float] = EVEN
) -> Path:
    """Record markers on a circle, as a tracker lists them."""
    writer, rng = (
        RunWriter(path, ManualClock(T0_NS), config_toml=toml, versions={}, run_id="circle"),
        np.random.default_rng(1),
    )
    angle = np.asarray(places_m) / radius_m
    ring = radius_m * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    for i in range(n_frames):
        points = rng.permutation(ring + rng.normal(0, 1e-4, ring.shape)).astype(np.float32)
        ns = T0_NS + i * 10_000_000
        writer.put(
            TrackerFrame(
                arrival_ns=ns + 1_000_000,
                capture_ns=ns,
                frame_number=i,
                device_ticks=i * 100_000,
                stamp=StampKind.MID_EXPOSURE,
                points_m=points,
                ids=np.full(8, NO_ID, np.uint32),
                flags=np.full(8, 0x12, np.uint32),
                residual_m=np.full(8, np.nan, np.float32),
                bodies=(),
            )
        )
    writer.close(exit_status="import", reason="")
    return path


def test_the_circle_of_the_how_to_is_measured_in_every_frame(tmp_path, capsys):
    block = re.search(r"<!-- file: circle.toml -->\n```toml\n(.*?)```", HOW_TO.read_text("utf-8"), re.DOTALL)
    assert block is not None
    places_m = parse_config(block.group(1), "circle.toml").cable.arc_length_m
    circle = write_circle(tmp_path / "circle.mcap", toml=block.group(1), places_m=places_m)
    accuracy(circle, shape=ShapeKind.CIRCLE, radius_mm=400.0, output=tmp_path / "out")
    assert "30 measured, 30 of 30 complete" in capsys.readouterr().out


def test_the_study_is_printed_and_left_in_a_folder(tmp_path):
    done = bench("accuracy", "--output", tmp_path / "study")
    assert done.returncode == 0, done.stderr
    for part in ("Circle, r = 0.4 m", "15.5 / 6.", "12.0 / 2.", "R 136 mm", "R 36 mm"):
        assert part in done.stdout
    assert {path.name for path in (tmp_path / "study").iterdir()} == {
        "accuracy.html",
        "accuracy.parquet",
        "summary.json",
    }
    again = bench("accuracy", "--output", tmp_path / "study")
    assert "already holds accuracy.html" in one_sentence(again, 5)


def test_a_recorded_circle_is_measured(tmp_path, capsys):
    run = write_circle(tmp_path / "circle.mcap")
    accuracy(run, shape=ShapeKind.CIRCLE, radius_mm=400.0)
    said = capsys.readouterr().out
    for part in ("circle, r = 400 mm", "30 measured, 30 of 30 complete", "fits them best", "spline", "page: "):
        assert part in said
    summary = json.loads((tmp_path / "circle-accuracy" / "summary.json").read_text("utf-8"))
    assert summary["own_size_mm"] == pytest.approx(400, abs=0.5)
    assert summary["noise_mm"] == pytest.approx(0.1, rel=0.2)


def test_settings_of_another_file_are_used(tmp_path):
    run = write_circle(tmp_path / "circle.mcap")
    (tmp_path / "other.toml").write_text(TOML + "arc_length_samples = 33\n", "utf-8")
    accuracy(run, shape=ShapeKind.CIRCLE, radius_mm=400.0, output=tmp_path / "out", config=tmp_path / "other.toml")
    assert (tmp_path / "out" / "accuracy.html").is_file()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({}, "A recording needs --shape"),
        ({"shape": ShapeKind.CIRCLE}, "--shape circle needs --radius-mm"),
        ({"shape": ShapeKind.CATENARY, "radius_mm": 400.0}, "--radius-mm does not belong to --shape catenary"),
        ({"shape": ShapeKind.STRAIGHT, "a_mm": 400.0}, "--a-mm does not belong to --shape straight"),
    ],
)
def test_a_shape_without_its_size_or_with_anothers_is_refused(tmp_path, options, sentence):
    with pytest.raises(ConfigError, match=sentence):
        accuracy(tmp_path / "circle.mcap", **options)


def test_options_of_a_recording_without_one_are_refused():
    with pytest.raises(ConfigError, match=r"--shape needs RUN\.mcap"):
        accuracy(None, shape=ShapeKind.CIRCLE)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(RecordingError, match=r"none\.mcap"):
        accuracy(tmp_path / "none.mcap", shape=ShapeKind.STRAIGHT)


def test_results_are_not_overwritten_nor_a_file_taken_for_their_folder(tmp_path):
    (tmp_path / "circle-accuracy").write_text("")
    with pytest.raises(RecordingExistsError, match="is a file, not a folder"):
        accuracy(tmp_path / "circle.mcap", shape=ShapeKind.STRAIGHT)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"shape": ShapeKind.CIRCLE, "radius_mm": 300.0}, "has only 1885 mm"),
        ({"shape": ShapeKind.STRAIGHT}, "do not lie on the shape"),
    ],
)
def test_a_shape_that_was_not_recorded_is_refused(tmp_path, options, sentence):
    run = write_circle(tmp_path / "circle.mcap")
    with pytest.raises(AnalysisError, match=sentence):
        accuracy(run, **options)
    assert not (tmp_path / "circle-accuracy").exists()
