"""What a chain of markers costs, in nats: distances, turning angles and hidden markers, as tables for the search.

The posterior of a chain of seen markers is the product, over them, of the density of the next marker's place given the
two before it, against the density of points that are nobody's. The place is told by its distance, not longer than the
cable between as far as that is known (the gates are two standard deviations), exponentially less likely the shorter it
is (a circle of curvature kappa shortens a length S by S³ kappa² / 24), and by the angle in which the cable turns,
distributed about straight on by von Mises and Fisher.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Floats
from bench.analysis.gates import SortSettings

__all__ = ["MOST_GAP", "ChainCosts", "ChainPrior", "make_costs"]

MOST_GAP = 4
"""Largest step from one seen marker to the next: three hidden between them."""
CUT = 15.0
"""A distance so short that it costs more than this is not tried: a hidden marker costs about 8."""
MOST_SIGMAS = 4.0
"""A distance longer than the cable by more is not tried: it would cost as much as a hidden marker."""
LATERAL_M = 0.002
"""Markers lie beside the cable's axis by about this: they are stuck on."""
ANCHOR_OFFSET_M = 0.02
"""A rigid body's centre lies beside the cable's axis by about this; its own turn is soon learnt."""
MOST_END_COST = 8.0
"""However far the chain is from where the calibration puts the cable's end, it costs no more than a hidden marker."""
LEAST_SCALE_M = 1e-4
LEAST_LENGTH_M = 1e-3
CLUTTER_PER_M3 = 100.0
"""Points that are nobody's. Two in a tube of 5 cm about a metre of cable are 250, two in a room 0.1; ten times more or
less changes nothing that shows."""


@dataclass(frozen=True)
class ChainPrior:
    """What is expected of a cable before a frame is looked at."""

    curvature_per_m: tuple[float, ...]
    """(k + 1,): standard deviation of the curvature at the anchor and at each marker, in each of two directions."""
    miss: float
    """Probability that a marker is hidden."""

    @classmethod
    def guess(cls, settings: SortSettings) -> ChainPrior:
        """Return what is expected before anything is seen: bends that turn a cable by two thirds of a circle."""
        length = max(settings.arc_length_m[-1], LEAST_LENGTH_M)
        return cls((4.0 / length,) * (settings.n_markers + 1), 0.08)


@dataclass(frozen=True, eq=False)
class ChainCosts:
    """Tables that `search_chains` takes; nodes are 0 for the anchor, 1…k for the markers."""

    spans: Floats
    """(k + 1, MOST_GAP + 1, 8): for the step of g nodes to node m: length, 1 / (2 sigma²), 1 / scale, knee, low, high,
    cost, and the least cost of the turn before it."""
    turns: Floats
    """(k + 1, MOST_GAP + 1, MOST_GAP + 1, 2): for the turn at node m between steps of g1 (0: none) and g2:
    concentration, cost."""
    ends: Floats
    """(k + 1, 4): for the step from node m to the cable's end: length, sigma, scale, most cost."""
    hidden: Floats
    """(k + 1,): all nodes after m are hidden."""
    reach_m: Floats
    """(k + 1,): how far from the anchor node m can be."""


def make_costs(settings: SortSettings, prior: ChainPrior) -> ChainCosts:
    """Return the tables, with zero for a step to the next marker that is as expected: hidden markers cost about 8."""
    place = np.concatenate([[0.0], settings.arc_length_m])
    spans, turns = _make_spans(place, settings, prior), _make_turns(place, prior)
    isotropic, k = float(np.log(4 * np.pi)), settings.n_markers
    usual = spans[:, 1, 6] + np.concatenate([[0.0, isotropic], turns[1:-1, 1, 1, 1]])
    turns[0, 0, :, 1] = turns[1:, 0, :, 1] = isotropic
    # of each marker: hidden, against seen as usual among points that are nobody's
    unseen = np.log((1 - prior.miss) / prior.miss) - np.log(CLUTTER_PER_M3) - usual
    unseen[0] = 0.0
    for to in range(1, k + 1):
        for gap in range(1, min(MOST_GAP, to) + 1):
            spans[to, gap, 6] += unseen[to - gap + 1 : to].sum() - usual[to]
            spans[to, gap, 7] = turns[to - gap, : to - gap + 1, gap, 1][: MOST_GAP + 1].min()
    hidden = unseen.sum() - np.cumsum(unseen)
    reach = place + MOST_SIGMAS / 2 * (settings.stretch * place + settings.tolerance_m)
    return ChainCosts(spans, turns, _make_ends(place, settings, prior), hidden, reach)


