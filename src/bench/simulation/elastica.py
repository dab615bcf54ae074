"""The heavy elastica: a planar, inextensible rod with weight and bending stiffness, clamped at both ends.

The rod is cut into N straight segments whose directions are the unknowns; bending sits between neighbours, and
between the first and the last segment and the clamps at half a segment's distance. The two components of the end
force hold the end where it belongs (Lagrange multipliers). Newton's method on this discrete energy converges in a
few steps from a nearby shape, so every solution is reached through neighbours: from the free hanging catenary, whose
own end directions need no bending moment jump, by turning the clamps to where they belong; then along the path.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigvalsh_tridiagonal, solve_banded
from scipy.optimize import brentq

from bench.errors import ConfigError

__all__ = ["Clamps", "Elastica", "Shape"]

Floats = npt.NDArray[np.float64]

TOLERANCE = 1e-10
"""Newton's last step, radians: far below anything a tracker sees, well above rounding."""
LARGEST_STEP_RAD = 0.3
"""A longer step of Newton's method is shortened to this, so that it cannot jump to another branch."""
MOST_ITERATIONS = 60
MOST_HALVINGS = 8
"""A stretch between two shapes is halved at most this often before the solver gives up."""
FIRST_STEPS = 12
"""Steps in which the clamps turn from the catenary's directions to their own."""
TAUTEST = 0.97
"""Share of its length that a clamped cable may span; beyond it is a string under tension, not a hanging cable."""


@dataclass(frozen=True, slots=True)
class Clamps:
    """What the ends are held to: end position seen from the start, and the directions of the rod at both."""

    x_m: float
    y_m: float
    start_rad: float
    end_rad: float

    def towards(self, other: Clamps, share: float) -> Clamps:
        """Return the clamps a share of the way to others."""
        mixed = [a + (b - a) * share for a, b in zip(self._values(), other._values(), strict=True)]
        return Clamps(*mixed)

    def _values(self) -> tuple[float, float, float, float]:
        return self.x_m, self.y_m, self.start_rad, self.end_rad


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """One solution."""

    clamps: Clamps
    angle_rad: Floats
    """(N,): direction of each segment."""
    force_n: tuple[float, float]
    """Force on the end of the rod, x and y."""


