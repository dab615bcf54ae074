"""Shapes of a recording that share one law of bending: how well it fits them, and how a better one is found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Floats, Ints
from bench.analysis.curvature.rod_frames import ShapeCells
from bench.analysis.curvature.rod_shapes import RodModel, RodShapes, settle

__all__ = ["FEWEST_SETTLED", "LawShapes", "PooledEquations"]

PLACEMENT_SIGMA_M = 1.2e-3
"""Of a marker along the cable, from where it is said to sit: taped to 2 mm either way, all alike likely."""
LAW_SIGMA = 5.0
"""Of the law's logarithms about where they are: nothing, but for a number that changes nothing."""
FEWEST_SETTLED = 0.5
"""Share of the shapes in which a law must have a balance."""
OWN = 10
"""Numbers that each shape has for itself: its clamps."""


@dataclass(frozen=True, eq=False)
class PooledEquations:
    """Normal equations of the law's logarithms and the markers' places; each shape's clamps are eliminated."""

    matrix: Floats
    right: Floats
    by_clamps: Floats
    """(n, 10): how the right side changes with errors of the clamps, over their sigma, that all shapes share."""

    def solve(self, damping: float) -> Floats:
        """Return the step, shortened along what is told least."""
        return np.asarray(np.linalg.solve(self.matrix + damping * np.diag(np.diag(self.matrix)), self.right))

    def covariance(self, worse: float) -> Floats:
        """Return the covariance where the residual is `worse` times what noise explains.

        What the law leaves unexplained counts as noise; a clamp that is held wrong is so in all shapes alike.
        """
        inverse = np.linalg.inv(self.matrix)
        bias = inverse @ self.by_clamps
        return np.asarray(inverse * max(1.0, worse) ** 2 + bias @ bias.T)


@dataclass(frozen=True, eq=False)
class LawShapes:
    """The shapes `rows` of the cells, with the markers where they are said to sit."""

    cells: ShapeCells
    rows: Ints
    said_m: Floats

    def settle(self, model: RodModel, before: RodShapes | None = None) -> RodShapes:
        """Return the rods in balance that suit the shapes best."""
        return settle(self.cells, self.rows, model, before)

    def residuals(self, shapes: RodShapes) -> Floats:
        """Return the root mean square distance of each shape's markers, per coordinate; NaN without balance."""
        off = self._off(shapes)
        square = np.nansum(off**2, axis=(1, 2)) / np.isfinite(off).sum(axis=(1, 2))
        return np.where(shapes.settled, np.sqrt(square), np.nan)

    def residual(self, shapes: RodShapes) -> float:
        """Return that of all shapes together."""
        return float(np.sqrt(np.nanmean(self._off(shapes)[shapes.settled] ** 2)))

    def is_better(self, model: RodModel, shapes: RodShapes, than: RodModel, than_shapes: RodShapes) -> bool:
        """Compare what is in balance both here and there; a step that loses the balance of most is none."""
        here, there = self._costs(model, shapes), self._costs(than, than_shapes)
        both = np.isfinite(here) & np.isfinite(there)
        shifted = [((m.marker_m - self.said_m) ** 2).sum() / PLACEMENT_SIGMA_M**2 for m in (model, than)]
        change = (here[both] - there[both]).sum() + shifted[0] - shifted[1]
        settled = shapes.settled.mean() >= min(FEWEST_SETTLED, than_shapes.settled.mean())
        return bool(settled and both.any() and change <= 1e-9 * there[both].sum())

    def linearise(self, model: RodModel, shapes: RodShapes, n_law: int) -> PooledEquations:
        """Return the equations of the first `n_law` logarithms of the law, and of the markers' places."""
        off = self._off(shapes)
        seen, k, n = np.isfinite(off) & shapes.settled[:, None, None], off.shape[1], len(off)
        slope = np.where(seen[..., None], shapes.slope, 0.0) / model.noise_m
        placed = np.zeros((*off.shape, k))
        along = model.mesh.direction(model.marker_m) @ shapes.way
        placed[:, np.arange(k), :, np.arange(k)] = np.swapaxes(along, 0, 1)
        pooled = [slope[..., OWN : OWN + n_law] * model.law[:n_law], placed * seen[..., None] / model.noise_m]
        every = np.concatenate(pooled, axis=3).reshape(n, 3 * k, -1)
        own = slope[..., :OWN].reshape(n, 3 * k, OWN) * self._sigma()[:, None, :]
        told = (np.where(seen, off, 0.0) / model.noise_m).reshape(n, 3 * k, 1)
        inner = np.swapaxes(own, 1, 2) @ own + np.eye(OWN)
        mixed = np.swapaxes(every, 1, 2) @ own
        own_right = np.swapaxes(own, 1, 2) @ told + self._clamps_off(shapes)[..., None]
        shares = mixed @ np.linalg.inv(inner)
        matrix = (np.swapaxes(every, 1, 2) @ every - shares @ np.swapaxes(mixed, 1, 2)).sum(axis=0)
        right = (np.swapaxes(every, 1, 2) @ told - shares @ own_right).sum(axis=0)[:, 0]
        matrix += np.diag(np.repeat([LAW_SIGMA**-2, PLACEMENT_SIGMA_M**-2], [n_law, k]))
        right[n_law:] -= (model.marker_m - self.said_m) / PLACEMENT_SIGMA_M**2
        return PooledEquations(matrix, right, shares.sum(axis=0))

    def _off(self, shapes: RodShapes) -> Floats:
        return np.asarray(self.cells.markers_m[self.rows] - shapes.near_m)

    def _sigma(self) -> Floats:
        return np.repeat(self.cells.sigma[self.rows], (3, 3, 2, 2), axis=1)

    def _clamps_off(self, shapes: RodShapes) -> Floats:
        """Return by how much the clamps (R, 10) are not where their holders say, over their sigma."""
        clamps = self.cells.clamps[self.rows]
        start = np.einsum("rac,ra->rc", shapes.turned[:, 0, :, 6:8], clamps[:, 3:6])
        end = np.einsum("rac,ra->rc", shapes.turned[:, -1, :, 8:10], clamps[:, 6:9])
        off = np.column_stack([-shapes.place_m[:, :3], clamps[:, :3] - shapes.place_m[:, 3:], start, end])
        return np.where(shapes.settled[:, None], off / self._sigma(), 0.0)

    def _costs(self, model: RodModel, shapes: RodShapes) -> Floats:
        """Return the cost of each shape (R,); NaN without balance."""
        off = np.nan_to_num(self._off(shapes)) / model.noise_m
        costs = (off**2).sum(axis=(1, 2)) + (self._clamps_off(shapes) ** 2).sum(axis=1)
        return np.where(shapes.settled, costs, np.nan)
