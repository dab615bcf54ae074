"""How stiff the cable is, from all its shapes at once: one law of bending, and where the markers really sit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.arrays import Floats, Ints
from bench.analysis.rod_frames import ShapeCells
from bench.analysis.rod_shapes import RodModel, RodShapes, settle
from bench.errors import AnalysisError

__all__ = ["FittedLaw", "fit_law"]

MOST_SHAPES = 48
"""Spread over all shapes: each adds a fifth of a millisecond to each of some 20 passes."""
FIRST_SHAPES = 8
PLACEMENT_SIGMA_M = 1.2e-3
"""Of a marker along the cable, from where it is said to sit: taped to 2 mm either way, all alike likely."""
FIRST_STIFFNESS = 10.0 ** np.arange(-5.0, 0.0, 0.5)
"""Over weight per metre and the cube of the length: from limp to a rod that hardly sags."""
STIFFEST = 10.0
LIMPEST = 1e-6
"""Below it the bend beside a clamp is shorter than the mesh's segments."""
FEWEST_SETTLED = 0.5
"""Share of the shapes in which a stiffness must have a balance to be tried further."""
LARGEST_STEP = 1.0
"""Of a logarithm."""
MOST_STEPS = 25
MOST_DAMPING = 1e4
SETTLED = 1e-4
"""Of the largest logarithm's step, a hundredth of the standard deviation usual for it."""
SUSPICIOUS = 2.0
"""Residual over noise from which a law that slips is tried."""
WORTH_IT = 0.7
"""What must be left of the residual for the law with three numbers to be believed."""
KNEE_SHARE = 1.0 / 3.0
"""Of the largest curvature: where the search for the knee begins."""


@dataclass(frozen=True, eq=False)
class FittedLaw:
    """The law of bending and how well it fits."""

    model: RodModel
    """With the law, and the markers where they were found to sit."""
    spread: Floats
    """(3, 3): lower factor of the law's covariance."""
    residual_m: float
    """Root mean square of the markers' distance from the rod, per coordinate."""
    slips: bool
    """Whether the law has a friction moment."""
    relative_sigma: float
    """Of the stiffness before slip."""
    tension_m: float
    """Usual force on the end over weight per metre."""

    @property
    def clamp_reach_m(self) -> float:
        """How far from a clamp its bend reaches before slip: sqrt(EI / tension)."""
        return float(np.sqrt(self.model.law[0] / self.tension_m))


def fit_law(cells: ShapeCells, model: RodModel) -> FittedLaw:
    """Fit the law of bending to shapes spread over the recording.

    Raises
    ------
    AnalysisError
        No rod fits them.
    """
    rows = _spread(len(cells.markers_m), MOST_SHAPES)
    model = _start(cells, rows[:: -(-len(rows) // FIRST_SHAPES)], model)
    plain = _fit(cells, rows, model, slips=False)
    if plain.residual_m <= SUSPICIOUS * model.noise_m:
        return plain
    slipping = _try_slip(cells, rows, plain)
    return slipping if slipping and slipping.residual_m < WORTH_IT * plain.residual_m else plain


def _spread(n: int, most: int) -> Ints:
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))


def _start(cells: ShapeCells, rows: Ints, model: RodModel) -> RodModel:
    """Return the model with the best stiffness of a coarse row of them."""
    length_m, best, chosen = model.mesh.at_m[-1], np.inf, None
    for share in FIRST_STIFFNESS:
        tried = replace(model, law=np.array([share * length_m**3, 0.0, 1.0]))
        shapes = settle(cells, rows, tried)
        if shapes.settled.mean() >= FEWEST_SETTLED and _residual(cells, rows, shapes) < best:
            best, chosen = _residual(cells, rows, shapes), tried
    if chosen is None:
        raise AnalysisError(
            "The heavy rod ('elastica') was found in balance for none of the shapes tried.",
            hint="Check [cable] length_m and the two clamps' places and directions, which axis of the lab frame points "
            'up, or choose [analysis] curvature = "menger_gp".',
        )
    return chosen


def _residual(cells: ShapeCells, rows: Ints, shapes: RodShapes) -> float:
    return float(np.sqrt(np.nanmean((cells.markers_m[rows] - shapes.near_m)[shapes.settled] ** 2)))


def _try_slip(cells: ShapeCells, rows: Ints, plain: FittedLaw) -> FittedLaw | None:
    stiffness = plain.model.law[0]
    shapes = settle(cells, rows, plain.model)
    turn = np.linalg.norm(np.diff(shapes.way[shapes.settled], axis=1), axis=2) / plain.model.mesh.apart_m
    knee = KNEE_SHARE * float(np.median(turn.max(axis=1)))
    law = np.array([0.5 * stiffness, stiffness * knee, knee])
    try:
        return _fit(cells, rows, replace(plain.model, law=law), slips=True)
    except AnalysisError:
        return None


def _fit(cells: ShapeCells, rows: Ints, model: RodModel, *, slips: bool) -> FittedLaw:
    """Fit the law's logarithms and the markers' places by Gauss and Newton, the clamps of each shape left open.

    A step that makes the fit worse is halved (Levenberg: the damping grows tenfold, and shrinks again).
    """
    n_law, said = 3 if slips else 1, model.marker_m
    shapes, damping = settle(cells, rows, model), 1e-6
    costs = _costs(cells, rows, model, shapes)
    for _ in range(MOST_STEPS):
        matrix, right, _ = _normal(cells, rows, model, shapes, said, n_law)
        step = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), right)
        step *= min(1.0, LARGEST_STEP / max(np.abs(step[:n_law]).max(), 1e-12))
        law = model.law.copy()
        law[:n_law] *= np.exp(step[:n_law])
        law[0] = np.clip(law[0], *(bound * model.mesh.at_m[-1] ** 3 for bound in (LIMPEST, STIFFEST)))
        tried = replace(model, law=law, marker_m=model.marker_m + step[n_law:])
        moved = settle(cells, rows, tried, shapes)
        new = _costs(cells, rows, tried, moved)
        if _is_better(new, tried.marker_m - said, costs, model.marker_m - said):
            model, shapes, costs, damping = tried, moved, new, damping / 10
            if np.abs(step[:n_law]).max() < SETTLED:
                break
        elif damping > MOST_DAMPING:
            break
        else:
            damping = max(damping, 1e-4) * 10
    return _describe(cells, rows, model, shapes, said, n_law)


