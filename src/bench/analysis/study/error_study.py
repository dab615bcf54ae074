"""How far an estimator's curvature is from the truth on known shapes: the paper's error analysis, its section 4."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Floats, Floats32
from bench.analysis.curvature.ends import CableEnd
from bench.analysis.curvature.estimate import ClampedEnds, CurveEstimate
from bench.analysis.study.shapes import KnownShape

__all__ = ["Condition", "ErrorFigures", "make_ends", "make_frames", "measure_errors"]

LEAST_NOISE_M = 1e-6
LEAST_TURN_RAD = 1e-6
"""What an estimator is told of noise that is none: far below any tracker's, and no covariance becomes singular."""


@dataclass(frozen=True)
class Condition:
    """What goes wrong on the way from a known shape to its markers' positions."""

    noise_m: float = 0.0
    """Standard deviation of each coordinate of each marker, anew in each frame."""
    placement_m: float = 0.0
    """Standard deviation of a marker's place along the cable, which the estimator does not know."""
    n_hidden: int = 0
    """Markers that are not seen: any but the first and the last, anew in each frame."""

    @property
    def told_noise_m(self) -> float:
        """What the estimator is told of the noise."""
        return max(self.noise_m, LEAST_NOISE_M)


@dataclass(frozen=True, eq=False)
class ErrorFigures:
    """Errors of F frames of one shape, at G places."""

    max_radius_error: float
    """Largest |R - R_true| / R_true along the cable: median over the frames. NaN for a straight shape."""
    rms_radius_error: float
    """Root mean square along the cable of the same: median over the frames."""
    peak_bias: float
    """Error of a frame's largest curvature, as a share of the true one: mean over the frames."""
    peak_sd: float
    """Its standard deviation over the frames."""
    peak_inside_band: float
    """Share of the frames whose largest curvature lies within two of its standard deviations of the true one."""
    inside_band: float
    """Share of all values that lie within two of their standard deviations of the truth."""
    scatter: float
    """Standard deviation over the frames, as a share of what the estimator says it is: median along the cable."""
    unknown: float
    """Share of all values that the estimator did not give."""
    radius_quantiles_m: Floats
    """(3, G): 5 %, 50 % and 95 % of the bend radius over the frames."""


def make_frames(
    shape: KnownShape, marker_arc_length_m: Floats, condition: Condition, n_frames: int, rng: np.random.Generator
) -> Floats32:
    """Return the markers (F, k, 3) of a known shape as a tracker would give them; NaN where hidden.

    Parameters
    ----------
    shape : KnownShape
    marker_arc_length_m : (k,)
        Where the markers are meant to be.
    condition : Condition
    n_frames : int
    rng : Generator
        The same seed gives the same frames.
    """
    size = (n_frames, len(marker_arc_length_m))
    at = marker_arc_length_m + condition.placement_m * rng.standard_normal(size)
    position = shape.place(at) + condition.noise_m * rng.standard_normal((*size, 3))
    if condition.n_hidden:
        hidden = 1 + rng.random((n_frames, size[1] - 2)).argsort(axis=1)[:, : condition.n_hidden]
        np.put_along_axis(position, hidden[:, :, None], np.nan, axis=1)
    return position.astype(np.float32)


def make_ends(
    shape: KnownShape, span_m: tuple[float, float], turn_rad: float, condition: Condition, n_frames: int, seed: int
) -> ClampedEnds:
    """Return what is known of clamps at both ends of `span_m`: their places and the cable's directions in them.

    Parameters
    ----------
    shape : KnownShape
    span_m : tuple of float
        Arc lengths of the clamps.
    turn_rad : float
        Standard deviation of the directions, about each axis; nothing is wrong where there is no noise.
    condition : Condition
        Its noise is that of the clamps' places, too: the tracker sees them.
    n_frames : int
    seed : int
    """
    rng = np.random.default_rng(seed)
    wrong_rad = turn_rad if condition.noise_m else 0.0
    ends = []
    for at, sign in zip(span_m, (1.0, -1.0), strict=True):
        place, tangent = shape.place(np.array(at)), sign * shape.tangent(np.array(at))
        turned = tangent + np.cross(wrong_rad * rng.standard_normal((n_frames, 3)), tangent)
        ends.append(
            CableEnd(
                place + condition.noise_m * rng.standard_normal((n_frames, 3)),
                np.full(n_frames, condition.told_noise_m),
                turned / np.linalg.norm(turned, axis=1, keepdims=True),
                np.full(n_frames, max(wrong_rad, LEAST_TURN_RAD)),
            )
        )
    return ClampedEnds(ends[0], ends[1], span_m[1] - span_m[0])


def measure_errors(curve: CurveEstimate, truth_per_m: Floats) -> ErrorFigures:
    """Hold the curvature of F frames against the true one (G,).

    Parameters
    ----------
    curve : CurveEstimate
        With values at G places; NaN counts as unknown and not as an error.
    truth_per_m : (G,)
        The same for all frames.
    """
    value, sigma = curve.curvature_per_m.astype(np.float64), curve.sigma_per_m.astype(np.float64)
    known = np.isfinite(value)
    drawn = known.any(axis=1)
    if not drawn.any():
        nothing, radius = np.nan, np.full((3, len(truth_per_m)), np.nan)
        return ErrorFigures(nothing, nothing, nothing, nothing, nothing, nothing, nothing, 1.0, radius)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.abs(truth_per_m / value[drawn] - 1.0)
        off_peak, peak_sigma = _find_peaks(value[drawn], sigma[drawn], truth_per_m)
        peak = off_peak / truth_per_m.max()
        radius = 1.0 / _quantiles(value, (0.95, 0.5, 0.05))
    bent = truth_per_m.max() > 0
    return ErrorFigures(
        max_radius_error=float(np.median(np.nanmax(error, axis=1))) if bent else np.nan,
        rms_radius_error=float(np.median(np.sqrt(np.nanmean(error**2, axis=1)))) if bent else np.nan,
        peak_bias=float(peak.mean()) if bent else np.nan,
        peak_sd=float(peak.std()) if bent else np.nan,
        peak_inside_band=float((np.abs(off_peak) <= 2 * peak_sigma).mean()),
        inside_band=float((np.abs(value - truth_per_m) <= 2 * sigma)[known].mean()),
        scatter=_scatter(value, sigma),
        unknown=float(1.0 - known.mean()),
        radius_quantiles_m=radius,
    )


def _find_peaks(value: Floats, sigma: Floats, truth_per_m: Floats) -> tuple[Floats, Floats]:
    """Return how far each frame's largest value is above the true one (F,), and its standard deviation (F,)."""
    place = np.where(np.isfinite(value), value, -np.inf).argmax(axis=1)
    rows = np.arange(len(value))
    return value[rows, place] - truth_per_m.max(), sigma[rows, place]


def _scatter(value: Floats, sigma: Floats) -> float:
    seen = np.isfinite(value).sum(axis=0) > 1
    if not seen.any():
        return np.nan
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.median(np.nanstd(value[:, seen], axis=0) / np.nanmedian(sigma[:, seen], axis=0)))


def _quantiles(value: Floats, shares: tuple[float, ...]) -> Floats:
    """Return quantiles (n, G) over the frames, without NaNs; NaN where nothing else is."""
    result = np.full((len(shares), value.shape[1]), np.nan)
    seen = np.isfinite(value).any(axis=0)
    if seen.any():
        result[:, seen] = np.nanquantile(value[:, seen], shares, axis=0)
    return result
