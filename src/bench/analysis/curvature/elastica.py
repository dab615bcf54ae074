"""Curvature by the heavy rod: gravity, bending stiffness and both clamps; one stiffness for the whole recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Floats, Floats32
from bench.analysis.curvature.estimate import ClampedEnds, CurveEstimate
from bench.analysis.curvature.rod_frames import RodFrames, ShapeCells, find_cells, place_in_rod
from bench.analysis.curvature.rod_law import FittedLaw, fit_law
from bench.analysis.curvature.rod_mesh import make_rod_mesh
from bench.analysis.curvature.rod_notes import describe_fit, warn_of_fit
from bench.analysis.curvature.rod_reading import read_cells
from bench.analysis.curvature.rod_shapes import RodModel

__all__ = ["FittedRod", "fit_elastica", "fit_rod"]

MESH_NOISE_SHARE = 1e-5
"""Of the length: the mesh's own error of places, 0.012 mm on 1.5 m (measured 2026-11 against scipy's solver)."""


@dataclass(frozen=True, eq=False)
class FittedRod:
    """The law of bending that suits a recording of F frames, with the shapes that it was found with."""

    law: FittedLaw
    frames: RodFrames
    cells: ShapeCells
    n_frames: int

    def read(self, arc_length_m: Floats, *, with_vector: bool = False) -> CurveEstimate:
        """Return the curvature at arc lengths (G,)."""
        shape = (self.n_frames, len(arc_length_m))
        curvature, sigma = np.full(shape, np.nan, dtype=np.float32), np.full(shape, np.nan, dtype=np.float32)
        vector = np.full((*shape, 3), np.nan, dtype=np.float32) if with_vector else None
        residual = np.full(self.n_frames, np.nan, dtype=np.float32)
        inside = np.flatnonzero((arc_length_m >= 0.0) & (arc_length_m <= self.frames.length_m))
        for part in read_cells(self.frames, self.cells, self.law, arc_length_m[inside], with_vector=with_vector):
            frames = self.frames.row[part.frame]
            rows = np.ix_(frames, inside)
            curvature[rows], sigma[rows], residual[frames] = part.curvature_per_m, part.sigma_per_m, part.residual_m
            if vector is not None:
                vector[rows] = part.vector_per_m
        warnings = warn_of_fit(self.law, residual)
        return CurveEstimate(curvature, sigma, vector, residual, "elastica", [describe_fit(self.law)], warnings)


def fit_elastica(
    position_m: Floats32,
    marker_arc_length_m: Floats,
    arc_length_m: Floats,
    noise_m: float,
    *,
    ends: ClampedEnds | None = None,
    with_vector: bool = False,
) -> CurveEstimate:
    """Estimate the curvature from clamp to clamp as that of a heavy rod at rest.

    An inextensible rod, naturally straight, alike in all directions across, free to turn about its own axis, hangs
    under its weight between clamps. Each frame leaves open where the two clamps are and point (a prior with the
    standard deviations of `ends`); all frames together leave open the ratio of bending stiffness and weight per metre,
    and by a few millimetres where the markers sit along the rod. Where the rod then misses the markers by more than
    twice the noise, a stiffness that falls as the strands slip, M = EI k + M0 tanh(k / k0), is tried.

    Frames whose clamps stand alike share a shape: the rod is settled on their median, and each is one linear step away.

    Parameters
    ----------
    position_m : (F, k, 3)
        Sorted markers, lab frame, NaN where not found. Frames with fewer than three, or without both clamps, are NaN.
    marker_arc_length_m : (k,)
        Arc length of each marker from the anchor.
    arc_length_m : (G,)
        Where the curvature is wanted, from 0 to ``ends.length_m``; beyond them it is NaN.
    noise_m : float
        Standard deviation of a marker's position, for each coordinate.
    ends : ClampedEnds
        Both clamps with place and direction.
    with_vector : bool
        Whether the curvature vector is wanted, too: three times the memory.

    Returns
    -------
    CurveEstimate
        The standard deviation holds the markers' noise, the clamps' and the stiffness's, and widens with the frame's
        residual; it does not hold that the cable is no such rod. `residual_m` tells: two to three times the noise says
        that the model is wrong.

    Raises
    ------
    AnalysisError
        A clamp's place or direction is known in no frame, or no rod in balance suits the frames.
    """
    rod = fit_rod(position_m, marker_arc_length_m, noise_m, ends)
    return rod.read(arc_length_m, with_vector=with_vector)


def fit_rod(position_m: Floats32, marker_arc_length_m: Floats, noise_m: float, ends: ClampedEnds | None) -> FittedRod:
    """Fit the law of bending to a recording, as `fit_elastica` does before it reads the curvature."""
    frames = place_in_rod(position_m, ends, noise_m)
    cells = find_cells(frames)
    mesh, noise_m = make_rod_mesh(frames.length_m, frames.up), max(noise_m, MESH_NOISE_SHARE * frames.length_m)
    law = fit_law(cells, RodModel(mesh, marker_arc_length_m, np.zeros(3), noise_m))
    return FittedRod(law, frames, cells, len(position_m))
