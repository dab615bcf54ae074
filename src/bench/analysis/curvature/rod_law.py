"""How stiff the cable is, from all its shapes at once: one law of bending, and where the markers really sit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.arrays import Floats, Ints
from bench.analysis.curvature.rod_frames import ShapeCells
from bench.analysis.curvature.rod_pooling import FEWEST_SETTLED, LawShapes
from bench.analysis.curvature.rod_shapes import RodModel, RodShapes
from bench.errors import AnalysisError

__all__ = ["FittedLaw", "fit_law"]

MOST_SHAPES = 48
"""Spread over all shapes: each adds a fifth of a millisecond to each of some 20 passes."""
FIRST_SHAPES = 8
FIRST_STIFFNESS = 10.0 ** np.arange(-5.0, 0.0, 0.5)
"""Over weight per metre and the cube of the length: from limp to a rod that hardly sags."""
STIFFEST = 10.0
LIMPEST = 1e-6
"""Below it the bend beside a clamp is shorter than the mesh's segments."""
LARGEST_STEP = 1.0
"""Of a logarithm."""
MOST_STEPS = 25
LEAST_DAMPING, FIRST_DAMPING, MOST_DAMPING = 1e-6, 1e-4, 1e4
SETTLED = 1e-4
"""Of the largest logarithm's step, a hundredth of the standard deviation usual for it."""
STRAY = 3.0
"""A shape whose residual is so many times the usual one has no say."""
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
    said_m: Floats
    """(k,): arc lengths of the markers as they were given."""
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
    shapes = LawShapes(cells, rows, model.marker_m)
    start = _start(LawShapes(cells, rows[:: -(-len(rows) // FIRST_SHAPES)], model.marker_m), model)
    plain = _fit(shapes, start, 1)
    shapes = _leave_out_strays(shapes, plain.model)
    plain = _fit(shapes, plain.model, 1)
    if plain.residual_m <= SUSPICIOUS * model.noise_m:
        return plain
    slipping = _try_slip(shapes, plain)
    return slipping if slipping and slipping.residual_m < WORTH_IT * plain.residual_m else plain


def _spread(n: int, most: int) -> Ints:
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))


def _start(shapes: LawShapes, model: RodModel) -> RodModel:
    """Return the model with the best stiffness of a coarse row of them."""
    length_m, best, chosen = model.mesh.at_m[-1], np.inf, None
    for share in FIRST_STIFFNESS:
        tried = replace(model, law=np.array([share * length_m**3, 0.0, 1.0]))
        settled = shapes.settle(tried)
        if settled.settled.mean() >= FEWEST_SETTLED and shapes.residual(settled) < best:
            best, chosen = shapes.residual(settled), tried
    if chosen is None:
        raise AnalysisError(
            "The heavy rod ('elastica') was found in balance for none of the shapes tried.",
            hint="Check [cable] length_m and the two clamps' places and directions, which axis of the lab frame points "
            "up, or choose another [analysis] curvature.",
        )
    return chosen


def _leave_out_strays(shapes: LawShapes, model: RodModel) -> LawShapes:
    """Leave out what fits far worse than most: a shape with a wrongly sorted marker, or without balance."""
    miss = shapes.residuals(shapes.settle(model))
    return replace(shapes, rows=shapes.rows[miss <= STRAY * np.nanmedian(miss)])


def _try_slip(shapes: LawShapes, plain: FittedLaw) -> FittedLaw | None:
    stiffness = plain.model.law[0]
    settled = shapes.settle(plain.model)
    turn = np.linalg.norm(np.diff(settled.way[settled.settled], axis=1), axis=2) / plain.model.mesh.apart_m
    knee = KNEE_SHARE * float(np.median(turn.max(axis=1)))
    start = replace(plain.model, law=np.array([0.5 * stiffness, stiffness * knee, knee]))
    return _fit(shapes, start, 3) if shapes.settle(start).settled.any() else None


def _fit(shapes: LawShapes, model: RodModel, n_law: int) -> FittedLaw:
    """Fit the law's logarithms and the markers' places by Gauss and Newton.

    A step that makes the fit worse is tried again, ten times more damped (Levenberg and Marquardt).
    """
    now, damping = shapes.settle(model), LEAST_DAMPING
    for _ in range(MOST_STEPS):
        equations = shapes.linearise(model, now, n_law)
        step = equations.solve(damping)
        step *= min(1.0, LARGEST_STEP / max(np.abs(step[:n_law]).max(), 1e-12))
        law = model.law.copy()
        law[:n_law] *= np.exp(step[:n_law])
        law[0] = np.clip(law[0], *(bound * model.mesh.at_m[-1] ** 3 for bound in (LIMPEST, STIFFEST)))
        tried = replace(model, law=law, marker_m=model.marker_m + step[n_law:])
        then = shapes.settle(tried, now)
        if shapes.is_better(tried, then, model, now):
            model, now, damping = tried, then, max(damping / 10, LEAST_DAMPING)
            if np.abs(step[:n_law]).max() < SETTLED:
                break
        elif damping > MOST_DAMPING:
            break
        else:
            damping = max(damping, FIRST_DAMPING) * 10
    return _describe(shapes, model, now, n_law)


def _describe(shapes: LawShapes, model: RodModel, now: RodShapes, n_law: int) -> FittedLaw:
    residual = shapes.residual(now)
    covariance = shapes.linearise(model, now, n_law).covariance(residual / model.noise_m)[:n_law, :n_law]
    spread = np.zeros((3, 3))
    spread[:n_law, :n_law] = np.linalg.cholesky(covariance) * model.law[:n_law, None]
    tension = float(np.median(np.linalg.norm(now.force_m[now.settled], axis=1)))
    sigma = float(np.sqrt(covariance[0, 0]))
    return FittedLaw(model, shapes.said_m, spread, residual, n_law == 3, sigma, tension)
