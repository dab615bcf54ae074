"""The cable in the live view, by the configured estimator or by one that what is known by now allows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from run_examples import RunSpec, write_run
from test_cable_ends import CALIBRATED, HELD, LENGTH_M

from bench.live.cable import LiveCable
from bench.recording import BODIES, CLOCK, CYCLE, FRAME, POINTS, Run, RunFollower, open_run

POLE = 'kind = "static_marker"\nposition_m = [0.0, 0.0, 0.0]\nclamp_direction = [1.0, 0.0, 0.0]'
BY_ROD = replace(
    HELD,
    analysis='sorting = "chain"\ncurvature = "elastica"',
    anchor=POLE,
    extra_toml=HELD.extra_toml + "clamp_m = [0.0, 0.0, 0.0]\n",
)


def open_part(path: Path, spec: RunSpec) -> Run:
    write_run(path, spec)
    run = open_run(path)
    run.load((FRAME, POINTS, BODIES, CLOCK, CYCLE))
    return run


def test_a_heavy_rod_without_its_end_gives_way_to_the_bends_between_the_markers(tmp_path: Path) -> None:
    tcp = '[cable.end]\nkind = "tcp"\n' + CALIBRATED
    run = open_part(tmp_path / "run.mcap", replace(BY_ROD, extra_toml=tcp))
    cable, rows = LiveCable(RunFollower(run.path)), np.arange(0, 100, 10)
    frames = list(cable.trace(run, rows))
    assert len(frames) == len(rows)
    for frame in frames:
        assert len(frame.line_m) > 2
        assert np.isfinite(frame.curvature_per_m).all()
    assert "menger_gp" in cable.problem
    assert "the place of the cable's end is not known" in cable.problem


def test_a_heavy_rod_whose_ends_the_tracker_sees_is_drawn_live(tmp_path: Path) -> None:
    run = open_part(tmp_path / "run.mcap", replace(BY_ROD, seconds=0.2))
    cable = LiveCable(RunFollower(run.path))
    frames = list(cable.trace(run, np.arange(0, 20, 5)))
    assert cable.problem == ""
    assert [frame.arc_length_m[-1] for frame in frames] == [LENGTH_M] * 4
