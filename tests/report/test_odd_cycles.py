"""Cycles without frames, without markers or without numbers are marked as such, and the others are as they were."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_examples import CYCLE_S, START_S, TRACKER_HZ, WAIT_S, RunSpec, write_run

from bench.recording import open_run
from bench.report.html import render_report
from bench.report.pipeline import analyse_run
from bench.report.results import Results
from bench.report.tables import write_tables

Change = Callable[[dict[str, Any]], dict[str, Any] | None]
ODD = 2


def in_odd_cycle(change: Change) -> Callable[[int, dict[str, Any]], dict[str, Any] | None]:
    """Change the frames of one cycle."""

    def changed(i: int, values: dict[str, Any]) -> dict[str, Any] | None:
        since = i / TRACKER_HZ - START_S - ODD * (CYCLE_S + WAIT_S)
        return change(values) if -WAIT_S / 2 < since < CYCLE_S + WAIT_S / 2 else values

    return changed


def no_points(values: dict[str, Any]) -> dict[str, Any]:
    return values | {name: values[name][:0] for name in ("points_m", "ids", "flags", "residual_m")}


def no_numbers(values: dict[str, Any]) -> dict[str, Any]:
    return values | {"points_m": values["points_m"] * np.float32("nan")}


def analyse(folder: Path, spec: RunSpec) -> Results:
    write_run(folder / "run.mcap", spec)
    results = analyse_run(open_run(folder / "run.mcap"))
    assert render_report(results)
    write_tables(results, folder / "out")
    return results


@pytest.mark.parametrize("n_cycles", [4, 23])
@pytest.mark.parametrize("change", [no_points, no_numbers, lambda _: None], ids=["hidden", "NaN", "no frames"])
def test_an_odd_cycle_is_marked_and_the_others_are_measured(tmp_path: Path, change: Change, n_cycles: int) -> None:
    results = analyse(tmp_path, RunSpec(n_cycles=n_cycles, change_points=in_odd_cycle(change)))
    cycles = results.cycles
    assert cycles.cycle_index.tolist() == list(range(n_cycles))
    assert np.flatnonzero(np.isnan(cycles.max_curvature_per_m)).tolist() == [ODD]
    assert list(results.attention) == [ODD]
    assert cycles.verdict[ODD] == ("gap" if cycles.n_frames[ODD] == 0 else "ok")
    if results.drift is not None:
        assert results.drift.columns.watched.tolist() == [index != ODD for index in range(n_cycles)]
        assert np.isnan(results.drift.columns.shape_distance_mm[ODD])
        assert not any(change.matters for change in results.drift.changes)
    assert (results.drift is not None) == (n_cycles == 23)


@pytest.mark.parametrize("robot", [True, False])
@pytest.mark.parametrize("n_frames", [1, 2, 7])
def test_a_recording_of_hardly_any_frames_is_reported(tmp_path: Path, n_frames: int, robot: bool) -> None:
    spec = RunSpec(robot=robot, change_points=lambda i, values: values if i < n_frames else None)
    results = analyse(tmp_path, spec)
    assert len(results.frames.frame_number) == n_frames
    assert results.cycles.cycle_index.tolist() == ([0, 1, 2] if robot else [0])
    assert results.drift is None
