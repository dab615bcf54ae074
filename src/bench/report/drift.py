"""Whether the cable changed over the test: each cycle's shape and largest curvature against the first cycles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.analysis import (
    FEWEST_VALUES,
    CycleShapes,
    LevelChange,
    SeriesDrift,
    ShapeDistances,
    average_by_phase,
    describe_drift,
    gather_shapes,
    measure_along_change,
    measure_distances,
)
from bench.model import Verdict
from bench.report.cycles import PlacedFrames
from bench.report.results import CycleColumns, Drift, DriftChange, DriftColumns, DriftTrend
from bench.report.trace import TracedCable, find_nodes

__all__ = ["find_drift", "measure_step"]

Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

REFERENCE_SHARE = 0.1
FEWEST_REFERENCES, MOST_REFERENCES = 10, 50
"""Ten cycles give a median that is three times as sure as one; more than fifty hold wear that is to be seen."""
CYCLES_BESIDE = 20
"""On either side of a change, to see where it is: few enough that a slow trend adds little."""
CURVATURE_SHARE = 0.01
"""A change of the curvature by a hundredth is one of the life by about a tenth; less matters to nobody."""
MOST_CYCLES = 0.5
"""Where the largest curvature of more cycles than this part lies, there it is."""
BAND_SIGMAS = 2.0
"""Of the largest curvature: where the report has its interval."""
SHAPE, CURVATURE = "shape", "max_curvature"


@dataclass(frozen=True, eq=False)
class _Watched:
    """What is looked at: a quantity by cycle, in the unit of the report, and what it is in."""

    quantity: str
    drift: SeriesDrift
    fitted: Floats
    """(C,): what was found in it, in the unit of the report; of a distance along a line, negative on its other side."""
    least: float
    """A change must be larger to matter."""


def find_drift(placed: PlacedFrames, traced: TracedCable, cycles: CycleColumns, marker_noise_mm: float) -> Drift | None:
    """Hold every cycle of verdict ok against the first of them; None with fewer than 20.

    Parameters
    ----------
    placed : PlacedFrames
    traced : TracedCable
    cycles : CycleColumns
    marker_noise_mm : float
        A smaller change of the shape does not matter.
    """
    n_cycles = len(cycles.cycle_index)
    ok = np.array([verdict == Verdict.OK for verdict in cycles.verdict], dtype=bool)
    ok &= np.bincount(placed.row[traced.trusted & (placed.row >= 0)], minlength=n_cycles) > 0
    if ok.sum() < FEWEST_VALUES:
        return None
    reference = _choose_references(ok)
    usable = traced.trusted & (placed.row >= 0)
    usable[usable] = ok[placed.row[usable]]
    shapes = gather_shapes(placed.row, n_cycles, placed.phase, traced.markers.position_m, usable, reference)
    distances = measure_distances(shapes, reference)
    change, sigma, level = _compare_curvature(cycles, reference)
    watched = [
        _watch_shape(shapes, reference, distances, marker_noise_mm),
        _watch(
            CURVATURE, np.where(ok, change, np.nan), max(CURVATURE_SHARE * level, _doubt_beside_ends(cycles, traced))
        ),
    ]
    found = [one for one in watched if one is not None]
    fitted = {one.quantity: one.fitted for one in found}
    unknown = np.full(n_cycles, np.nan)
    columns = DriftColumns(
        cycle_index=cycles.cycle_index,
        watched=ok,
        shape_distance_mm=1e3 * distances.distance_m,
        shape_distance_fitted_mm=np.abs(fitted.get(SHAPE, unknown)),
        max_curvature_change_per_m=change,
        max_curvature_change_sigma_per_m=sigma,
        max_curvature_change_fitted_per_m=fitted.get(CURVATURE, unknown),
    )
    changes = [_describe_change(one, step, placed, traced, shapes, ok) for one in found for step in one.drift.changes]
    return Drift(
        columns=columns,
        reference_cycle_index=cycles.cycle_index[reference],
        usual_shape_distance_mm=1e3 * distances.usual_m,
        changes=sorted(changes, key=lambda change: change.cycle_index),
        trends=[_describe_trend(one, n_cycles) for one in found],
    )


def _choose_references(ok: Bools) -> Bools:
    n = int(np.clip(REFERENCE_SHARE * ok.sum(), FEWEST_REFERENCES, MOST_REFERENCES))
    reference = np.zeros(len(ok), dtype=bool)
    reference[np.flatnonzero(ok)[:n]] = True
    return reference


def _compare_curvature(cycles: CycleColumns, reference: Bools) -> tuple[Floats, Floats, float]:
    """Return each cycle's change of the largest curvature, its standard deviation, and the reference level."""
    value = cycles.max_curvature_per_m
    known = value[reference & np.isfinite(value)]
    if not len(known):
        nothing = np.full(len(value), np.nan)
        return nothing, nothing, float("nan")
    level = float(np.median(known))
    # what the method errs by alike in every cycle cancels: what is left is what cycles differ by
    scatter = float(np.median(np.abs(known - level))) / 0.6745
    sigma = scatter * float(np.sqrt(1.0 + np.pi / 2 / len(known)))
    return value - level, np.where(np.isfinite(value), sigma, np.nan), level


def _doubt_beside_ends(cycles: CycleColumns, traced: TracedCable) -> float:
    """Return what a change of the largest curvature must exceed where that is beside an end of the curve, else 0.

    From the end to the next marker a curve follows the cable the less the shorter the bend is. A cable that gets softer
    bends tighter there while the curve falls: so what the method errs by does not cancel, and its whole band counts.
    """
    nodes = find_nodes(traced)
    place = cycles.max_curvature_arc_length_m
    beside = (place < nodes[1]) | (place > nodes[-2])
    if not beside.sum() > MOST_CYCLES * np.isfinite(place).sum():
        return 0.0
    return BAND_SIGMAS * float(np.median(cycles.max_curvature_sigma_per_m[beside]))


