"""The search for the most probable chain of each frame, and what it expects of a cable, learnt from some frames."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Floats, Floats32, Indices
from bench.analysis.sorting.chain_costs import ChainPrior, make_costs
from bench.analysis.sorting.gates import SortSettings
from bench.analysis.sorting.markers import PointFrames, gather_positions

__all__ = ["DOUBT_NATS", "FEWEST_FREE_MARKERS", "is_alike_from_both_ends", "known_places", "learn_prior", "search"]

DOUBT_NATS = 3.0
"""A marker whose next best explanation is less than 20 times as improbable is ambiguous."""
FEWEST_BENDS = 20
"""Fewer tell less than the guess."""
SPREAD = 1.6
"""The bends of one marker are no normal number: the cable rests in one pose and passes through another."""
LEAST_CURVATURE = 0.25
"""Of the guess: where the cable hung straight in the sample, it may bend in another frame."""
FEWEST_FREE_MARKERS = 3
"""Two markers without an anchor are two points at a distance."""


def search(
    frames: PointFrames, settings: SortSettings, prior: ChainPrior, *, starts_anywhere: bool = False
) -> tuple[Indices, Floats32]:
    """Return the most probable chain of each frame (F, k), and by how many nats each marker is sure (F, k)."""
    from bench.analysis.kernels.chain_search import search_chains

    costs, n_frames = make_costs(settings, prior), len(frames)
    source = np.full((n_frames, settings.n_markers), -1, dtype=np.int16)
    margin = np.zeros(source.shape, dtype=np.float32)
    anchor, end = known_places(frames.anchor_m, n_frames), known_places(frames.end_m, n_frames)
    if not np.isfinite(settings.length_m):
        end = np.full((n_frames, 3), np.nan)
    tells_ends = starts_anywhere or not is_alike_from_both_ends(settings)
    is_free = (np.isfinite(end[:, 0]) | tells_ends) & (settings.n_markers >= FEWEST_FREE_MARKERS)
    search_chains(
        frames.points_m,
        frames.offsets,
        frames.usable,
        anchor,
        is_free,
        end,
        costs.spans,
        costs.span_costs,
        costs.turn_costs,
        costs.ends,
        costs.end_costs,
        costs.hidden,
        costs.reach_m,
        source,
        margin,
    )
    return source, margin


def learn_prior(frames: PointFrames, settings: SortSettings, source: Indices, margin: Floats32) -> ChainPrior:
    """Return what the frames show of the cable where their markers (F, k) are found without doubt."""
    position = np.array(gather_positions(frames.points_m, frames.offsets, source), dtype=np.float64)
    position[margin < DOUBT_NATS] = np.nan
    start, end = known_places(frames.anchor_m, len(frames)), known_places(frames.end_m, len(frames))
    nodes = np.concatenate([start[:, None], position, end[:, None]], axis=1)
    sigma = np.zeros(1) if frames.end_sigma_m is None else frames.end_sigma_m[np.isfinite(frames.end_sigma_m)]
    return ChainPrior(_usual_curvature(nodes, settings), nodes, float(np.median(sigma)) if len(sigma) else 0.0)


def _usual_curvature(nodes: Floats, settings: SortSettings) -> Floats:
    """Return the curvature (k + 1,) of one direction, root mean square; the guess where too few frames show it."""
    step = np.diff(nodes[:, :-1], axis=1)
    way = step / np.maximum(np.linalg.norm(step, axis=2, keepdims=True), 1e-9)
    turn = 1.0 - (way[:, 1:] * way[:, :-1]).sum(axis=2)
    seen = np.isfinite(turn)
    mean = np.where(seen, turn, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    span = np.diff(settings.arc_length_m, prepend=0.0)
    curvature = np.sqrt(mean) / np.maximum((span[1:] + span[:-1]) / 2, 1e-3)
    usual = ChainPrior.guess(settings).curvature_per_m
    learnt = np.maximum(SPREAD * curvature, LEAST_CURVATURE * usual[0])
    usual[1:-1] = np.where(seen.sum(axis=0) >= FEWEST_BENDS, learnt, usual[0])
    return usual


def is_alike_from_both_ends(settings: SortSettings) -> bool:
    """Return whether the spacings are the same from both ends, as far as they are known."""
    spacing = np.diff(settings.arc_length_m)
    return bool((np.abs(spacing - spacing[::-1]) <= max(settings.tolerance_m, 4 * settings.noise_m)).all())


def known_places(place_m: Floats | None, n_frames: int) -> Floats:
    if place_m is None:
        return np.full((n_frames, 3), np.nan)
    return np.ascontiguousarray(place_m, dtype=np.float64)
