"""What a chain of markers costs, in nats: distances, turning angles and hidden markers, as tables for the search.

The posterior of a chain of seen markers is the product, over them, of the density of the next marker's place given the
two before it, against the density of points that are nobody's. The place is told by its distance and by the angle in
which the cable turns. How these are distributed is a mixture: of physics, as far as arc lengths and gates are known,
and of what was seen in frames that are sorted without doubt, smoothed.

Physics: a distance is not longer than the cable between, as far as that is known (the gates are two standard
deviations), and exponentially less likely the shorter it is (a circle of curvature kappa shortens a length S by
S³ kappa² / 24); the cable goes straight on but for an angle distributed by von Mises and Fisher.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from bench.analysis.arrays import Floats
from bench.analysis.kernels.chain_tables import BINS, MOST_END_COST, MOST_GAP
from bench.analysis.sorting.gates import SortSettings

__all__ = ["ChainCosts", "ChainPrior", "make_costs"]

CUT = 15.0
"""A distance that costs so much more than the best is not tried: a hidden marker costs about 8."""
MOST_SIGMAS = 5.0
"""Nor is one that is longer than the cable by so many standard deviations."""
MOST_SCALES = 12.0
LATERAL_M = 0.002
"""Markers lie beside the cable's axis by about this: they are stuck on."""
ANCHOR_OFFSET_M = 0.02
"""A rigid body's centre lies beside the cable's axis by about this; its own turn is soon learnt."""
LEAST_SCALE_M = 1e-4
LEAST_LENGTH_M = 1e-3
CLUTTER_PER_M3 = 200.0
"""Points that are nobody's: one or two within 5 cm of a metre of cable."""
MISS = 0.08
"""Probability that a marker is hidden. Three times more or less of either changes the exact frames by 0.4 % at most, on
made takes and on a real cable."""
PRIOR_FRAMES = 30
"""As many frames of doubt are mixed into what was seen: poses that the sample does not hold stay possible."""
SMOOTHING = 0.5
"""Of the standard deviation of what was seen: frames of one motion are alike, so few of them tell something new."""
FEWEST_SEEN = 20


@dataclass(frozen=True, eq=False)
class ChainPrior:
    """What is expected of a cable before a frame is looked at."""

    curvature_per_m: Floats
    """(k + 1,): standard deviation of the curvature at the anchor and at each marker, in each of two directions."""
    nodes_m: Floats
    """(F, k + 2, 3): anchor, markers and end in frames sorted without doubt, NaN where not known."""
    end_sigma_m: float = 0.0
    """Standard deviation of the end's place."""

    @classmethod
    def guess(cls, settings: SortSettings) -> ChainPrior:
        """Return what is expected before anything is seen: bends that turn a cable by two thirds of a circle."""
        k = settings.n_markers
        curvature = 4.0 / max(settings.arc_length_m[-1], LEAST_LENGTH_M)
        return cls(np.full(k + 1, curvature), np.full((0, k + 2, 3), np.nan))


@dataclass(frozen=True, eq=False)
class ChainCosts:
    """Tables that `search_chains` takes; nodes are 0 for the anchor, 1…k for the markers, k + 1 for the end."""

    spans: Floats
    """(k + 1, MOST_GAP + 1, 4): for the step of g nodes to node m: shortest and longest distance, bins per metre, and
    the least cost of the turn before it."""
    span_costs: Floats
    """(k + 1, MOST_GAP + 1, BINS + 1): cost of each distance between these."""
    turn_costs: Floats
    """(k + 1, MOST_GAP + 1, MOST_GAP + 1, BINS + 1): for the turn by an angle a at node m between steps of g1 (0: no
    turn) and g2, cost of each sin(a / 2) from 0 to 1."""
    ends: Floats
    """(k + 1, 3): shortest and longest distance from node m to the cable's end, and bins per metre."""
    end_costs: Floats
    """(k + 1, BINS + 1): cost of each distance between these."""
    hidden: Floats
    """(k + 1,): all nodes after m are hidden."""
    reach_m: Floats
    """(k + 1,): how far from the anchor node m can be."""


