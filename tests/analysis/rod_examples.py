"""Clamped rods in space, by scipy's boundary value solver, and clamps that are held a little wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from curve_examples import Known
from scipy.integrate import solve_bvp

from bench.analysis import CableEnd, ClampedEnds
from bench.simulation.elastica import Clamps, Elastica

Floats = npt.NDArray[np.float64]
LENGTH_M = 1.5
STIFFNESS = 0.02 / 1.5
"""EI over weight per metre, m^3."""


@dataclass(frozen=True, eq=False)
class Solved:
    """A rod, y upwards, its start at the origin."""

    s_m: Floats
    state: Floats
    """(12, n): place, direction, moment and force over the weight per metre."""
    bend_per_m: Floats
    """(n, 3): curvature times the binormal."""


def hang_rod(stiffness: float = STIFFNESS) -> Solved:
    """Return a rod in the plane z = 0, by the simulated bench's solver."""
    rod = Elastica(LENGTH_M, 1.0, stiffness, 300)
    shape = rod.hang(Clamps(0.8, 0.1, 0.2, 0.3))
    s, angle = np.linspace(0, LENGTH_M, 301), shape.angle_rad
    angle = np.interp(s, 0.5 * (s[1:] + s[:-1]), angle)
    angle[[0, -1]] = shape.clamps.start_rad, shape.clamps.end_rad
    bend = rod.curvature(shape)
    point = np.concatenate([[0], np.cumsum(np.exp(1j * shape.angle_rad))]) * rod.segment_m
    zero = 0 * s
    place, way = [point.real, point.imag, zero], [np.cos(angle), np.sin(angle), zero]
    pull, lift = shape.force_n
    force = [zero + pull, lift - (LENGTH_M - s), zero]
    state = np.stack([*place, *way, zero, zero, stiffness * bend, *force])
    return Solved(s, state, np.stack([zero, zero, bend], axis=1))


def bend_in_space(
    start: Solved, start_way: Floats, end_m: Floats, end_way: Floats, bend_of_moment: Callable[[Floats], Floats]
) -> Solved:
    """Solve a rod that bends alike in all directions across and carries no torque, from a shape nearby.

    `bend_of_moment` gives the curvature of a moment over the weight per metre.
    """
    across = np.linalg.svd(end_way[None])[2][1:]

    def bend(y: Floats) -> Floats:
        size = np.linalg.norm(y[6:9], axis=0)
        return np.asarray(y[6:9] * (bend_of_moment(size) / np.maximum(size, 1e-12)))

    def grow(s: Floats, y: Floats) -> Floats:
        falling = np.zeros((3, y.shape[1]))
        falling[1] = 1.0
        return np.vstack([y[3:6], np.cross(bend(y), y[3:6], axis=0), -np.cross(y[3:6], y[9:12], axis=0), falling])

    def hold(a: Floats, b: Floats) -> Floats:
        return np.concatenate([a[:3], a[3:6] - start_way, b[:3] - end_m, across @ b[3:6], [a[6:9] @ start_way]])

    found = solve_bvp(grow, hold, start.s_m, start.state, tol=1e-5, max_nodes=20_000)
    assert found.status == 0, found.message
    return Solved(found.x, found.y, bend(found.y).T)


def know(rods: list[Solved], n_markers: int) -> Known:
    """Return the rods as known shapes, with a marker at each clamp."""
    s, places = np.linspace(0, LENGTH_M, n_markers), np.linspace(0, LENGTH_M, 100)
    markers, curvature, tangents = [], [], []
    for rod in rods:
        markers.append(np.stack([np.interp(s, rod.s_m, x) for x in rod.state[:3]], axis=1))
        curvature.append(np.interp(places, rod.s_m, np.linalg.norm(rod.bend_per_m, axis=1)))
        tangents.append([rod.state[3:6, 0], -rod.state[3:6, -1]])
    return Known(np.array(markers), s, places, np.array(curvature), np.array(tangents))


def hold_both(
    known: Known, rng: np.random.Generator, sigma_m: float = 2e-4, sigma_rad: float = float(np.deg2rad(0.3))
) -> ClampedEnds:
    """Return both clamps, at the first and the last marker: as wrong as they say, and so in all frames alike."""
    n, ends = len(known.markers_m), []
    for side, marker in enumerate((0, -1)):
        way = known.tangents[:, side] + np.cross(rng.normal(0, sigma_rad, 3), known.tangents[:, side])
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        place = known.markers_m[:, marker] + rng.normal(0, sigma_m, 3)
        ends.append(CableEnd(place, np.full(n, sigma_m), way, np.full(n, sigma_rad)))
    return ClampedEnds(ends[0], ends[1], float(known.marker_s_m[-1]))
