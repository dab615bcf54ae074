"""A simulated cable that gets softer is found to change, by about what it does; one that does not wear is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.config import Config, parse_config, simulated_config_text, to_toml
from bench.model import ClockSample, ClockSource, RobotState, StampKind, TrackerFrame
from bench.recording import RunWriter, open_run
from bench.report.drift_text import list_drift
from bench.report.pipeline import analyse_run
from bench.report.results import Results
from bench.simulation.path import place_at_phase
from bench.simulation.program import PathProgram
from bench.simulation.scene import Scene, make_cable, make_path
from bench.simulation.wear import LEVELS, WearTable
from bench.timing import ManualClock

START_NS = 1_700_000_000_000_000_000
STEP_NS = 40_000_000
N_CYCLES, HALF_AFTER, N_REFERENCES = 60, 320, 10
QUICK_HALF_AFTER = 80
"""So the worst marker moves by 13 mm in the test, and leaves its gate within 25 cycles."""
N_BINS = 6
"""Of the phase, that a cycle of 25 frames has in the report: within one the shape is a mean."""


def make_config(half_after: int) -> Config:
    """Return the simulated bench with another seed than the limits were tried with."""
    keys = f"[simulation]\nhalf_stiffness_after_cycles = {half_after}\n"
    text = simulated_config_text().replace("[simulation]\n", keys).replace("rate_hz = 125", "rate_hz = 25")
    return parse_config(text.replace("seed = 1\n", "seed = 31\n"), "wear")


def record(path: Path, config: Config) -> Path:
    """Drive the simulated robot and record what the simulated tracker sees of the cable, without sockets."""
    program = PathProgram(cycle_s=1.0, path=make_path(config))
    scene = Scene(config, program)
    writer = RunWriter(path, ManualClock(START_NS), config_toml=to_toml(config), versions={}, run_id="wear")
    program.play()
    number, motion = 0, program.motion_at(START_NS)
    while motion.cycle_count < N_CYCLES:
        now, ticks = START_NS + number * STEP_NS, number * STEP_NS // 1000
        program.tick(now, N_CYCLES)
        motion, seen = program.motion_at(now), scene.expose(number, now)
        phase = motion.phase if motion.cycle_running else float("nan")
        writer.put(
            RobotState(
                now + 200_000, now, number, 0, ticks * 1e-6, q_rad=motion.q_rad, qd_rad_s=motion.qd_rad_s,
                tcp_pose=motion.tcp_pose, cycle_count=motion.cycle_count, cycle_running=motion.cycle_running,
                cycle_phase=phase, runtime_state=2, robot_mode=7, safety_status=1,
            )
        )  # fmt: skip
        writer.put(ClockSample(ClockSource.TRACKER, now, ticks + 100, now + 200_000, 1e6, 0))
        writer.put(
            TrackerFrame(
                now + 5_000_000, now, number, ticks, StampKind.MID_EXPOSURE,
                seen.points_m, seen.ids, seen.flags, seen.residual_m, seen.bodies,
            )
        )  # fmt: skip
        number += 1
    return writer.close(exit_status="success", reason="all cycles done")


def true_position_mm(half_after: int) -> np.ndarray:
    """Return how far the worn cable is from where it was in the middle of the reference; before that, negative."""
    config = make_config(half_after)
    path = make_path(config)
    tables = [make_cable(config, path, level).points(config.cable.arc_length_m) for level in LEVELS]
    phase = (np.arange(8 * N_BINS) + 0.5) / (8 * N_BINS)
    places = np.array([place_at_phase(one) for one in phase])
    worn = WearTable(tables, half_after)
    points_m = np.array(
        [worn.at_many(places, i + phase).reshape(N_BINS, 8, -1, 3).mean(axis=1) for i in range(N_CYCLES)]
    )
    away_m = points_m - np.median(points_m[:N_REFERENCES], axis=0)
    side = np.sign((away_m * away_m[-1]).sum(axis=(1, 2, 3)))
    return 1e3 * side * np.sqrt(np.square(away_m).sum(axis=3).mean(axis=(1, 2)))


def analyse(folder: Path, half_after: int) -> Results:
    return analyse_run(open_run(record(folder / "run.mcap", make_config(half_after))))


@pytest.mark.parametrize("half_after", [HALF_AFTER, QUICK_HALF_AFTER])
def test_a_cable_that_gets_softer_is_seen_to_change_by_what_it_does(tmp_path: Path, half_after: int) -> None:
    results = analyse(tmp_path, half_after)
    assert results.drift is not None
    true_mm = true_position_mm(half_after)
    found_mm = results.drift.columns.shape_distance_mm
    assert np.abs(found_mm - np.abs(true_mm))[N_REFERENCES:].max() < 0.03 * true_mm[-1]
    assert np.all(results.frames.source >= 0)
    assert not results.drift.changes
    shape, curvature = results.drift.trends
    assert shape.matters
    true_slope = 1e3 * np.polyfit(np.arange(N_CYCLES), true_mm, 1)[0]
    assert shape.per_1000_cycles == pytest.approx(true_slope, abs=3 * shape.sigma_per_1000_cycles)
    assert 0 < shape.sigma_per_1000_cycles < 0.01 * shape.per_1000_cycles
    # Beside the clamp the true curvature rises while that of the curve through the markers falls by less than its band.
    assert not curvature.matters
    (sentence,) = list_drift(results)
    assert "shape drifts away from" in sentence


def test_a_cable_that_does_not_wear_is_seen_not_to_change(tmp_path: Path) -> None:
    results = analyse(tmp_path, 0)
    assert results.drift is not None
    assert not results.drift.changes
    assert not any(trend.matters or trend.stands_out for trend in results.drift.trends)
    assert results.drift.columns.shape_distance_mm.max() < 0.1
