"""Each frame's curvature from the settled rod of its cell."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.arrays import Floats, Ints, chunks
from bench.analysis.curvature.rod_frames import RodFrames, ShapeCells
from bench.analysis.curvature.rod_law import FittedLaw
from bench.analysis.curvature.rod_mesh import RodMesh
from bench.analysis.curvature.rod_shapes import RodShapes, settle

__all__ = ["ReadFrames", "read_cells"]

SHAPES_AT_ONCE = 64
"""A shape with its slopes at 100 places is 70 kB: 64 are 4 MB, which a core's cache holds."""
MESH_SIGMA = 1e-3
"""Of the curvature: the mesh's own error, 0.04 to 0.1 % down to radii of 44 mm on 1.5 m (measured 2026-11)."""


@dataclass(frozen=True, eq=False)
class ReadFrames:
    """Curvature of some frames at G places."""

    frame: Ints
    """(C,): which of the frames that a rod can be fitted to."""
    curvature_per_m: Floats
    """(C, G)"""
    sigma_per_m: Floats
    """(C, G)"""
    vector_per_m: Floats
    """(C, G, 3), or (0, G, 3) where it was not asked for."""
    residual_m: Floats
    """(C,)"""


def read_cells(
    frames: RodFrames, cells: ShapeCells, law: FittedLaw, arc_length_m: Floats, *, with_vector: bool
) -> Iterator[ReadFrames]:
    """Yield the curvature of all frames whose cell has a rod in balance."""
    # What the law leaves unexplained counts as noise: then the clamps say more, and the band is wider.
    law = replace(law, model=replace(law.model, noise_m=max(law.model.noise_m, law.residual_m)))
    unseen = np.packbits(np.isnan(frames.markers_m[:, :, 0]), axis=1)
    order = np.lexsort((*unseen.T, cells.cell))
    bounds = np.searchsorted(cells.cell[order], np.arange(len(cells.markers_m) + 1))
    for start, stop in chunks(len(cells.markers_m), SHAPES_AT_ONCE):
        shapes = settle(cells, np.arange(start, stop), law.model)
        frame = order[bounds[start] : bounds[stop]]
        frame = frame[shapes.settled[cells.cell[frame] - start]]
        bends = _bends(shapes, law.model.mesh, arc_length_m)
        for first, last in chunks(len(frame)):
            yield _read(frames, frame[first:last], cells, start, shapes, bends, law, with_vector=with_vector)


def _bends(shapes: RodShapes, mesh: RodMesh, arc_length_m: Floats) -> tuple[Floats, Floats]:
    """Return the curvature vectors (R, G, 3) of settled rods, and how they change (R, G, 3, 13)."""
    from bench.analysis.kernels.rod_reading import read_bends

    n, n_places = len(shapes.way), len(arc_length_m)
    bend, slope = np.empty((n, n_places, 3)), np.empty((n, n_places, 3, 13))
    read_bends(shapes.way, shapes.turned, mesh.apart_m, *mesh.interpolate(arc_length_m), bend, slope)
    return bend, slope


def _read(
    frames: RodFrames,
    frame: Ints,
    cells: ShapeCells,
    start: int,
    shapes: RodShapes,
    bends: tuple[Floats, Floats],
    law: FittedLaw,
    *,
    with_vector: bool,
) -> ReadFrames:
    from bench.analysis.kernels.rod_reading import read_frames

    n, n_places, k = len(frame), bends[0].shape[1], frames.markers_m.shape[1]
    curvature, sigma, off = np.empty((n, n_places)), np.empty((n, n_places)), np.empty((n, k, 3))
    vector = np.empty((n if with_vector else 0, n_places, 3))
    read_frames(
        frames.markers_m[frame],
        frames.clamps[frame],
        np.ascontiguousarray(cells.sigma[start : start + len(shapes.way)]),
        law.model.noise_m,
        cells.cell[frame] - start,
        shapes.turned,
        shapes.place_m,
        shapes.near_m,
        shapes.slope,
        *bends,
        law.spread,
        curvature,
        sigma,
        vector,
        off,
    )
    residual = np.sqrt(np.nanmean(off**2, axis=(1, 2)))
    # A frame that fits worse than noise explains, for a marker in it is not the cable's, is known less well.
    sigma = np.hypot(sigma * np.maximum(1.0, residual / law.model.noise_m)[:, None], MESH_SIGMA * curvature)
    return ReadFrames(frame, curvature, sigma, vector, residual)
