"""Curves whose curvature is known, with their markers and the tangents of their ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from bench.analysis import CableEnd, ClampedEnds
from bench.simulation.elastica import Clamps, Elastica

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Known:
    """F shapes."""

    markers_m: Floats
    """(F, k, 3)"""
    marker_s_m: Floats
    """(k,)"""
    places_m: Floats
    """(G,)"""
    curvature_per_m: Floats
    """(F, G)"""
    tangents: Floats
    """(F, 2, 3): from the first and from the last marker into the cable."""

    def repeat(self, n: int) -> Known:
        """Return each shape n times."""
        rows = [np.repeat(a, n, axis=0) for a in (self.markers_m, self.curvature_per_m, self.tangents)]
        return Known(rows[0], self.marker_s_m, self.places_m, rows[1], rows[2])

    def see(self, rng: np.random.Generator, noise_m: float) -> npt.NDArray[np.float32]:
        """Return the markers with noise."""
        return (self.markers_m + rng.normal(0, noise_m, self.markers_m.shape)).astype(np.float32)

    def hold(self, rng: np.random.Generator, sigma_rad: float) -> ClampedEnds:
        """Return the tangents with noise; the clamps are at the first and last marker."""
        return clamp(self.tangents + rng.normal(0, sigma_rad, self.tangents.shape), sigma_rad, self.marker_s_m[-1])


def clamp(tangents: Floats, sigma_rad: float, length_m: float) -> ClampedEnds:
    """Return ends of which only the tangents (F, 2, 3) are known."""
    unit = tangents / np.linalg.norm(tangents, axis=2, keepdims=True)
    n_frames = len(unit)
    nowhere, sigma = np.full((n_frames, 3), np.nan), np.full(n_frames, sigma_rad)
    ends = [CableEnd(nowhere, nowhere[:, 0], unit[:, side], sigma) for side in (0, 1)]
    return ClampedEnds(ends[0], ends[1], length_m)


def make_circle(marker_s_m: Floats | None = None, radius_m: float = 0.4) -> Known:
    """Return the paper's circle, 8 markers on 315 degrees, or one with markers at other places."""
    s = radius_m * np.arange(8) * np.pi / 4 if marker_s_m is None else marker_s_m
    angle = s / radius_m
    markers = radius_m * np.stack([np.sin(angle), 1 - np.cos(angle), 0 * angle], axis=1)
    tangents = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)[[0, -1]] * [[1], [-1]]
    places = np.linspace(s[0], s[-1], 100)
    return Known(markers[None], s, places, np.full((1, 100), 1 / radius_m), tangents[None])


def make_catenary() -> Known:
    """Return the paper's catenary: a = 0.5 m, L = 2 m, 12 markers."""
    a, s, places = 0.5, np.linspace(0.0, 2.0, 12), np.linspace(0.0, 2.0, 100)
    markers = np.stack([a * np.arcsinh((s - 1) / a), np.hypot(a, s - 1), 0 * s], axis=1)
    tangents = np.array([[a, -1.0, 0.0], [-a, -1.0, 0.0]]) / np.hypot(a, 1.0)
    return Known(markers[None], s, places, (a / (a**2 + (places - 1) ** 2))[None], tangents[None])


def make_rods(stiffness_nm2: float, n_markers: int, n_shapes: int = 24) -> Known:
    """Return shapes of a hanging rod of 1.5 m, 1.5 N/m, whose end goes round while both clamps turn.

    No figure of the program was chosen on this motion.
    """
    length_m = 1.5
    rod = Elastica(length_m, 1.5, stiffness_nm2, 300)
    turn = np.linspace(0, 2 * np.pi, n_shapes, endpoint=False)
    ways = [
        Clamps(0.8 + 0.12 * np.cos(p), 0.15 + 0.2 * np.sin(p), 0.1 + 0.5 * np.sin(p), 0.2 - 0.5 * np.cos(p))
        for p in turn
    ]
    shapes = [rod.hang(ways[0])]
    for way in ways[1:]:
        shapes.append(rod.follow(shapes[-1], way))
    s, nodes = np.linspace(0, length_m, n_markers), np.linspace(0, length_m, rod.n_segments + 1)
    places = np.linspace(0, length_m, 100)
    points = [np.cumsum(np.r_[0.0, np.exp(1j * shape.angle_rad)]) * rod.segment_m for shape in shapes]
    held = np.exp(1j * np.array([[shape.clamps.start_rad, shape.clamps.end_rad] for shape in shapes]))
    curves = [CubicSpline(nodes, p, bc_type=((1, t[0]), (1, t[1])))(s) for p, t in zip(points, held, strict=True)]
    curvature = [np.abs(CubicSpline(nodes, rod.curvature(shape))(places)) for shape in shapes]
    return Known(_in_space(np.array(curves)), s, places, np.array(curvature), _in_space(held * [1, -1]))


def _in_space(plane: npt.NDArray[np.complex128]) -> Floats:
    return np.stack([plane.real, plane.imag, 0 * plane.real], axis=-1)
