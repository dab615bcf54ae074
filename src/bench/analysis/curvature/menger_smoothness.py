"""How a cable's bending changes along it, learnt from the frames of a recording together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Floats
from bench.analysis.curvature.menger_chain import Chain
from bench.analysis.curvature.menger_prior import Layout, make_prior

__all__ = ["Sighting", "Smoothness", "Widening", "learn_smoothness", "measure_widening"]

N_LENGTHS, N_AMPLITUDES = 18, 28
"""Steps of a quarter to a third: finer than frames of one cable tell them apart."""
DEGREES_OF_FREEDOM = 10.0
"""Degrees of freedom of the frames' distribution: wrongly sorted frames with enormous bends lose their say."""
USUAL_LENGTH, LENGTH_SPREAD = 0.25, 1.0
"""Before any data: a quarter of the chain, within a factor of e."""
USUAL_AMPLITUDE, AMPLITUDE_SPREAD = 0.5, 1.5
"""Before any data: half of the usual bend, within a factor of 4.5."""

FRAMES_OF_ONE = 10.0
"""The band is believed until more frames than that say otherwise."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """Frames of which the same is known."""

    chain: Chain
    bend_per_m: Floats
    """(C, b, 3): all finite."""


@dataclass(frozen=True)
class Smoothness:
    """The two numbers of the curvature's process."""

    amplitude_per_m: float
    """Standard deviation about the cable's mean curvature."""
    length_m: float
    """Over which curvature at two places is alike."""
    is_even: bool = False
    """Whether the least amplitude was enough: the cable's curvature is the same all along it, and the length idle."""


@dataclass(frozen=True, eq=False)
class Widening:
    """How much wider than the process's the band must be: it is the same process all along, the cable is not."""

    at_m: Floats
    """(b,): arc lengths, ascending."""
    factor: Floats
    """(b,): 1 or more."""


def learn_smoothness(sightings: Sequence[Sighting], layout: Layout) -> Smoothness:
    """Return the most probable smoothness of all these frames together.

    By restricted likelihood: of the bends of each frame, in the direction in which it is bent most, only their
    differences count, for the process is about an unknown constant. Frames are from a Student distribution.
    """
    span = float(np.ptp(layout.node_s_m))
    lengths = span * np.geomspace(0.5 / len(layout.node_s_m), 5.0, N_LENGTHS)
    in_plane = [_find_main_bends(sighting.bend_per_m) for sighting in sightings]
    scale = _find_scale(sightings, in_plane)
    amplitudes = scale * np.geomspace(0.1, 10.0, N_AMPLITUDES)
    cost = (np.log(lengths / (USUAL_LENGTH * span)) / LENGTH_SPREAD)[:, None] ** 2
    cost = cost + (np.log(amplitudes / (USUAL_AMPLITUDE * scale)) / AMPLITUDE_SPREAD) ** 2
    for sighting, bend in zip(sightings, in_plane, strict=True):
        contrasts = np.diff(np.eye(bend.shape[1]), axis=0)
        root = np.linalg.cholesky(contrasts @ sighting.chain.noise @ contrasts.T)
        whiten = np.linalg.solve(root, contrasts)
        seen, taken = bend @ whiten.T, whiten @ sighting.chain.difference
        for i, length_m in enumerate(lengths):
            covariance = make_prior(layout, layout.node_s_m[:0], 1.0, float(length_m)).node_covariance
            cost[i] += _cost(seen, taken @ covariance @ taken.T, amplitudes)
    best = np.unravel_index(int(cost.argmin()), cost.shape)
    return Smoothness(float(amplitudes[best[1]]), float(lengths[best[0]]), is_even=bool(best[1] == 0))


def measure_widening(sighting: Sighting, layout: Layout, smoothness: Smoothness) -> Widening:
    """Return by how much each bend differs from what all the others make of it, in standard deviations of that.

    Beside a clamp a cable bends more quickly than elsewhere; where markers show a trace of that, the bends there are
    predicted worst by the others. Leaving a bend out is a closed form (Rasmussen and Williams, 5.4.2). Frames have the
    weights of the Student distribution from which smoothness was learnt.
    """
    chain, bend = sighting.chain, _find_main_bends(sighting.bend_per_m)
    prior = make_prior(layout, layout.node_s_m[:0], smoothness.amplitude_per_m, smoothness.length_m)
    inverse = np.linalg.inv(chain.difference @ prior.node_covariance @ chain.difference.T + chain.noise)
    sums = inverse.sum(axis=1)
    precision = inverse - np.outer(sums, sums) / sums.sum()
    left_out = bend @ precision
    weight = (DEGREES_OF_FREEDOM + len(sums) - 1) / (DEGREES_OF_FREEDOM + np.einsum("cb,cb->c", left_out, bend))
    with np.errstate(invalid="ignore", divide="ignore"):
        square = weight @ (left_out**2 / np.diag(precision))
    share = (FRAMES_OF_ONE + square) / (FRAMES_OF_ONE + len(bend))
    return Widening(chain.bend_s_m, np.sqrt(np.fmax(share, 1.0)))


def _cost(seen: Floats, covariance: Floats, amplitudes: Floats) -> Floats:
    """Return -2 log likelihood of whitened contrasts (C, m) for each of the amplitudes (A,)."""
    strength, axes = np.linalg.eigh(covariance)
    spread = 1.0 + np.maximum(strength, 0.0)[:, None] * amplitudes**2
    square = (seen @ axes) ** 2 @ (1.0 / spread)
    falls = (DEGREES_OF_FREEDOM + len(strength)) * np.log1p(square / DEGREES_OF_FREEDOM)
    return np.asarray(len(seen) * np.log(spread).sum(axis=0) + falls.sum(axis=0))


def _find_main_bends(bend_per_m: Floats) -> Floats:
    """Return the bends (C, b) of each frame in the direction in which it is bent most."""
    _, axes = np.linalg.eigh(np.swapaxes(bend_per_m, 1, 2) @ bend_per_m)
    return np.asarray(np.einsum("cbi,ci->cb", bend_per_m, axes[:, :, -1]))


def _find_scale(sightings: Sequence[Sighting], in_plane: Sequence[Floats]) -> float:
    """Return the usual bend, and no less than what noise makes of a straight cable."""
    bend = np.concatenate([np.sqrt(np.mean(x**2, axis=1)) for x in in_plane])
    noise = np.mean([np.diag(sighting.chain.noise).mean() for sighting in sightings])
    return float(np.hypot(np.median(bend), np.sqrt(noise)))
