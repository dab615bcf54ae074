"""Each frame by itself, at its best: the most probable chain of points, with hidden markers and ghosts among them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from bench.analysis.arrays import Floats, Floats32, Indices
from bench.analysis.chain_costs import ChainPrior, make_costs
from bench.analysis.free_chain import orient_alike
from bench.analysis.gates import SortSettings
from bench.analysis.markers import MarkerReason, PointFrames, SortedMarkers, gather_positions
from bench.errors import TooFewMarkersError

__all__ = ["sort_by_chain"]

DOUBT_NATS = 3.0
"""A marker whose next best explanation is less than 20 times as improbable is ambiguous."""
SAMPLED_FRAMES = 1_000
"""Frames from which the cable's usual bends are learnt: 0.05 s."""
FEWEST_BENDS = 20
"""Fewer tell less than the guess."""
SPREAD = 1.6
"""The bends of one marker are no normal number: the cable rests in one pose and passes through another."""
LEAST_CURVATURE = 0.25
"""Of the guess: where the cable hung straight in the sample, it may bend in another frame."""
MOST_MISSES = 0.3
FEWEST_FREE_MARKERS = 3
"""Two markers without an anchor are two points at a distance."""


def sort_by_chain(frames: PointFrames, settings: SortSettings) -> SortedMarkers:
    """Sort by the most probable chain of points, each frame by itself.

    Every chain of points within the cable's reach is weighed by its distances, its turning angles, its hidden markers
    (up to three in a row) and, where it is known, the cable's other end; the search over pairs of points finds the best
    of them (maximum a posteriori, a second-order Viterbi search) and for each marker the best chain in which that one
    marker has another point or none. The difference tells how sure the marker is.

    Which bends are usual at each marker is learnt from a sample of the frames. A frame whose anchor is unknown starts
    at any point, unless the cable looks the same from both ends and its other end is unknown too. A cable of this kind
    without any anchor is sorted as `sort_by_paper` does: all frames get the direction of the first.

    Raises
    ------
    TooFewMarkersError
        Without an anchor two markers make no chain.
    """
    if frames.anchor_m is None and settings.n_markers < FEWEST_FREE_MARKERS:
        raise TooFewMarkersError(
            f"The cable has {settings.n_markers} markers: without an anchor, at least {FEWEST_FREE_MARKERS} are needed "
            "to tell their order.",
            hint="Give the cable an anchor ([cable.anchor]) or more markers.",
        )
    sample = np.unique(np.linspace(0, max(len(frames) - 1, 0), SAMPLED_FRAMES).astype(np.int64))[: len(frames)]
    prior = learn_prior(frames.take(sample), settings)
    if frames.anchor_m is None and frames.end_m is None and _is_alike_from_both_ends(settings):
        source, margin = _sort_with_one_direction(frames, settings, prior)
    else:
        source, margin = search(frames, settings, prior)
    return SortedMarkers.from_source(
        frames, source, _confidence(source, margin), _reasons(frames, source, margin), "chain"
    )


def search(
    frames: PointFrames, settings: SortSettings, prior: ChainPrior, *, starts_anywhere: bool = False
) -> tuple[Indices, Floats32]:
    """Return the most probable chain of each frame (F, k), and by how many nats each marker is sure (F, k)."""
    from bench.analysis.kernels.chain_search import search_chains

    costs, n_frames = make_costs(settings, prior), len(frames)
    source = np.full((n_frames, settings.n_markers), -1, dtype=np.int16)
    margin = np.zeros(source.shape, dtype=np.float32)
    anchor, end = _places(frames.anchor_m, n_frames), _places(frames.end_m, n_frames)
    if not np.isfinite(settings.length_m):
        end = np.full((n_frames, 3), np.nan)
    sigma = np.zeros(n_frames) if frames.end_sigma_m is None else frames.end_sigma_m
    tells_ends = starts_anywhere or not _is_alike_from_both_ends(settings)
    is_free = (np.isfinite(end[:, 0]) | tells_ends) & (settings.n_markers >= FEWEST_FREE_MARKERS)
    search_chains(
        frames.points_m,
        frames.offsets,
        frames.usable,
        anchor,
        is_free,
        end,
        np.nan_to_num(np.asarray(sigma, dtype=np.float64)),
        costs.spans,
        costs.turns,
        costs.ends,
        costs.hidden,
        costs.reach_m,
        source,
        margin,
    )
    return source, margin


