"""Measures the peak curvature of clamped rods by every estimator, and how often the band holds the truth."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from bench.analysis import CableEnd, ClampedEnds, CurveEstimator, estimate_best, fit_elastica, fit_menger_gp, fit_spline
from bench.simulation.elastica import Clamps, Elastica
from benchmarks.table import Row, ratio_row

__all__ = ["measure_rods"]

Floats = npt.NDArray[np.float64]

LENGTH_M, WEIGHT_N_PER_M = 1.5, 1.5
N_MARKERS, N_SHAPES, N_RECORDINGS = 10, 24, 10
NOISE_M, TURN_RAD = 2e-4, float(np.deg2rad(0.3))
STIFFNESS_NM2 = (0.02, 0.005, 0.002)
N_CYCLES = 4000
PAPER, RECOMMENDED = "paper's spline", "recommended"
ESTIMATORS = {PAPER: fit_spline, "menger_gp": fit_menger_gp, "elastica": fit_elastica, RECOMMENDED: estimate_best}


@dataclass(frozen=True)
class Rods:
    """Shapes of one rod on a motion that no number of the estimators was chosen on."""

    markers_m: Floats
    """(F, k, 3)"""
    tangents: Floats
    """(F, 2, 3): into the cable."""
    curvature_per_m: Floats
    """(F, G)"""

    def see(self, rng: np.random.Generator, n_cycles: int = 1) -> npt.NDArray[np.float32]:
        """Return the tracked markers of so many cycles."""
        markers = np.tile(self.markers_m, (n_cycles, 1, 1))
        return (markers + rng.normal(0, NOISE_M, markers.shape)).astype(np.float32)

    def hold(self, rng: np.random.Generator, n_cycles: int = 1) -> ClampedEnds:
        """Return both clamps, as wrong as they say, and so in all frames of a recording alike."""
        ends = []
        for side, marker in enumerate((0, -1)):
            way = self.tangents[:, side] + np.cross(rng.normal(0, TURN_RAD, 3), self.tangents[:, side])
            place = self.markers_m[:, marker] + rng.normal(0, NOISE_M, 3)
            values = place, np.full(len(place), NOISE_M), way, np.full(len(place), TURN_RAD)
            ends.append(CableEnd(*(np.concatenate([v] * n_cycles) for v in values)))
        return ClampedEnds(ends[0], ends[1], LENGTH_M)


def measure_rods() -> list[Row]:
    """Return the bias of the peak of each estimator, the share inside the band, and the speed of the rod."""
    rows = []
    for stiffness in STIFFNESS_NM2:
        rods = make_rods(stiffness)
        biases, inside = {}, {}
        for name, fit in ESTIMATORS.items():
            biases[name], inside[name] = judge(rods, fit)
        radius = 1e3 / rods.curvature_per_m.max()
        what = f"clamped cable, EI {stiffness:g} N m² (to {radius:.0f} mm): peak wrong by %"
        ours = [name for name in ESTIMATORS if name != PAPER]
        rows += [ratio_row(f"{what}, {name}", abs(biases[name]), abs(biases[PAPER]), PAPER) for name in ours]
        rows.append(Row("  its band holds the truth, of all places", f"{inside[RECOMMENDED]:.1%}", "90-99 %", "-"))
    return [*rows, measure_speed(make_rods(0.005))]


def judge(rods: Rods, fit: CurveEstimator) -> tuple[float, float]:
    """Return the mean error of the peak in per cent, and the share of values inside two standard deviations."""
    errors, inside = [], []
    peak = rods.curvature_per_m.max(axis=1)
    for seed in range(N_RECORDINGS):
        rng = np.random.default_rng(7000 + seed)
        found = fit(rods.see(rng), marker_places(), places(), NOISE_M, ends=rods.hold(rng))
        known = np.isfinite(found.sigma_per_m)
        errors.append(100 * (np.nanmax(found.curvature_per_m, axis=1) / peak - 1))
        inside.append((np.abs(found.curvature_per_m - rods.curvature_per_m) <= 2 * found.sigma_per_m)[known])
    return float(np.mean(errors)), float(np.concatenate(inside).mean())


def measure_speed(rods: Rods) -> Row:
    """Read 100 places of many cycles by the recommended estimator, compiled before."""
    rng = np.random.default_rng(1)
    markers, ends = rods.see(rng, N_CYCLES), rods.hold(rng, N_CYCLES)
    begin = time.perf_counter()
    estimate_best(markers, marker_places(), places(), NOISE_M, ends=ends)
    rate = len(markers) / (time.perf_counter() - begin)
    return ratio_row(
        "recommended curvature with clamps, with its sd, frames/s", rate, 400_000 / 30, "limit of a report"
    )


def make_rods(stiffness_nm2: float) -> Rods:
    """Solve a rod whose end goes round while both clamps turn, by the simulated bench's solver."""
    rod = Elastica(LENGTH_M, WEIGHT_N_PER_M, stiffness_nm2, 300)
    turn = np.linspace(0, 2 * np.pi, N_SHAPES, endpoint=False)
    ways = [
        Clamps(0.85 + 0.1 * np.cos(p), 0.1 + 0.15 * np.sin(2 * p), -0.1 + 0.4 * np.sin(p), 0.1 + 0.4 * np.cos(p))
        for p in turn
    ]
    shapes = [rod.hang(ways[0])]
    for way in ways[1:]:
        shapes.append(rod.follow(shapes[-1], way))
    nodes = np.linspace(0, LENGTH_M, rod.n_segments + 1)
    held = np.exp(1j * np.array([[s.clamps.start_rad, s.clamps.end_rad] for s in shapes]))
    points = [np.concatenate([[0], np.cumsum(np.exp(1j * s.angle_rad))]) * rod.segment_m for s in shapes]
    curves = [CubicSpline(nodes, p, bc_type=((1, t[0]), (1, t[1]))) for p, t in zip(points, held, strict=True)]
    curvature = [np.abs(CubicSpline(nodes, rod.curvature(s))(places())) for s in shapes]
    markers = np.array([curve(marker_places()) for curve in curves])
    return Rods(_in_space(markers), _in_space(held * [1, -1]), np.array(curvature))


def marker_places() -> Floats:
    return np.linspace(0, LENGTH_M, N_MARKERS)


def places() -> Floats:
    return np.linspace(0, LENGTH_M, 100)


def _in_space(plane: npt.NDArray[np.complex128]) -> Floats:
    return np.stack([plane.real, plane.imag, 0 * plane.real], axis=-1)
