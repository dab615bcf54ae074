"""A take of every format becomes a report: the same cable, bent as far, whatever wrote the file."""

from __future__ import annotations

from pathlib import Path

import ezc3d
import numpy as np
import pytest
from take_files import MotiveTake, Point, TrackingToolsTake, TrcTake, write

from bench.config import parse_config, to_toml
from bench.model import Outcome
from bench.recording import open_run
from bench.report.export import ExportFormat
from bench.report.export.formats import export_markers
from bench.report.pipeline import analyse_run
from bench.report.results import Results
from bench.run.import_take import import_take
from bench.timing import RunClock

ARC_LENGTH_M = np.array([0.06, 0.16, 0.28, 0.36, 0.50, 0.58, 0.70])
TIGHTEST_M = 0.3
CONFIG = """
[cable]
length_m = 0.8
diameter_mm = 8.0
marker_arc_length_m = [0.06, 0.16, 0.28, 0.36, 0.50, 0.58, 0.70]
minimum_bend_radius_mm = 100.0
[cable.anchor]
kind = "static_marker"
position_m = [0.0, 0.0, 0.0]
"""
NAMES = ["clamp", *(f"Unlabeled {1000 + i}" for i in range(7))]


def make_frames(n: int = 200) -> list[list[Point]]:
    """A circular cable, clamped at the origin, that swings from 2 m radius to 300 mm and back; some markers hide."""
    rng = np.random.default_rng(5)
    curvature = 0.5 + (1 / TIGHTEST_M - 0.5) * np.sin(np.pi * (np.arange(n) + 0.5) / n)[:, None] ** 2
    arc = np.concatenate([[0.0], ARC_LENGTH_M])
    x, y = np.sin(curvature * arc) / curvature, (1 - np.cos(curvature * arc)) / curvature
    points = np.stack([x, y, np.zeros_like(x)], axis=2) + rng.normal(0, 1e-5, (n, len(arc), 3))
    hidden = rng.random((n, len(arc))) < 0.02
    hidden[:, 0] = False
    return [
        [None if hide else (p[0], p[1], p[2]) for p, hide in zip(frame, hides, strict=True)]
        for frame, hides in zip(points.tolist(), hidden.tolist(), strict=True)
    ]


def write_c3d(path: Path, frames: list[list[Point]]) -> Path:
    points_mm = np.array([[point or (np.nan,) * 3 for point in frame] for frame in frames]).transpose(2, 1, 0) * 1e3
    content = ezc3d.c3d()
    content["parameters"]["POINT"]["RATE"]["value"] = [120.0]
    content["parameters"]["POINT"]["LABELS"]["value"] = NAMES
    content["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    content["data"]["points"] = np.concatenate([points_mm, np.ones((1, *points_mm.shape[1:]))])
    content.write(str(path))
    return path


def write_take(kind: str, folder: Path) -> Path:
    frames = make_frames()
    if kind == "c3d":
        return write_c3d(folder / "take.c3d", frames)
    if kind == "trc":
        millimetres = [[point and (point[0] * 1e3, point[1] * 1e3, point[2] * 1e3) for point in f] for f in frames]
        return write(folder, TrcTake(NAMES, millimetres).text(), "take.trc")
    if kind in ("1.0", "1.1"):
        seen = [[point for point in frame if point] for frame in frames]
        version = "1.1" if kind == "1.1" else ""
        return write(folder, TrackingToolsTake(seen, version, step_s=1 / 120, bodies=False).text())
    return write(folder, MotiveTake(NAMES, frames, kind).text())


def report(take: Path, config_text: str, output: Path) -> Results:
    config = parse_config(config_text, "take.toml")
    import_take(take, config, to_toml(config), output, RunClock.start())
    return analyse_run(open_run(output))


def assert_is_the_cable(results: Results) -> None:
    assert results.outcome is Outcome.PASS, results.outcome_reasons
    assert len(results.frames.frame_number) == 200
    # the spline reads a circle's ends some percent tighter than they are
    np.testing.assert_allclose(results.cycles.min_bend_radius_mm, [1e3 * TIGHTEST_M], rtol=0.1)
    assert results.cycles.complete_fraction[0] > 0.8


@pytest.fixture(scope="module")
def radius_mm(tmp_path_factory: pytest.TempPathFactory) -> float:
    """Return what is measured of the cable in one of the formats."""
    folder = tmp_path_factory.mktemp("reference")
    results = report(write_take("1.23", folder), CONFIG, folder / "take.mcap")
    return float(results.cycles.min_bend_radius_mm[0])


@pytest.mark.parametrize("kind", ["1.0", "1.1", "1.2", "1.21", "1.22", "1.23", "1.24", "1.25", "c3d", "trc"])
def test_a_take_of_every_format_is_reported_the_same(kind: str, radius_mm: float, tmp_path: Path) -> None:
    results = report(write_take(kind, tmp_path), CONFIG, tmp_path / "take.mcap")
    assert_is_the_cable(results)
    np.testing.assert_allclose(results.cycles.min_bend_radius_mm, [radius_mm], rtol=1e-3)


@pytest.mark.parametrize("kind", list(ExportFormat))
def test_what_was_exported_is_reported_the_same(kind: ExportFormat, tmp_path: Path) -> None:
    results = report(write_take("1.23", tmp_path), CONFIG, tmp_path / "take.mcap")
    export_markers(open_run(tmp_path / "take.mcap"), results, kind, tmp_path / f"sorted.{kind}")
    no_anchor = CONFIG.partition("kind")[0] + 'kind = "none"\n'
    again = report(tmp_path / f"sorted.{kind}", no_anchor, tmp_path / "again.mcap")
    assert_is_the_cable(again)
    np.testing.assert_allclose(again.cycles.min_bend_radius_mm, results.cycles.min_bend_radius_mm, rtol=1e-4)
