"""Results as an analysis would fill them, made from a formula: a cable that swings, bent most near its clamps."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from bench.config import parse_config
from bench.model import Outcome
from bench.report.results import ClockFinding, CycleColumns, ExampleFrame, FrameColumns, Results, StreamFinding

START_NS = 1_772_654_405_000_000_000
CYCLE_S = 2.0
CONFIG = """
[run]
name = "dresspack-07"
sample_id = "LAPP-8x1.0-03"
operator = "M. Curie"
[robot]
host = "192.168.0.10"
program = "bend_test.urp"
[tracker]
host = "192.168.0.20"
[cable]
length_m = 1.20
diameter_mm = 8.0
marker_arc_length_m = [0.06, 0.18, 0.30, 0.42, 0.54, 0.66, 0.78, 0.90, 1.02, 1.14]
minimum_bend_radius_mm = 60.0
[cable.anchor]
kind = "static_marker"
"""
GRID_M = np.linspace(0.06, 1.14, 100)


def curvature_at(phase: np.ndarray) -> np.ndarray:
    """Return the curvature (len(phase), G) of the swinging cable, 1/m: 14.8 at most."""
    swing = np.sin(2 * np.pi * np.asarray(phase))[:, None]
    along = (GRID_M - GRID_M[0]) / (GRID_M[-1] - GRID_M[0])
    belly = 2.0 + 1.2 * swing * np.cos(np.pi * along)
    clamps = (9 + 3 * swing) * np.exp(-along / 0.06) + (8 - 4 * swing) * np.exp(-(1 - along) / 0.08)
    return np.abs(belly + clamps - 0.2)


def make_frames(n_cycles: int, per_cycle: int, rng: np.random.Generator) -> FrameColumns:
    n = n_cycles * per_cycle
    phase = np.tile((np.arange(per_cycle) + 0.5) / per_cycle, n_cycles)
    curvature = curvature_at(phase) + rng.normal(0, 0.1, (n, GRID_M.size))
    return FrameColumns(
        frame_number=np.arange(n),
        time_ns=START_NS + (np.arange(n) * CYCLE_S / per_cycle * 1e9).astype(np.int64),
        cycle_index=np.repeat(np.arange(n_cycles), per_cycle),
        cycle_phase=phase,
        source=np.tile(np.arange(10, dtype=np.int16), (n, 1)),
        position_m=np.zeros((n, 10, 3), dtype=np.float32),
        confidence=np.ones(n, dtype=np.float32),
        marker_confidence=np.ones((n, 10), dtype=np.float32),
        reason=np.zeros((n, 10), dtype=np.uint8),
        curvature_per_m=curvature.astype(np.float32),
        sigma_per_m=np.full((n, GRID_M.size), 0.15, dtype=np.float32),
    )


def make_cycles(frames: FrameColumns, n_cycles: int, per_cycle: int) -> CycleColumns:
    start = START_NS + (np.arange(n_cycles) * CYCLE_S * 1e9).astype(np.int64)
    curvature = frames.curvature_per_m.reshape(n_cycles, per_cycle * GRID_M.size).astype(float)
    place = curvature.argmax(axis=1) if n_cycles else np.zeros(0, dtype=np.int64)
    largest = curvature.max(axis=1) if n_cycles else np.zeros(0)
    return CycleColumns(
        cycle_index=np.arange(n_cycles),
        start_ns=start,
        start_from=["motion"] * n_cycles,
        end_ns=start + int(CYCLE_S * 1e9),
        duration_s=np.full(n_cycles, CYCLE_S),
        n_frames=np.full(n_cycles, per_cycle),
        verdict=["ok"] * n_cycles,
        complete_fraction=np.clip(1 - np.abs(np.sin(np.arange(n_cycles) / 7)) * 0.06, 0, 1),
        max_curvature_per_m=largest,
        max_curvature_sigma_per_m=np.full(n_cycles, 0.15),
        max_curvature_arc_length_m=GRID_M[place % GRID_M.size],
        min_bend_radius_mm=1e3 / largest,
        mean_curvature_per_m=np.full(n_cycles, 2.5),
    )


def make_example() -> ExampleFrame:
    """A half wave in the x-z plane, shuffled, with the anchor first and two ghosts."""
    rng = np.random.default_rng(3)

    def place(arc: np.ndarray) -> np.ndarray:
        return np.stack([0.9 * arc, 0.04 * np.sin(2 * arc), 1.1 - 0.45 * np.sin(np.pi * arc / 1.2)], axis=1)

    markers = place(np.linspace(0.06, 1.14, 10)).astype(np.float32)
    ghosts = np.array([[0.3, 0.1, 1.02], [3.0, 0.5, 0.2]], dtype=np.float32)
    points = np.concatenate([place(np.zeros(1)).astype(np.float32), markers, ghosts])
    phase = np.array([0.31])
    return ExampleFrame(
        frame_number=62,
        cycle_index=0,
        cycle_phase=0.31,
        points_m=rng.permutation(points),
        position_m=markers,
        anchor_m=place(np.zeros(1))[0],
        curve_m=place(GRID_M),
        curvature_per_m=curvature_at(phase)[0].astype(np.float32),
        sigma_per_m=np.full(GRID_M.size, 0.15, dtype=np.float32),
    )


def make_results(n_cycles: int = 20, per_cycle: int = 50, **changes: Any) -> Results:
    """Results of a sound run of `n_cycles`; `changes` replace whole fields."""
    rng = np.random.default_rng(1)
    frames = make_frames(n_cycles, per_cycle, rng)
    grid = (np.arange(100) + 0.5) / 100
    results = Results(
        run_path="dresspack-07.mcap",
        config=parse_config(CONFIG, "test.toml"),
        config_sha256="9f2c" * 16,
        versions={"bench": "0.1.0", "python": "3.11.9", "numpy": "2.4.6"},
        methods={"sorting": "paper", "curvature": "spline", "cycles": "counter"},
        exit_status="success",
        exit_reason=f"{n_cycles} of {n_cycles} cycles done",
        outcome=Outcome.PASS,
        outcome_reasons=[],
        run_facts={
            "Robot": "UR10e, PolyScope 5.16.1, program bend_test.urp",
            "Tracker": "Motive 3.1.0, NatNet 4.1, 100 Hz",
            "Started": "2026-03-04 20:00:05 UTC",
            "Operator": "M. Curie",
            "Cable": "1200 mm long, 8 mm thick, 10 markers, bend radius at least 60 mm",
        },
        arc_length_m=GRID_M,
        marker_arc_length_m=np.linspace(0.06, 1.14, 10),
        frames=frames,
        cycles=make_cycles(frames, n_cycles, per_cycle),
        phase_grid=grid,
        bend_map_per_m=curvature_at(grid),
        example=make_example(),
        streams=[
            StreamFinding("/robot/state", 125.0, 5000, 5000, 0, 0),
            StreamFinding("/tracker/points", 100.0, 4000, 4000, 0, 0),
        ],
        clocks=[
            ClockFinding("robot", 0, "lower convex hull", 1_772_650_000.123456, 24.97, 71.0, 5000, stamped_by="kernel"),
            ClockFinding("tracker", 0, "echoes", 1_772_640_000.5, -42.05, 12.0, 400),
        ],
        analysis_s=0.8,
    )
    return dataclasses.replace(results, **changes)
