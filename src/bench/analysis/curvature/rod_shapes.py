"""Settled rods: the compiled fit with the arrays that it fills in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, Ints
from bench.analysis.curvature.rod_frames import ShapeCells
from bench.analysis.curvature.rod_mesh import RodMesh

__all__ = ["RodModel", "RodShapes", "settle"]

MOST_LEVERAGE = 1000.0
"""A rod whose middle moves so many times as far as its clamp is about to snap: how it changes cannot be told."""


@dataclass(frozen=True, eq=False)
class RodModel:
    """What all frames of a recording have in common."""

    mesh: RodMesh
    marker_m: Floats
    """(k,): arc length of each marker."""
    law: Floats
    """(3,): M / w = law[0] k + law[1] tanh(k / law[2]), with w the weight per metre: m^3, m^2, 1/m."""
    noise_m: float


@dataclass(frozen=True, eq=False)
class RodShapes:
    """R rods in balance; what is not settled holds no meaning."""

    settled: Bools
    """(R,)"""
    way: Floats
    """(R, N + 2, 3): directions."""
    force_m: Floats
    """(R, 3): on the rod's end, over the weight per metre."""
    place_m: Floats
    """(R, 6): start and end, seen from where the anchor is held to be."""
    near_m: Floats
    """(R, k, 3): the rod at the markers."""
    slope: Floats
    """(R, k, 3, 13): how the rod at the markers changes with its clamps (10) and the law (3)."""
    turned: Floats
    """(R, N + 2, 3, 13): the same of the directions."""


def settle(cells: ShapeCells, rows: slice | Ints, model: RodModel, before: RodShapes | None = None) -> RodShapes:
    """Fit the rod to the shapes of some cells, from the shapes `before` where they are given."""
    from bench.analysis.kernels.rod import settle_rods

    mesh, markers = model.mesh, np.ascontiguousarray(cells.markers_m[rows])
    n, k, ways = len(markers), len(model.marker_m), len(mesh.at_m)
    way, force, place = np.zeros((n, ways, 3)), np.zeros((n, 3)), np.zeros((n, 6))
    started = np.zeros(n, dtype=bool)
    if before is not None:
        way, force, place = before.way.copy(), before.force_m.copy(), before.place_m.copy()
        started = before.settled
    near, slope, turned = np.empty((n, k, 3)), np.empty((n, k, 3, 13)), np.empty((n, ways, 3, 13))
    settled = settle_rods(
        markers,
        np.ascontiguousarray(cells.clamps[rows]),
        np.ascontiguousarray(cells.sigma[rows]),
        model.noise_m,
        model.law,
        model.marker_m,
        mesh.at_m,
        mesh.apart_m,
        mesh.reach(model.marker_m),
        mesh.end,
        mesh.weight,
        started,
        way,
        force,
        place,
        near,
        slope,
        turned,
    )
    settled &= np.abs(slope[..., :6]).max(axis=(1, 2, 3)) < MOST_LEVERAGE
    return RodShapes(settled, way, force, place, near, slope, turned)