def make_costs(settings: SortSettings, prior: ChainPrior) -> ChainCosts:
    """Return the tables, with zero for the likeliest step to the next marker: hidden markers cost about 8."""
    k, place = settings.n_markers, np.concatenate([[0.0], settings.arc_length_m, [settings.length_m]])
    spans, span_costs = np.zeros((k + 1, MOST_GAP + 1, 4)), np.zeros((k + 1, MOST_GAP + 1, BINS + 1))
    turn_costs = np.full((k + 1, MOST_GAP + 1, MOST_GAP + 1, BINS + 1), np.log(4 * np.pi))
    for to in range(1, k + 1):
        for gap in range(1, min(MOST_GAP, to) + 1):
            known = _Distance(place, to - gap, to, settings, prior)
            low, high, span_costs[to, gap] = known.tabulate(known.cost_in_space)
            spans[to, gap, :3] = low, high, BINS / (high - low)
        for come in range(1, min(MOST_GAP, to) + 1):
            for left in range(1, min(MOST_GAP, k - to) + 1):
                turn_costs[to, come, left] = _tabulate_turn(place, to - come, to, to + left, prior)
    least_turn = turn_costs.min(axis=3)
    usual = span_costs[:, 1].min(axis=1) + np.concatenate([[0.0], least_turn[0, 0, 1:2], least_turn[1:-1, 1, 1]])
    # of each marker: hidden, against seen as usual among points that are nobody's
    unseen = np.log((1 - MISS) / MISS) - np.log(CLUTTER_PER_M3) - usual
    unseen[0] = 0.0
    for to in range(1, k + 1):
        for gap in range(1, min(MOST_GAP, to) + 1):
            span_costs[to, gap] += unseen[to - gap + 1 : to].sum() - usual[to]
            spans[to, gap, 3] = least_turn[to - gap, : min(to - gap, MOST_GAP) + 1, gap].min()
    reach = place[:-1] + MOST_SIGMAS / 2 * (settings.stretch * place[:-1] + settings.tolerance_m)
    ends, end_costs = _tabulate_ends(place, settings, prior)
    return ChainCosts(spans, span_costs, turn_costs, ends, end_costs, unseen.sum() - np.cumsum(unseen), reach)


class _Distance:
    """How the distance between two nodes is distributed."""

    def __init__(self, place: Floats, first: int, last: int, settings: SortSettings, prior: ChainPrior) -> None:
        self.length = max(place[last] - place[first], LEAST_LENGTH_M)
        curvature = float(np.sqrt(np.mean(np.square(prior.curvature_per_m[first : last + 1]))))
        variance = (settings.tolerance_m / 2) ** 2 + 2 * settings.noise_m**2 + (settings.stretch * self.length / 2) ** 2
        if last == len(place) - 1:
            variance += prior.end_sigma_m**2 + settings.tolerance_m**2
        self.sigma = float(np.sqrt(variance))
        self.scale = max(self.length * (curvature * self.length) ** 2 / 24, LEAST_SCALE_M)
        seen = np.linalg.norm(prior.nodes_m[:, last] - prior.nodes_m[:, first], axis=1)
        self.seen = seen[np.isfinite(seen)]

    def tabulate(self, cost: Callable[[Floats], Floats]) -> tuple[float, float, Floats]:
        """Return the shortest and the longest distance that is to be tried, and the costs between."""
        low, high = self.length - MOST_SCALES * (self.scale + self.sigma), self.length + MOST_SIGMAS * self.sigma
        if len(self.seen) >= FEWEST_SEEN:
            low, high = min(low, float(self.seen.min())), max(high, float(self.seen.max()))
        fine = np.linspace(max(low, 0.0), high, 4 * BINS + 1)
        costs = cost(fine)
        tried = fine[costs <= costs.min() + CUT]
        low, high = float(tried[0]), max(float(tried[-1]), float(tried[0]) + LEAST_LENGTH_M)
        return low, high, cost(np.linspace(low, high, BINS + 1))

    def cost_in_space(self, distance: Floats) -> Floats:
        """Return the cost of distances on an even grid, per volume but for the directions."""
        return np.asarray(2 * np.log(np.maximum(distance, LEAST_LENGTH_M)) - np.log(self._density(distance)))

    def cost(self, distance: Floats) -> Floats:
        """Return the cost of distances on an even grid, against the likeliest."""
        cost = -np.log(self._density(distance))
        return np.asarray(cost - cost.min())

    def _density(self, distance: Floats) -> Floats:
        short, knee = self.length - distance, self.sigma**2 / self.scale
        curved = np.minimum(short, knee)
        physics = np.exp(-0.5 * (curved / self.sigma) ** 2 - (short - curved) / self.scale)
        fine = np.linspace(-MOST_SIGMAS * self.sigma, MOST_SCALES * (self.scale + self.sigma), 400)
        bent = np.minimum(fine, knee)
        mass = np.exp(-0.5 * (bent / self.sigma) ** 2 - (fine - bent) / self.scale).sum() * (fine[1] - fine[0])
        step = distance[1] - distance[0]
        at = np.round((self.seen - distance[0]) / step)
        return _mix(physics / mass, at, np.full(len(distance), step), self.seen.std() / step if len(self.seen) else 0.0)


