"""Where the markers really sit, measured from the take itself before it is sorted: static errors of placing vanish."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from bench.analysis.arrays import Bools, Indices, frame_of_points
from bench.analysis.sorting.anchors import spread_frames
from bench.analysis.sorting.chain_costs import ChainPrior
from bench.analysis.sorting.chain_prior import DOUBT_NATS, is_alike_from_both_ends, learn_prior, search
from bench.analysis.sorting.gates import SortSettings
from bench.analysis.sorting.markers import PointFrames
from bench.analysis.sorting.spacing import MarkerPlaces, measure_marker_places
from bench.errors import AnalysisError

__all__ = ["SpacingCalibration", "calibrate_spacing", "spread_sample"]

SAMPLED_FRAMES = 1_000
"""Frames that are sorted to learn from: 0.05 s, and 300 of them have every marker where each is hidden in 10 %."""
TWO_SIGMA = 0.977
"""Of the chords, as a quantile: what a normal number exceeds by two standard deviations."""
NOISE_SPANS = 5.0
FEWEST_MARKERS = 3
"""Fewer have no bend between them."""
GOOD_FIT = 0.8
"""A chain that explains less of what is seen, without doubt, may have its markers further off than the tolerance."""
WIDER = 4.0
WIDEST_SHARE = 0.15
"""Of the spacing, for the second try."""
POOR_FIT = 0.5
"""A chain that explains less of what is seen, without doubt, is another cable's."""
POOR_FIT_NOTE = (
    "In {} frames looked at, the chain of the configured spacings finds {:.0%} of the markers without doubt: check "
    "that marker_arc_length_m is this cable's, and that the tracker's unit is right."
)
TURNED_NOTE = (
    "Counted from the cable's other end the same spacings find {:.0%}: marker_arc_length_m must count from the anchor."
)
MANY_LEFT = 0.5
"""Points that no marker takes, of the number of markers: two cables in view leave 1."""
MANY_LEFT_NOTE = (
    "On average {:.1f} points of each frame are left over: there is a second cable or much else that shines in view, "
    "or the configuration leaves out markers."
)


@dataclass(frozen=True, eq=False)
class SpacingCalibration:
    """What the sorters know of the cable once the take has been looked at."""

    settings: SortSettings
    """With the measured places and how far chords go beyond them; as configured where nothing could be measured."""
    prior: ChainPrior
    """What the chain search expects of the cable."""
    places: MarkerPlaces | None = None
    """None where nothing could be measured."""
    warnings: list[str] = field(default_factory=list)
    """Sentences on what was not as configured."""


def calibrate_spacing(frames: PointFrames, settings: SortSettings) -> SpacingCalibration:
    """Measure the markers' places in a sample of the frames, sorted by the chain search with the configured ones.

    Only markers without doubt are measured. The tolerance and the stretch are narrowed from what was configured to what
    the chords show: half each of the variance by which they exceed the measured spacings. The far end's place is kept
    as configured. Where the sample does not fit, it is tried again with four times the tolerance.

    Parameters
    ----------
    frames : PointFrames
    settings : SortSettings
        As configured; the search must find its way with them.
    """
    tells_ends = frames.anchor_m is not None or frames.end_m is not None or not is_alike_from_both_ends(settings)
    if settings.n_markers < FEWEST_MARKERS or not tells_ends:
        return SpacingCalibration(settings, ChainPrior.guess(settings))
    sample = spread_sample(frames)
    tried = _try(sample, settings)
    if tried.places is None or tried.fit < GOOD_FIT:
        wide = _try(sample, _widen(settings))
        tried = wide if wide.places is not None and wide.fit > tried.fit else tried
    warnings = []
    if tried.fit < GOOD_FIT:
        warnings = [POOR_FIT_NOTE.format(len(sample), tried.fit), *_try_from_other_end(sample, settings)]
    if tried.fit < POOR_FIT:
        return SpacingCalibration(settings, tried.prior, warnings=warnings)
    if tried.left >= MANY_LEFT:
        warnings.append(MANY_LEFT_NOTE.format(tried.left * settings.n_markers))
    if tried.places is None:
        return SpacingCalibration(settings, tried.prior, warnings=warnings)
    excess_m = _find_excess(tried.prior, tried.places, is_anchored=frames.anchor_m is not None)
    narrowed = _narrow(settings, tried.places, excess_m)
    return SpacingCalibration(narrowed, tried.prior, tried.places, [*warnings, *_compare(settings, tried.places)])


