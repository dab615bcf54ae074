"""How fast curvature with its standard deviation comes, and how far off it is on a circle."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from bench.analysis import CableEnd, ClampedEnds, CurveEstimator, fit_menger_gp, fit_spline
from benchmarks.table import Row, ratio_row

N_FRAMES, PEER_FRAMES = 100_000, 2_000
NOISE_M, TANGENT_RAD = 2e-4, float(np.deg2rad(0.3))
RADIUS_M = 0.4
WANTED_PER_S = 460_000
REPEATS = 5

Floats = npt.NDArray[np.float64]
Floats32 = npt.NDArray[np.float32]


def measure_curvature() -> list[Row]:
    """Draw curves through 10 markers, 100 samples, with and without misses; and read the radius of a noisy circle."""
    rng = np.random.default_rng(1)
    arc = np.linspace(0.06, 1.14, 10)
    curve = np.stack([np.cos(arc * 3), np.sin(arc * 3), arc], axis=1)
    markers = (curve + rng.normal(0, NOISE_M, (N_FRAMES, 10, 3))).astype(np.float32)
    gapped = markers.copy()
    gapped[rng.random((N_FRAMES, 10)) < 0.05] = np.nan
    sample = np.linspace(arc[0], arc[-1], 100)
    peer = _rate(lambda: _loop_over_frames(markers[:PEER_FRAMES], arc, sample), PEER_FRAMES)
    rows = []
    for what, seen in (("", markers), (", 5 % missing", gapped)):
        ours = _rate(lambda m=seen: fit_menger_gp(m, arc, sample, NOISE_M), N_FRAMES)
        paper = _rate(lambda m=seen: fit_spline(m, arc, sample, NOISE_M), N_FRAMES)
        rows += [
            ratio_row(f"curvature with its band{what}: frames/s", ours, peer, "CubicSpline for each frame"),
            ratio_row(f"curvature with its band{what}: frames/s", ours, WANTED_PER_S, "limit"),
            ratio_row(f"the paper's spline with its sd{what}: frames/s", paper, peer, "CubicSpline for each frame"),
        ]
    return [*rows, _measure_circle(rng)]


def _measure_circle(rng: np.random.Generator) -> Row:
    """Read the radius of the paper's circle, 8 markers on 315 degrees, in 200 frames with noise."""
    angle, n = np.arange(8) * np.pi / 4, 200
    circle = RADIUS_M * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    markers = (circle + rng.normal(0, NOISE_M, (n, 8, 3))).astype(np.float32)
    tangents = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)[[0, -1]] * [[1.0], [-1.0]]
    ends = _hold(tangents + rng.normal(0, TANGENT_RAD, (n, 2, 3)), float(RADIUS_M * angle[-1]))
    errors = [_median_error(estimator, markers, RADIUS_M * angle, ends) for estimator in (fit_menger_gp, fit_spline)]
    what = "circle of 0.4 m, 8 markers, 0.2 mm noise: largest error of the radius, %"
    return ratio_row(what, errors[0], errors[1], "paper's spline")


def _median_error(estimator: CurveEstimator, markers: Floats32, s: Floats, ends: ClampedEnds) -> float:
    found = estimator(markers, s, np.linspace(0, s[-1], 200), NOISE_M, ends=ends)
    error = np.abs(1 / (RADIUS_M * found.curvature_per_m.astype(np.float64)) - 1)
    return 100 * float(np.median(error.max(axis=1)))


def _hold(tangents: Floats, length_m: float) -> ClampedEnds:
    unit = tangents / np.linalg.norm(tangents, axis=2, keepdims=True)
    nowhere, sigma = np.full((len(unit), 3), np.nan), np.full(len(unit), TANGENT_RAD)
    ends = [CableEnd(nowhere, nowhere[:, 0], unit[:, side], sigma) for side in (0, 1)]
    return ClampedEnds(ends[0], ends[1], length_m)


def _loop_over_frames(markers: Floats32, arc: Floats, sample: Floats) -> None:
    for frame in markers:
        spline = CubicSpline(arc, frame)
        first, second = spline(sample, 1), spline(sample, 2)
        np.linalg.norm(np.cross(first, second), axis=1) / np.linalg.norm(first, axis=1) ** 3


def _rate(work: Callable[[], object], n_frames: int) -> float:
    """Return frames for each second of one core: the best of some repeats, after one to compile."""
    work()
    best_s = np.inf
    for _ in range(REPEATS):
        begin = time.process_time()
        work()
        best_s = min(best_s, time.process_time() - begin)
    return n_frames / float(best_s)