def _watch_shape(
    shapes: CycleShapes, reference: Bools, distances: ShapeDistances, marker_noise_mm: float
) -> _Watched | None:
    """Look at the distances, and where they change at all, along the line of that change if there is one.

    Whether there may be a change is asked of the distances with their usual level, which favour no direction; what it
    is, is told without that level.
    """
    found = _watch(SHAPE, 1e3 * distances.watched_m, marker_noise_mm)
    if found is None:
        return None
    if found.drift.changes or found.drift.is_trend:
        along_m = measure_along_change(shapes, reference, distances, 1e-3 * found.fitted)
        along = None if along_m is None else _watch(SHAPE, 1e3 * along_m, marker_noise_mm)
        if along is not None:
            return along
    above = np.sqrt(np.maximum(np.maximum(found.fitted, 0.0) ** 2 - (1e3 * distances.usual_m) ** 2, 0.0))
    return _Watched(SHAPE, found.drift, above, found.least)


def _watch(quantity: str, value: Floats, least: float) -> _Watched | None:
    if np.isfinite(value).sum() < FEWEST_VALUES:
        return None
    drift = describe_drift(value)
    return _Watched(quantity, drift, drift.fitted, least)


def _describe_change(
    watched: _Watched, step: LevelChange, placed: PlacedFrames, traced: TracedCable, shapes: CycleShapes, ok: Bools
) -> DriftChange:
    known = np.flatnonzero(np.isfinite(watched.fitted))
    at = int(np.searchsorted(known, step.at))
    size = measure_step(watched.quantity, float(watched.fitted[known[at - 1]]), float(watched.fitted[known[at]]))
    before, after = _rows_beside(watched, step.at, ok)
    if watched.quantity == SHAPE:
        arc_length_m, phase, largest = _find_largest_shift(shapes, before, after, traced.marker_arc_length_m)
    else:
        arc_length_m, phase, largest = _find_largest_bend(placed, traced, shapes.n_bins, before, after)
    return DriftChange(
        watched.quantity,
        int(placed.table.cycle_index[step.at]),
        size,
        step.sigma,
        arc_length_m,
        phase,
        largest,
        abs(size) > watched.least,
    )


def measure_step(quantity: str, before: float, after: float) -> float:
    """Return the size of a step; of the shape, positive if it leads away from the reference, also to its other side."""
    return after - before if quantity != SHAPE else float(np.copysign(after - before, abs(after) - abs(before)))


def _rows_beside(watched: _Watched, at: int, ok: Bools) -> tuple[Ints, Ints]:
    """Return the rows of the cycles nearest to a change, up to the next change on either side."""
    bounds = [0, *(change.at for change in watched.drift.changes), len(ok)]
    place = bounds.index(at, 1)
    rows = np.flatnonzero(ok)
    before = rows[(rows >= bounds[place - 1]) & (rows < at)][-CYCLES_BESIDE:]
    return before, rows[(rows >= at) & (rows < bounds[place + 1])][:CYCLES_BESIDE]


def _find_largest_shift(
    shapes: CycleShapes, before: Ints, after: Ints, marker_arc_length_m: Floats
) -> tuple[float, float, float]:
    """Return the place of the marker that has moved most, the phase, and how far (mm)."""
    shift = _mean_known(shapes.offset_m[after]) - _mean_known(shapes.offset_m[before])
    distance_mm = 1e3 * np.sqrt(np.square(shift).sum(axis=2))
    if not np.isfinite(distance_mm).any():
        return float("nan"), float("nan"), float("nan")
    phase_bin, marker = np.unravel_index(np.nanargmax(distance_mm), distance_mm.shape)
    phase = (float(phase_bin) + 0.5) / shapes.n_bins
    return float(marker_arc_length_m[marker]), phase, float(distance_mm[phase_bin, marker])


def _mean_known(values: npt.NDArray[np.float32]) -> Floats:
    known = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(known, values, 0.0).sum(axis=0, dtype=np.float64) / known.sum(axis=0))


def _find_largest_bend(
    placed: PlacedFrames, traced: TracedCable, n_bins: int, before: Ints, after: Ints
) -> tuple[float, float, float]:
    """Return where the curvature has changed most, the phase, and by how much (1/m)."""
    maps = []
    for rows in (before, after):
        frames = np.flatnonzero(traced.trusted & np.isin(placed.row, rows))
        curve = traced.curve.curvature_per_m[frames], traced.curve.sigma_per_m[frames]
        every = np.ones(len(frames), dtype=bool)
        mean = average_by_phase(*curve, placed.row[frames], placed.phase[frames], every, n_bins)
        maps.append(mean.curvature_per_m)
    change = maps[1] - maps[0]
    if not np.isfinite(change).any():
        return float("nan"), float("nan"), float("nan")
    phase_bin, sample = np.unravel_index(np.nanargmax(np.abs(change)), change.shape)
    phase = (float(phase_bin) + 0.5) / n_bins
    return float(traced.arc_length_m[sample]), phase, float(change[phase_bin, sample])


def _describe_trend(watched: _Watched, n_cycles: int) -> DriftTrend:
    drift = watched.drift
    matters = drift.is_trend and abs(drift.slope) * n_cycles > watched.least
    return DriftTrend(watched.quantity, 1e3 * drift.slope, 1e3 * drift.slope_sigma, drift.is_trend, matters)