def _clamps_off(cells: ShapeCells, rows: Ints, shapes: RodShapes) -> Floats:
    """Return by how much the fitted clamps (R, 10) differ from what their holders say, in standard deviations."""
    sigma = np.repeat(cells.sigma[rows], (3, 3, 2, 2), axis=1)
    clamps = cells.clamps[rows]
    start = np.einsum("rac,ra->rc", shapes.turned[:, 0, :, 6:8], clamps[:, 3:6])
    end = np.einsum("rac,ra->rc", shapes.turned[:, -1, :, 8:10], clamps[:, 6:9])
    off = np.column_stack([-shapes.place_m[:, :3], clamps[:, :3] - shapes.place_m[:, 3:], start, end])
    return np.asarray(np.where(shapes.settled[:, None], off / sigma, 0.0))


def _costs(cells: ShapeCells, rows: Ints, model: RodModel, shapes: RodShapes) -> Floats:
    """Return the cost of each shape (R,); NaN where it has no balance."""
    off = np.nan_to_num(cells.markers_m[rows] - shapes.near_m) / model.noise_m
    costs = (off**2).sum(axis=(1, 2)) + (_clamps_off(cells, rows, shapes) ** 2).sum(axis=1)
    return np.where(shapes.settled, costs, np.nan)


def _is_better(costs: Floats, shifted_m: Floats, than: Floats, than_shifted_m: Floats) -> bool:
    """Compare the shapes in balance both here and there; a step that loses the balance of most is none."""
    both = np.isfinite(costs) & np.isfinite(than)
    here, there = ((shift**2).sum() / PLACEMENT_SIGMA_M**2 for shift in (shifted_m, than_shifted_m))
    change = (costs[both] - than[both]).sum() + here - there
    settled = np.isfinite(costs).mean() >= min(FEWEST_SETTLED, np.isfinite(than).mean())
    return bool(settled and both.any() and change <= 1e-9 * than[both].sum())


def _normal(
    cells: ShapeCells, rows: Ints, model: RodModel, shapes: RodShapes, said_m: Floats, n_law: int
) -> tuple[Floats, Floats, Floats]:
    """Return the normal equations of the law's logarithms and the markers' places, each shape's clamps eliminated.

    The third is how their right side changes with errors of the clamps (10, over their sigma) that all shapes share.
    """
    off = cells.markers_m[rows] - shapes.near_m
    seen, k, n = np.isfinite(off) & shapes.settled[:, None, None], off.shape[1], len(off)
    slope = np.where(seen[..., None], shapes.slope, 0.0) / model.noise_m
    placed = np.zeros((*off.shape, k))
    nearby = model.mesh.direction(model.marker_m) @ shapes.way
    placed[:, np.arange(k), :, np.arange(k)] = np.swapaxes(nearby, 0, 1)
    common = [slope[..., 10 : 10 + n_law] * model.law[:n_law], placed * seen[..., None] / model.noise_m]
    every = np.concatenate(common, axis=3).reshape(n, 3 * k, -1)
    own = slope[..., :10].reshape(n, 3 * k, 10) * np.repeat(cells.sigma[rows], (3, 3, 2, 2), axis=1)[:, None, :]
    told = (np.where(seen, off, 0.0) / model.noise_m).reshape(n, 3 * k, 1)
    inner = np.swapaxes(own, 1, 2) @ own + np.eye(10)
    mixed = np.swapaxes(every, 1, 2) @ own
    own_right = np.swapaxes(own, 1, 2) @ told + _clamps_off(cells, rows, shapes)[..., None]
    shares = mixed @ np.linalg.inv(inner)
    matrix = (np.swapaxes(every, 1, 2) @ every - shares @ np.swapaxes(mixed, 1, 2)).sum(axis=0)
    right = (np.swapaxes(every, 1, 2) @ told - shares @ own_right).sum(axis=0)[:, 0]
    places = np.arange(n_law, n_law + k)
    matrix[places, places] += PLACEMENT_SIGMA_M**-2
    right[n_law:] -= (model.marker_m - said_m) / PLACEMENT_SIGMA_M**2
    return matrix, right, shares.sum(axis=0)


def _describe(
    cells: ShapeCells, rows: Ints, model: RodModel, shapes: RodShapes, said_m: Floats, n_law: int
) -> FittedLaw:
    residual = _residual(cells, rows, shapes)
    matrix, _, shared = _normal(cells, rows, model, shapes, said_m, n_law)
    inverse = np.linalg.inv(matrix)
    # What the law leaves unexplained counts as noise; a clamp that is held wrong is so in all shapes.
    worse = max(1.0, residual / model.noise_m)
    bias = inverse @ shared
    covariance = (inverse * worse**2 + bias @ bias.T)[:n_law, :n_law]
    spread = np.zeros((3, 3))
    spread[:n_law, :n_law] = np.linalg.cholesky(covariance) * model.law[:n_law, None]
    tension = float(np.median(np.linalg.norm(shapes.force_m[shapes.settled], axis=1)))
    return FittedLaw(model, spread, residual, n_law == 3, float(np.sqrt(covariance[0, 0])), tension)