def _tabulate_turn(place: Floats, first: int, middle: int, last: int, prior: ChainPrior) -> Floats:
    before = max(place[middle] - place[first], LEAST_LENGTH_M)
    after = max(place[last] - place[middle], LEAST_LENGTH_M)
    offset = ANCHOR_OFFSET_M if first == 0 else 0.0
    variance = (prior.curvature_per_m[middle] * (before + after) / 2) ** 2
    variance += (LATERAL_M**2 + offset**2) / before**2 + LATERAL_M**2 / after**2
    half_sine = np.linspace(0, 1, BINS + 1)
    physics = np.exp(-2 * half_sine**2 / variance) / (2 * np.pi * variance * -np.expm1(-2 / variance))
    come, left = prior.nodes_m[:, middle] - prior.nodes_m[:, first], prior.nodes_m[:, last] - prior.nodes_m[:, middle]
    length = np.linalg.norm(come, axis=1) * np.linalg.norm(left, axis=1)
    cosine = (come * left).sum(axis=1) / np.maximum(length, np.finfo(float).tiny)
    seen = np.sqrt(np.clip((1 - cosine[np.isfinite(cosine)]) / 2, 0, 1))
    edges = np.clip((np.arange(BINS + 2) - 0.5) / BINS, 0, 1)
    spread = seen.std() * BINS if len(seen) else 0.0
    return -np.log(_mix(physics, np.round(seen * BINS), 4 * np.pi * np.diff(edges**2), spread))


def _mix(physics: Floats, at: Floats, measure: Floats, spread: float) -> Floats:
    """Return a density on an even grid: of physics, and of what was seen at grid points `at`, smoothed."""
    if len(at) < FEWEST_SEEN:
        return physics
    inside = at[(at >= 0) & (at < len(physics))].astype(np.int64)
    width = max(SMOOTHING * spread, 1.0)
    count = np.bincount(inside, minlength=len(physics)).astype(np.float64)
    seen = scipy.ndimage.gaussian_filter1d(count, width, mode="constant")
    seen /= scipy.ndimage.gaussian_filter1d(measure, width, mode="nearest")
    share = PRIOR_FRAMES / (PRIOR_FRAMES + len(at))
    return np.maximum(share * physics + (1 - share) * seen / len(at), np.finfo(float).tiny)


def _tabulate_ends(place: Floats, settings: SortSettings, prior: ChainPrior) -> tuple[Floats, Floats]:
    k = len(place) - 2
    ends, costs = np.tile([0.0, 0.0, 1.0], (k + 1, 1)), np.zeros((k + 1, BINS + 1))
    if np.isfinite(settings.length_m):
        for m in range(k + 1):
            known = _Distance(place, m, k + 1, settings, prior)
            low, high, cost = known.tabulate(known.cost)
            ends[m], costs[m] = (low, high, BINS / (high - low)), np.minimum(cost, MOST_END_COST)
    return ends, costs
