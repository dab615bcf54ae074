"""Curves of which place, direction and curvature are known at every arc length: what a measurement is held against."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bench.analysis.arrays import Floats

__all__ = ["Catenary", "Circle", "KnownShape", "SampledShape", "Straight"]


class KnownShape(Protocol):
    """A curve in the plane z = 0, y up, by its arc length."""

    @property
    def name(self) -> str:
        """What it is, with its size."""
        ...

    @property
    def length_m(self) -> float:
        """Its whole length; infinite for a curve without ends."""
        ...

    @property
    def is_uniform(self) -> bool:
        """Whether the curve moved along itself is the same curve, so that a place on it cannot be told."""
        ...

    def place(self, arc_length_m: Floats) -> Floats:
        """Return the points (..., 3) at arc lengths (...)."""
        ...

    def tangent(self, arc_length_m: Floats) -> Floats:
        """Return the unit tangents (..., 3), towards growing arc length."""
        ...

    def curvature(self, arc_length_m: Floats) -> Floats:
        """Return the curvature (...), 1/m."""
        ...


@dataclass(frozen=True)
class Circle:
    """A circle, eq. (3) of the paper."""

    radius_m: float

    @property
    def name(self) -> str:
        return f"circle, r = {self.radius_m * 1e3:g} mm"

    @property
    def length_m(self) -> float:
        return 2 * np.pi * self.radius_m

    @property
    def is_uniform(self) -> bool:
        return True

    def place(self, arc_length_m: Floats) -> Floats:
        angle = arc_length_m / self.radius_m
        return self.radius_m * _in_plane(np.cos(angle), np.sin(angle))

    def tangent(self, arc_length_m: Floats) -> Floats:
        angle = arc_length_m / self.radius_m
        return _in_plane(-np.sin(angle), np.cos(angle))

    def curvature(self, arc_length_m: Floats) -> Floats:
        return np.full_like(arc_length_m, 1.0 / self.radius_m)


@dataclass(frozen=True)
class Catenary:
    """A catenary y = a cosh(x / a), eq. (4) of the paper, by its arc length."""

    a_m: float
    bottom_m: float = 0.0
    """Arc length of its lowest place: half the length for one hung between ends of equal height."""

    @property
    def name(self) -> str:
        return f"catenary, a = {self.a_m * 1e3:g} mm"

    @property
    def length_m(self) -> float:
        return np.inf

    @property
    def is_uniform(self) -> bool:
        return False

    def place(self, arc_length_m: Floats) -> Floats:
        beyond = arc_length_m - self.bottom_m
        return _in_plane(self.a_m * np.arcsinh(beyond / self.a_m), np.hypot(self.a_m, beyond))

    def tangent(self, arc_length_m: Floats) -> Floats:
        beyond = arc_length_m - self.bottom_m
        return _in_plane(np.full_like(beyond, self.a_m), beyond) / np.hypot(self.a_m, beyond)[..., None]

    def curvature(self, arc_length_m: Floats) -> Floats:
        """Return 1 / R with R = a + (s - s_bottom)^2 / a: eq. (5), whose exponent the paper misprints."""
        beyond = arc_length_m - self.bottom_m
        return np.asarray(1.0 / (self.a_m + beyond**2 / self.a_m), dtype=np.float64)


@dataclass(frozen=True)
class Straight:
    """A straight line."""

    @property
    def name(self) -> str:
        return "straight line"

    @property
    def length_m(self) -> float:
        return np.inf

    @property
    def is_uniform(self) -> bool:
        return True

    def place(self, arc_length_m: Floats) -> Floats:
        return _in_plane(arc_length_m, np.zeros_like(arc_length_m))

    def tangent(self, arc_length_m: Floats) -> Floats:
        return _in_plane(np.ones_like(arc_length_m), np.zeros_like(arc_length_m))

    def curvature(self, arc_length_m: Floats) -> Floats:
        return np.zeros_like(arc_length_m)


@dataclass(frozen=True, eq=False)
class SampledShape:
    """A plane curve known at n places close together, such as a solution of a rod's equations."""

    name: str
    arc_length_m: Floats
    """(n,): ascending from 0."""
    angle_rad: Floats
    """(n,): direction of the tangent from the x axis."""
    position_m: Floats
    """(n, 3)"""
    curvature_per_m: Floats
    """(n,)"""

    @property
    def length_m(self) -> float:
        return float(self.arc_length_m[-1])

    @property
    def is_uniform(self) -> bool:
        return False

    def place(self, arc_length_m: Floats) -> Floats:
        columns = [np.interp(arc_length_m, self.arc_length_m, column) for column in self.position_m.T]
        return np.stack(columns, axis=-1)

    def tangent(self, arc_length_m: Floats) -> Floats:
        angle = np.interp(arc_length_m, self.arc_length_m, self.angle_rad)
        return _in_plane(np.cos(angle), np.sin(angle))

    def curvature(self, arc_length_m: Floats) -> Floats:
        return np.asarray(np.interp(arc_length_m, self.arc_length_m, self.curvature_per_m))


def _in_plane(x: Floats, y: Floats) -> Floats:
    return np.stack([x, y, np.zeros_like(x)], axis=-1)