def _make_spans(place: Floats, settings: SortSettings, prior: ChainPrior) -> Floats:
    spans = np.zeros((len(place), MOST_GAP + 1, 8))
    for to in range(1, len(place)):
        for gap in range(1, min(MOST_GAP, to) + 1):
            length = max(place[to] - place[to - gap], LEAST_LENGTH_M)
            sigma, scale, knee = _spread(length, _usual_curvature(prior, to - gap, to), settings)
            far = sigma * np.sqrt(2 * CUT)
            if far > knee:
                far = scale * (CUT + 0.5 * (sigma / scale) ** 2)
            high = length + MOST_SIGMAS * sigma
            cost = _log_mass(sigma, scale, knee) + 2 * np.log(length)
            spans[to, gap, :7] = length, 0.5 / sigma**2, 1 / scale, knee, max(length - far, 0.0), high, cost
    return spans


def _make_turns(place: Floats, prior: ChainPrior) -> Floats:
    turns, k = np.zeros((len(place), MOST_GAP + 1, MOST_GAP + 1, 2)), len(place) - 1
    for m in range(1, k):
        for come in range(1, min(MOST_GAP, m) + 1):
            for left in range(1, min(MOST_GAP, k - m) + 1):
                before = max(place[m] - place[m - come], LEAST_LENGTH_M)
                after = max(place[m + left] - place[m], LEAST_LENGTH_M)
                offset = ANCHOR_OFFSET_M if m == come else 0.0
                variance = (_usual_curvature(prior, m, m) * (before + after) / 2) ** 2
                variance += (LATERAL_M**2 + offset**2) / before**2 + LATERAL_M**2 / after**2
                turns[m, come, left] = 1 / variance, np.log(2 * np.pi * variance * -np.expm1(-2 / variance))
    return turns


def _make_ends(place: Floats, settings: SortSettings, prior: ChainPrior) -> Floats:
    ends, k = np.zeros((len(place), 4)), len(place) - 1
    for m in range(len(place)):
        length = max(settings.length_m - place[m], LEAST_LENGTH_M)
        sigma, scale, _ = _spread(length, _usual_curvature(prior, m, k), settings)
        ends[m] = length, np.hypot(sigma, settings.tolerance_m), scale, MOST_END_COST
    return ends


def _usual_curvature(prior: ChainPrior, first: int, last: int) -> float:
    return float(np.sqrt(np.mean(np.square(prior.curvature_per_m[first : last + 1]))))


def _spread(length: float, curvature: float, settings: SortSettings) -> tuple[float, float, float]:
    """Return how a distance scatters: normal with sigma, and exponential with a scale when shorter than by a knee."""
    variance = (settings.tolerance_m / 2) ** 2 + 2 * settings.noise_m**2 + (settings.stretch * length / 2) ** 2
    scale = max(length * (curvature * length) ** 2 / 24, LEAST_SCALE_M)
    return float(np.sqrt(variance)), scale, variance / scale


def _log_mass(sigma: float, scale: float, knee: float) -> float:
    """Return the logarithm of the integral of that density without its factor."""
    core = sigma * np.sqrt(np.pi / 2) * (1 + math.erf(knee / sigma / np.sqrt(2)))
    return float(np.log(core + scale * np.exp(-0.5 * (sigma / scale) ** 2)))