def learn_prior(frames: PointFrames, settings: SortSettings) -> ChainPrior:
    """Return the bends and the share of hidden markers that some frames show when sorted by the guess."""
    guess = ChainPrior.guess(settings)
    source, margin = search(frames, settings, guess)
    position = np.array(gather_positions(frames.points_m, frames.offsets, source), dtype=np.float64)
    position[margin < DOUBT_NATS] = np.nan
    curvature = _usual_curvature(position, frames.anchor_m, settings)
    started = (source >= 0).any(axis=1)
    if not started.any():
        return guess
    guessed = guess.curvature_per_m[0]
    usual = np.where(np.isfinite(curvature), np.maximum(SPREAD * curvature, LEAST_CURVATURE * guessed), guessed)
    return ChainPrior(tuple(usual.tolist()), float(np.clip((source[started] < 0).mean(), guess.miss, MOST_MISSES)))


def _usual_curvature(position_m: Floats, anchor_m: Floats | None, settings: SortSettings) -> Floats:
    """Return the curvature (k + 1,) of one direction, root mean square, NaN where too few frames show it."""
    start = _places(anchor_m, len(position_m))
    nodes = np.concatenate([start[:, None], position_m], axis=1)
    step = np.diff(nodes, axis=1)
    way = step / np.maximum(np.linalg.norm(step, axis=2, keepdims=True), 1e-9)
    turn = 1.0 - (way[:, 1:] * way[:, :-1]).sum(axis=2)
    seen = np.isfinite(turn)
    enough = seen.sum(axis=0) >= FEWEST_BENDS
    mean = np.where(seen, turn, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    span = np.diff(settings.arc_length_m, prepend=0.0)
    curvature = np.sqrt(mean) / np.maximum((span[1:] + span[:-1]) / 2, 1e-3)
    return np.concatenate([[np.nan], np.where(enough, curvature, np.nan), [np.nan]])


def _sort_with_one_direction(
    frames: PointFrames, settings: SortSettings, prior: ChainPrior
) -> tuple[Indices, Floats32]:
    """Search chains from any point, then again from the points that are marker 0 once all have one direction."""
    source, _ = search(frames, settings, prior, starts_anywhere=True)
    position = gather_positions(frames.points_m, frames.offsets, source)
    first = orient_alike(source, position)[:, 0]
    started = np.flatnonzero(first >= 0)
    usable = frames.usable.copy()
    usable[frames.offsets[started] + first[started]] = False
    anchor = gather_positions(frames.points_m, frames.offsets, first[:, None])[:, 0].astype(np.float64)
    place = np.array(settings.arc_length_m[1:]) - settings.arc_length_m[0]
    beyond = replace(settings, arc_length_m=tuple(place.tolist()))
    onwards = replace(prior, curvature_per_m=prior.curvature_per_m[1:])
    later, margin = search(replace(frames, usable=usable, anchor_m=anchor), beyond, onwards)
    return np.concatenate([first[:, None], later], axis=1), np.concatenate([margin[:, :1], margin], axis=1)


def _is_alike_from_both_ends(settings: SortSettings) -> bool:
    """Return whether the spacings are the same from both ends, as far as they are known."""
    spacing = np.diff(settings.arc_length_m)
    return bool((np.abs(spacing - spacing[::-1]) <= max(settings.tolerance_m, 4 * settings.noise_m)).all())


def _places(place_m: Floats | None, n_frames: int) -> Floats:
    if place_m is None:
        return np.full((n_frames, 3), np.nan)
    return np.ascontiguousarray(place_m, dtype=np.float64)


def _confidence(source: Indices, margin: Floats32) -> Floats32:
    return np.where(source >= 0, 1.0 / (1.0 + np.exp(-margin)), 0.0).astype(np.float32)


def _reasons(frames: PointFrames, source: Indices, margin: Floats32) -> npt.NDArray[np.uint8]:
    reason = np.where(source >= 0, MarkerReason.FOUND, MarkerReason.HIDDEN)
    reason[margin < DOUBT_NATS] = MarkerReason.AMBIGUOUS
    unstarted = (source < 0).all(axis=1) & ~np.isfinite(_places(frames.anchor_m, len(frames))).all(axis=1)
    reason[unstarted] = MarkerReason.NO_START
    return reason.astype(np.uint8)
