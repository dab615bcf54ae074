"""A known shape laid into the markers that were measured on it: a template that proves a set-up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from bench.analysis.arrays import Floats
from bench.analysis.calibration.rigid import RigidTransform, align_points
from bench.analysis.study.shapes import KnownShape
from bench.errors import AnalysisError, TooFewMarkersError

__all__ = ["ShapeFit", "average_frames", "fit_shape", "fit_size", "verify_on_shape"]

FEWEST_MARKERS = 4
"""Three lie on every circle."""
MOST_DISTANCE = 0.1
"""Rms distance from the shape, as a share of the mean spacing, beyond which the markers lie on another shape."""
SLACK = 1e-3
"""What moving a marker along the shape costs beside moving it off: next to nothing, but told."""
STARTS = 81
"""Places on a shape that is not the same everywhere, from which the fit is tried."""
HELD_M = 1e-3
"""Markers nearer than this to one line do not tell how a frame is turned about it: it is left as it was."""
SIZE_RANGE = (0.5, 2.0)
"""In which the markers' own size is looked for, as a share of the given one."""


@dataclass(frozen=True, eq=False)
class ShapeFit:
    """The shape where it fits k markers best."""

    lab_from_shape: RigidTransform
    at_m: Floats
    """(k,): arc length on the shape of the place nearest to each marker."""
    offset_m: float
    """Arc length on the shape of the cable's arc length 0."""
    off_m: Floats
    """(k, 3): from that place to the marker, lab frame."""

    @property
    def distance_m(self) -> Floats:
        """(k,): each marker's distance from the shape."""
        return np.asarray(np.linalg.norm(self.off_m, axis=1))

    @property
    def rms_m(self) -> float:
        """Root mean square of the distances."""
        return float(np.sqrt(np.mean(self.distance_m**2)))


def fit_shape(position_m: Floats, marker_arc_length_m: Floats, shape: KnownShape) -> ShapeFit:
    """Turn and shift a known shape until the markers lie on it as well as they can.

    Each marker may sit anywhere along the shape: so placement errors do not move it off, and are found by themselves.

    Parameters
    ----------
    position_m : (k, 3)
        Markers, all known, k >= 4.
    marker_arc_length_m : (k,)
        Where they are meant to be along the cable.
    shape : KnownShape

    Raises
    ------
    TooFewMarkersError
        Fewer than 4 markers.
    AnalysisError
        The shape is shorter than the cable between the markers.
    """
    if len(position_m) < FEWEST_MARKERS:
        raise TooFewMarkersError(f"{len(position_m)} markers tell no shape: at least {FEWEST_MARKERS} are needed.")
    span = float(marker_arc_length_m[-1] - marker_arc_length_m[0])
    if span > shape.length_m:
        raise AnalysisError(
            f"The markers cover {span * 1e3:.0f} mm of cable, but the shape ({shape.name}) has only "
            f"{shape.length_m * 1e3:.0f} mm.",
            hint="Check the size and marker_arc_length_m.",
        )
    return _refine(position_m, marker_arc_length_m, shape, _find_start(position_m, marker_arc_length_m, shape))


def verify_on_shape(fit: ShapeFit, marker_arc_length_m: Floats, shape: KnownShape) -> None:
    """Raise `AnalysisError` if the markers lie on another shape: further off than a tenth of their spacing (rms)."""
    span = float(marker_arc_length_m[-1] - marker_arc_length_m[0])
    limit = MOST_DISTANCE * span / (len(marker_arc_length_m) - 1)
    if fit.rms_m > limit:
        raise AnalysisError(
            f"The markers do not lie on the shape ({shape.name}): they are {fit.rms_m * 1e3:.1f} mm from it (rms; at "
            f"most {limit * 1e3:.1f} mm, a tenth of their spacing).",
            hint="Check the size, and that nothing else was recorded than the shape.",
        )


def fit_size(
    position_m: Floats, marker_arc_length_m: Floats, make: Callable[[float], KnownShape], size_m: float, fit: ShapeFit
) -> float:
    """Return the size with which the shape fits best, between half and twice `size_m`, to which `fit` belongs."""
    start = fit.lab_from_shape, fit.at_m

    def misfit(scale: float) -> float:
        return _refine(position_m, marker_arc_length_m, make(size_m * scale), start).rms_m

    found = scipy.optimize.minimize_scalar(misfit, bounds=SIZE_RANGE, method="bounded", options={"xatol": 1e-5})
    return size_m * float(found.x)


def average_frames(position_m: Floats) -> tuple[Floats, Floats]:
    """Return the mean shape (k, 3) of frames (F, k, 3) of one solid, and all frames laid onto it (F, k, 3).

    The solid may move: each frame is turned and shifted onto the others, by least squares.
    """
    laid = _lay_onto(position_m, position_m[0])
    laid = _lay_onto(position_m, laid.mean(axis=0))
    return laid.mean(axis=0), laid


def _lay_onto(position_m: Floats, target_m: Floats) -> Floats:
    """Turn and shift each of F frames (F, k, 3) onto the target (k, 3). Kabsch's method, all frames at once."""
    middle, goal = position_m.mean(axis=1, keepdims=True), target_m.mean(axis=0)
    held = HELD_M**2 * len(target_m) * np.eye(3)
    u, _, vt = np.linalg.svd(np.swapaxes(position_m - middle, 1, 2) @ (target_m - goal) + held)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return np.asarray((position_m - middle) @ (u @ vt) + goal, dtype=np.float64)


def _find_start(position_m: Floats, marker_arc_length_m: Floats, shape: KnownShape) -> tuple[RigidTransform, Floats]:
    """Return where the shape lies about right, with the markers' places on it as they are meant to be."""
    span = marker_arc_length_m[-1] - marker_arc_length_m[0]
    offsets = np.zeros(1) if shape.is_uniform else np.linspace(-1.5 * span, 1.5 * span, STARTS)
    tried = [_try_start(position_m, marker_arc_length_m + offset, shape) for offset in offsets]
    return min(tried, key=lambda one: one[0])[1:]


def _try_start(position_m: Floats, at_m: Floats, shape: KnownShape) -> tuple[float, RigidTransform, Floats]:
    points = shape.place(at_m)
    transform, _ = align_points(points, position_m, np.ones(len(points)))
    return float(np.linalg.norm(transform.apply(points) - position_m)), transform, at_m


def _refine(
    position_m: Floats, marker_arc_length_m: Floats, shape: KnownShape, start: tuple[RigidTransform, Floats]
) -> ShapeFit:
    """Fit pose and places on the shape together."""
    pose, at_m = start

    def misfit(change: Floats) -> Floats:
        at = at_m + change[6:]
        off = pose.changed_by(change[:6]).apply(shape.place(at)) - position_m
        slid = at - marker_arc_length_m
        free = 0.0 if shape.is_uniform else slid.mean()
        return np.concatenate([off.ravel(), SLACK * (slid - free)])

    found = scipy.optimize.least_squares(misfit, np.zeros(6 + len(at_m)), method="lm")
    pose, at_m = pose.changed_by(found.x[:6]), at_m + found.x[6:]
    offset = float(np.mean(at_m - marker_arc_length_m))
    return ShapeFit(pose, at_m, offset, position_m - pose.apply(shape.place(at_m)))
