"""Where the markers really sit, measured from the take itself before it is sorted: static errors of placing vanish."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Indices, frame_of_points
from bench.analysis.chain_prior import DOUBT_NATS, is_alike_from_both_ends, learn_prior, search
from bench.analysis.gates import SortSettings
from bench.analysis.markers import PointFrames, gather_positions
from bench.analysis.spacing import MarkerPlaces, measure_marker_places
from bench.errors import AnalysisError

__all__ = ["SpacingCalibration", "calibrate_spacing", "spread_sample"]

SAMPLED_FRAMES = 1_000
"""Frames that are sorted to learn from: 0.05 s, and 300 of them have every marker where each is hidden in 10 %."""
TWO_SIGMA = 0.977
"""Of the chords, as a quantile: what a normal number exceeds by two standard deviations."""
NOISE_SPANS = 5.0
POOR_FIT = 0.25
"""A chain that finds fewer of the markers than this without doubt is another cable's."""
POOR_FIT_NOTE = (
    "In {} frames looked at, the chain of the configured spacings finds {:.0%} of the markers without doubt: check "
    "that marker_arc_length_m is this cable's, and that the tracker's unit is right."
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
    places: MarkerPlaces | None = None
    """None where nothing could be measured."""
    notes: list[str] = field(default_factory=list)
    """Sentences on what was not as configured."""


def calibrate_spacing(frames: PointFrames, settings: SortSettings) -> SpacingCalibration:
    """Measure the markers' places in a sample of the frames, sorted by the chain search with the configured ones.

    Only markers without doubt are measured. The tolerance and the stretch are narrowed from what was configured to what
    the chords show: half each of the variance by which they exceed the measured spacings. The far end's place is kept
    as configured.

    Parameters
    ----------
    frames : PointFrames
    settings : SortSettings
        As configured; the search must find its way with them.
    """
    if frames.anchor_m is None and frames.end_m is None and is_alike_from_both_ends(settings):
        return SpacingCalibration(settings)
    sample = spread_sample(frames)
    source, margin = search(sample, settings, learn_prior(sample, settings))
    sure = (source >= 0) & (margin >= DOUBT_NATS)
    fit, left = _count_fit(sample, source, sure)
    if fit < POOR_FIT:
        return SpacingCalibration(settings, notes=[POOR_FIT_NOTE.format(len(sample), fit)])
    notes = [MANY_LEFT_NOTE.format(left * settings.n_markers)] if left >= MANY_LEFT else []
    position = gather_positions(sample.points_m, sample.offsets, np.where(sure, source, -1).astype(np.int16))
    try:
        every = np.ones(len(sample), dtype=bool)
        places = measure_marker_places(position, every, sample.anchor_m, settings.arc_length_m[0])
    except AnalysisError:
        return SpacingCalibration(settings, notes=notes)
    excess_m = _find_excess(position, sample.anchor_m, places)
    return SpacingCalibration(_narrow(settings, places, excess_m), places, [*notes, *_compare(settings, places)])


def spread_sample(frames: PointFrames) -> PointFrames:
    """Return some frames spread over the whole recording, in order of time."""
    in_time = np.argsort(frames.time_ns, kind="stable")
    if len(in_time) > SAMPLED_FRAMES:
        in_time = in_time[np.linspace(0, len(in_time) - 1, SAMPLED_FRAMES).astype(np.int64)]
    return frames.take(in_time)


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


def _find_excess(position_m: Floats32, anchor_m: Floats | None, places: MarkerPlaces) -> float:
    """Return by how much chords exceed the measured spacing at two standard deviations, where they do so most."""
    nodes, place = position_m.astype(np.float64), places.arc_length_m
    if anchor_m is not None:
        nodes = np.concatenate([anchor_m[:, None], nodes], axis=1)
        place = np.concatenate([[0.0], place])
    chord = np.linalg.norm(np.diff(nodes, axis=1), axis=2)
    return max(float((np.nanquantile(chord, TWO_SIGMA, axis=0) - np.diff(place)).max()), 0.0)


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