@dataclass(frozen=True, eq=False)
class _Trial:
    """A sample sorted by some settings."""

    prior: ChainPrior
    places: MarkerPlaces | None
    fit: float
    left: float


def _try(sample: PointFrames, settings: SortSettings) -> _Trial:
    prior = learn_prior(sample, settings, *search(sample, settings, ChainPrior.guess(settings)))
    source, margin = search(sample, settings, prior)
    fit, left = _count_fit(sample, source, (source >= 0) & (margin >= DOUBT_NATS))
    prior = learn_prior(sample, settings, source, margin)
    every, marker_m = np.ones(len(sample), dtype=bool), prior.nodes_m[:, 1:-1].astype(np.float32)
    try:
        places = measure_marker_places(marker_m, every, sample.anchor_m, settings.arc_length_m[0])
    except AnalysisError:
        places = None
    return _Trial(prior, places, fit, left)


def _try_from_other_end(sample: PointFrames, settings: SortSettings) -> list[str]:
    """Return what is to be said if the spacings fit once they are counted from the cable's other end."""
    if not settings.length_m > settings.arc_length_m[-1]:
        return []
    turned = tuple(settings.length_m - place for place in reversed(settings.arc_length_m))
    fit = _try(sample, replace(settings, arc_length_m=turned)).fit
    return [TURNED_NOTE.format(fit)] if fit >= GOOD_FIT else []


def _widen(settings: SortSettings) -> SortSettings:
    """Return the settings for a cable whose markers sit further from their places than its maker thinks."""
    spacing = float(np.median(np.diff(settings.arc_length_m)))
    wide_m = min(WIDER * settings.tolerance_m, WIDEST_SHARE * spacing)
    return replace(settings, tolerance_m=max(wide_m, settings.tolerance_m))


def spread_sample(frames: PointFrames) -> PointFrames:
    """Return some frames spread over the whole recording, in order of time."""
    in_time = np.argsort(frames.time_ns, kind="stable")
    return frames.take(in_time[spread_frames(0, len(in_time), SAMPLED_FRAMES)])


def _count_fit(sample: PointFrames, source: Indices, sure: Bools) -> tuple[float, float]:
    """Return the part of the markers that could be seen and was found without doubt, and the points left over, of k."""
    n_seen = np.bincount(frame_of_points(sample.offsets)[sample.usable], minlength=len(sample))
    looked = n_seen > 0
    if sample.anchor_m is not None:
        looked &= np.isfinite(sample.anchor_m).all(axis=1)
    if not looked.any():
        return 1.0, 0.0
    k = source.shape[1]
    left = (n_seen - (source >= 0).sum(axis=1))[looked].mean() / k
    return float(sure[looked].sum() / np.minimum(n_seen, k)[looked].sum()), float(left)


def _narrow(settings: SortSettings, places: MarkerPlaces, excess_m: float) -> SortSettings:
    """Return the settings with the measured places, and with gates of which each has half of the excess's variance."""
    half = excess_m / np.sqrt(2)
    spacing = float(np.median(np.diff(places.arc_length_m)))
    return replace(
        settings,
        arc_length_m=tuple(places.arc_length_m.tolist()),
        tolerance_m=min(max(half, NOISE_SPANS * np.sqrt(2) * settings.noise_m), settings.tolerance_m),
        stretch=min(half / spacing, settings.stretch),
    )


def _find_excess(prior: ChainPrior, places: MarkerPlaces, *, is_anchored: bool) -> float:
    """Return by how much chords exceed the measured spacing at two standard deviations, where they do so most."""
    first = 0 if is_anchored else 1
    chord = np.linalg.norm(np.diff(prior.nodes_m[:, first:-1], axis=1), axis=2)
    spacing = np.diff(places.arc_length_m, prepend=[0.0] if is_anchored else [])
    return max(float((np.nanquantile(chord, TWO_SIGMA, axis=0) - spacing).max()), 0.0)


def _compare(settings: SortSettings, places: MarkerPlaces) -> list[str]:
    """Return a sentence where markers sit further from their configured places than the gates allow for."""
    off = np.abs(places.arc_length_m - np.array(settings.arc_length_m))
    far = np.flatnonzero(off > settings.tolerance_m + 3 * places.sigma_m)
    if not len(far):
        return []
    worst = int(off.argmax())
    note = (
        f"{len(far)} of {len(off)} markers sit further from their configured places than the tolerance of "
        f"{settings.tolerance_m * 1e3:.1f} mm: marker {worst} at {places.arc_length_m[worst]:.4f} m, not at "
        f"{settings.arc_length_m[worst]:.4f} m. The measured places are used for sorting."
    )
    return [note]
