"""A recorded known shape: how far the set-up, and every estimator on it, are from the truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.analysis import (
    TRUSTED_CONFIDENCE,
    CurveEstimator,
    ErrorFigures,
    KnownShape,
    ShapeFit,
    average_frames,
    fit_shape,
    fit_size,
    measure_errors,
    verify_on_shape,
)
from bench.errors import AnalysisError
from bench.report.accuracy.study import estimate
from bench.report.results import Results

__all__ = ["MeasuredOn", "Template", "measure_template"]

Floats = npt.NDArray[np.float64]

MOST_FRAMES = 2_000
"""Complete frames, spread over the recording, that are measured: their median is good to 3 % of their scatter."""


@dataclass(frozen=True, eq=False)
class MeasuredOn:
    """One estimator on the recorded shape."""

    estimator: str
    figures: ErrorFigures | None
    skipped: str = ""


@dataclass(frozen=True, eq=False)
class Template:
    """A recorded shape whose truth is known, with k markers in F complete frames."""

    results: Results
    shape: KnownShape
    own_size_m: float
    """The size with which the shape fits the markers best; NaN for a shape without one."""
    fit: ShapeFit
    n_complete: int
    """Frames of the recording with every marker, found without doubt."""
    n_frames: int
    """F: those that were measured."""
    placement_m: Floats
    """(k,): how far each marker is from where it is meant to be along the cable, less what all have in common."""
    frame_rms_m: Floats
    """(F,): root mean square distance of a frame's markers from the shape."""
    frame_max_m: Floats
    """(F,): largest."""
    marker_noise_m: Floats
    """(k,): standard deviation of each marker's coordinates over the frames."""
    noise_m: float
    """Of all markers."""
    estimators: list[MeasuredOn]

    @property
    def truth_per_m(self) -> Floats:
        """(G,): the curvature at `results.arc_length_m`."""
        return self.shape.curvature(self.results.arc_length_m + self.fit.offset_m)

    @property
    def drawn_m(self) -> tuple[Floats, Floats]:
        """The shape's curve and its markers as they lie in its own plane: (n, 3) and (k, 3)."""
        at = np.linspace(self.fit.at_m[0], self.fit.at_m[-1], 200)
        turn = self.fit.lab_from_shape.rotation
        return self.shape.place(at), self.shape.place(self.fit.at_m) + self.fit.off_m @ turn


def measure_template(
    results: Results,
    shape: KnownShape,
    make: Callable[[float], KnownShape] | None,
    size_m: float,
    estimators: Mapping[str, CurveEstimator],
) -> Template:
    """Lay a known shape into a recording's markers and hold every estimator's curvature against it.

    Parameters
    ----------
    results : Results
        Of `analyse_run`.
    shape : KnownShape
    make : callable, optional
        Makes the shape of another size; None for a shape that has none.
    size_m : float
        Its size.
    estimators : mapping
        By name. The ends are unknown to them: a template has no clamps.

    Raises
    ------
    AnalysisError
        No frame has every marker, or the markers do not lie on the shape.
    TooFewMarkersError
        There are fewer than 4 markers.
    """
    position, n_complete = _complete_frames(results)
    arc = results.marker_arc_length_m
    mean, laid = average_frames(position)
    fit = fit_shape(mean, arc, shape)
    verify_on_shape(fit, arc, shape)
    off = _distances(laid, fit, shape)
    freedom = max(len(laid) - 1, 1) * (1 - 6 / (3 * len(arc)))
    variance = np.square(laid - mean).sum(axis=(0, 2)) / (3 * freedom)
    return Template(
        results=results,
        shape=shape,
        own_size_m=fit_size(mean, arc, make, size_m, fit) if make else np.nan,
        fit=fit,
        n_complete=n_complete,
        n_frames=len(position),
        placement_m=fit.at_m - arc - fit.offset_m,
        frame_rms_m=np.sqrt(np.mean(off**2, axis=1)),
        frame_max_m=off.max(axis=1),
        marker_noise_m=np.sqrt(variance),
        noise_m=float(np.sqrt(variance.mean())),
        estimators=_try_estimators(results, position, shape, fit, estimators),
    )


def _complete_frames(results: Results) -> tuple[Floats, int]:
    """Return frames with every marker and no doubt (F, k, 3), and how many there are in all."""
    frames = results.frames
    complete = np.flatnonzero((frames.source >= 0).all(axis=1) & (frames.confidence >= TRUSTED_CONFIDENCE))
    if not len(complete):
        raise AnalysisError(
            f"No frame of {results.run_path} has every marker: nothing is measured.",
            hint="`bench check --recording` says which markers are missing.",
        )
    chosen = complete[np.unique(np.linspace(0, len(complete) - 1, min(MOST_FRAMES, len(complete))).astype(np.int64))]
    return frames.position_m[chosen].astype(np.float64), len(complete)


def _distances(laid_m: Floats, fit: ShapeFit, shape: KnownShape) -> Floats:
    """Return each marker's distance from the shape (F, k): how far it is along it does not count."""
    off = laid_m - fit.lab_from_shape.apply(shape.place(fit.at_m))
    along = fit.lab_from_shape.turn(shape.tangent(fit.at_m))
    return np.asarray(np.linalg.norm(off - (off * along).sum(axis=2, keepdims=True) * along, axis=2))


def _try_estimators(
    results: Results, position_m: Floats, shape: KnownShape, fit: ShapeFit, estimators: Mapping[str, CurveEstimator]
) -> list[MeasuredOn]:
    arc, places = results.marker_arc_length_m, results.arc_length_m
    truth, noise_m = shape.curvature(places + fit.offset_m), results.config.analysis.marker_noise_mm * 1e-3
    measured = []
    for name, method in estimators.items():
        curve, why = estimate(method, position_m.astype(np.float32), arc, places, noise_m)
        measured.append(MeasuredOn(name, measure_errors(curve, truth) if curve else None, why))
    return measured