class Elastica:
    """A rod of given length, weight and bending stiffness.

    Parameters
    ----------
    length_m : float
    weight_n_per_m : float
    stiffness_nm2 : float
        Bending stiffness EI.
    n_segments : int
        150 solve the peak curvature to 0.2 % where a segment is below a tenth of sqrt(EI / tension).
    """

    def __init__(self, length_m: float, weight_n_per_m: float, stiffness_nm2: float, n_segments: int = 150) -> None:
        self.length_m = length_m
        self.n_segments = n_segments
        self.segment_m = length_m / n_segments
        self._bend = stiffness_nm2 / self.segment_m
        # Weight beyond the middle of each segment: what its vertical force has to carry less.
        self._beyond_n = weight_n_per_m * self.segment_m * (n_segments - 0.5 - np.arange(n_segments))
        self._weight_n_per_m = weight_n_per_m

    def hang(self, clamps: Clamps) -> Shape:
        """Solve from nothing: hang the cable freely, then turn its clamps into place.

        Raises
        ------
        ConfigError
            The ends are further apart than the cable reaches, or no shape is found.
        """
        free = self._catenary(clamps)
        shape = self._newton(free, free.clamps)
        if shape is None:
            raise self._failure(clamps)
        for step in range(1, FIRST_STEPS + 1):
            shape = self.follow(shape, free.clamps.towards(clamps, step / FIRST_STEPS))
        return shape

    def follow(self, shape: Shape, clamps: Clamps) -> Shape:
        """Solve for clamps near those of a known shape. `ConfigError` if the shape cannot follow."""
        return self._follow(shape, clamps, MOST_HALVINGS)

    def curvature(self, shape: Shape) -> Floats:
        """Return the signed curvature (N + 1,), 1/m, at the segments' ends: the moments there over EI.

        At the clamps too: the change of direction over half a segment gives the moment at the clamp itself, since
        that is what balances the first segment. A parabola through the directions reads 2 % more there (measured
        against solve_bvp; this reads 0.05 % less).
        """
        turns = np.diff(shape.angle_rad, prepend=shape.clamps.start_rad, append=shape.clamps.end_rad)
        turns[[0, -1]] *= 2.0
        return np.asarray(turns / self.segment_m)

    def is_stable(self, shape: Shape) -> bool:
        """Tell whether the shape is a minimum of energy among the shapes with the same ends."""
        bands = np.full((3, self.n_segments), -self._bend)
        bands[1] = self._diagonal(shape.angle_rad, np.array(shape.force_n))
        n_falling = len(eigvalsh_tridiagonal(bands[1], bands[0, 1:], select="v", select_range=(-np.inf, 0.0)))
        border = np.stack([np.sin(shape.angle_rad), -np.cos(shape.angle_rad)], axis=1)
        schur = border.T @ solve_banded((1, 1), bands, border)
        # Sylvester's law for the bordered matrix: as many falling directions as constraints, and no more.
        return n_falling + int(np.count_nonzero(np.linalg.eigvalsh(schur) > 0.0)) == 2

    def _follow(self, shape: Shape, clamps: Clamps, halvings: int) -> Shape:
        found = self._newton(shape, clamps)
        if found is not None:
            return found
        if halvings == 0:
            raise self._failure(clamps)
        middle = self._follow(shape, shape.clamps.towards(clamps, 0.5), halvings - 1)
        return self._follow(middle, clamps, halvings - 1)

    def _newton(self, start: Shape, clamps: Clamps) -> Shape | None:
        angle, force = start.angle_rad.copy(), np.array(start.force_n)
        for _ in range(MOST_ITERATIONS):
            angle_step, force_step = self._newton_step(angle, force, clamps)
            largest = float(np.abs(angle_step).max())
            if not np.isfinite(largest):
                return None
            scale = min(1.0, LARGEST_STEP_RAD / max(largest, 1e-300))
            angle += scale * angle_step
            force += scale * force_step
            if largest < TOLERANCE:
                return Shape(clamps, angle, (float(force[0]), float(force[1])))
        return None

    def _newton_step(self, angle: Floats, force: Floats, clamps: Clamps) -> tuple[Floats, Floats]:
        """Solve the tridiagonal system with its two border rows for the three right-hand sides at once."""
        cosine, sine, h = np.cos(angle), np.sin(angle), self.segment_m
        bands = np.full((3, self.n_segments), -self._bend)
        bands[1] = self._diagonal(angle, force)
        border = np.stack([h * sine, -h * cosine], axis=1)
        right = np.column_stack([self._gradient(angle, force, clamps), border])
        solved = solve_banded((1, 1), bands, right, check_finite=False, overwrite_ab=True, overwrite_b=True)
        gap = np.array([h * cosine.sum() - clamps.x_m, h * sine.sum() - clamps.y_m])
        # Rows of the border: d(end)/d(angle) = (-h sine, h cosine) = -border.
        schur = border.T @ solved[:, 1:]
        force_step = np.linalg.solve(schur, -gap - border.T @ solved[:, 0])
        return np.asarray(-solved[:, 0] - solved[:, 1:] @ force_step), np.asarray(force_step)

    def _gradient(self, angle: Floats, force: Floats, clamps: Clamps) -> Floats:
        h, h_force, v_force = self.segment_m, force[0], force[1]
        turns = np.diff(angle, prepend=clamps.start_rad, append=clamps.end_rad)
        turns[[0, -1]] *= 2.0
        carried = v_force - self._beyond_n
        return np.asarray(-self._bend * np.diff(turns) + h * (h_force * np.sin(angle) - carried * np.cos(angle)))

    def _diagonal(self, angle: Floats, force: Floats) -> Floats:
        diagonal = np.full(self.n_segments, 2.0 * self._bend)
        diagonal[[0, -1]] += self._bend
        carried = force[1] - self._beyond_n
        return np.asarray(diagonal + self.segment_m * (force[0] * np.cos(angle) + carried * np.sin(angle)))

    def _catenary(self, clamps: Clamps) -> Shape:
        """Return the freely hanging chain between the ends, with clamps in its own directions."""
        x, y, length = clamps.x_m, clamps.y_m, self.length_m
        if np.hypot(x, y) > TAUTEST * length:
            raise ConfigError(
                f"The simulated cable of {length:g} m cannot hang between ends that are {np.hypot(x, y):.3f} m apart.",
                hint="Give a longer [cable] length_m.",
            )
        sag = np.sqrt(length**2 - y**2) / x
        parameter = x / (2.0 * brentq(lambda u: np.sinh(u) / u - sag, 1e-6, 50.0))
        middle = (np.arange(self.n_segments) + 0.5) * self.segment_m
        offset = 0.5 * (length - y / np.tanh(x / (2.0 * parameter)))
        angle = np.arctan((middle - offset) / parameter)
        ends = np.arctan((np.array([0.0, length]) - offset) / parameter)
        tension = self._weight_n_per_m * parameter
        force = (tension, self._weight_n_per_m * (length - offset))
        free = replace(clamps, start_rad=float(ends[0]), end_rad=float(ends[1]))
        return Shape(free, angle, force)

    def _failure(self, clamps: Clamps) -> ConfigError:
        return ConfigError(
            f"No shape of the simulated cable of {self.length_m:g} m was found between clamps "
            f"{np.hypot(clamps.x_m, clamps.y_m):.3f} m apart.",
            hint="Check length_m, bending_stiffness_nm2 and weight_n_per_m.",
        )
