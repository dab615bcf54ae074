"""Takes that are made rather than recorded, with the truth: what a tracker lists of a cable that moves.

Pure arithmetic on arrays, without a robot, a tracker or a socket: hundreds of thousands of frames in seconds, for
tests and benchmarks of what sorts and measures. Noise, hidden markers, ghost markers and shuffled points come on top
of the motions of `bench.simulation.made_motions`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from bench.simulation.made_motions import ANCHOR_M, Motion

__all__ = ["HARD", "USUAL", "Conditions", "MadeTake", "make_take"]

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64]

START_NS = 1_760_000_000_000_000_000
KNOTS_PER_CYCLE = 2
"""A cycle differs from the next one smoothly: its differences are drawn twice a cycle and joined by a spline."""
GHOST_LIFE_FRAMES = 4.0
"""Half of the ghosts live 4 frames in three real recordings."""
NEAR_M = 0.02
FAR_M = 0.4


@dataclass(frozen=True)
class Conditions:
    """What stands between a cable and its tracker's list of points."""

    noise_m: float = 5e-4
    """Standard deviation of each coordinate."""
    miss_share: float = 0.0
    """Share of the markers that are hidden."""
    burst_frames: float = 8.0
    """Mean number of frames for which one stays hidden."""
    n_ghosts: int = 0
    """Ghosts in each frame: the first is a reflection that never moves, the others come and go."""
    near_share: float = 0.5
    """Share of those that come and go that is born within 20 mm of the cable; the others anywhere about it."""
    riding_share: float = 0.25
    """Share of the near ones that moves along with the cable, as reflections on it do."""
    jitter_m: float = 0.003
    """By how much a cycle differs from the planned motion: root mean square distance of the markers."""
    drift_m: float = 0.0
    """The same for what grows evenly from the first cycle to the last."""
    end_error_m: float = 0.002
    """Standard deviation of the known end's constant error, in each coordinate: a calibration's."""


USUAL = Conditions(miss_share=0.05, n_ghosts=2)
"""5 % of the markers hidden and two ghosts."""
HARD = Conditions(miss_share=0.10, n_ghosts=4, near_share=0.8)
"""10 % hidden and four ghosts, most of them beside the cable."""


@dataclass(frozen=True, eq=False)
class MadeTake:
    """F frames of a cable with k markers, and the truth about them."""

    points_m: npt.NDArray[np.float32]
    """(N, 3): all points of all frames in shuffled order, lab frame."""
    offsets: Ints
    """(F + 1,): points of frame f are ``points_m[offsets[f]:offsets[f + 1]]``."""
    time_ns: Ints
    """(F,)"""
    cycle: Ints
    """(F,): 0 throughout where the motion does not repeat."""
    phase: Floats
    """(F,): place in the cycle, 0…1; share of the take's time where the motion does not repeat."""
    anchor_m: Floats
    """(F, 3): where the cable starts."""
    end_m: Floats
    """(F, 3): where its other end is, with the constant error of a calibration."""
    end_sigma_m: Floats
    """(F,): standard deviation of that error in each coordinate."""
    source: npt.NDArray[np.int16]
    """(F, k): the truth: index of each marker's point in its frame's list, -1 where it is hidden."""
    marker_m: Floats
    """(F, k, 3): the truth: positions without noise, hidden ones as well."""
    arc_length_m: tuple[float, ...]
    """(k,)"""
    length_m: float

    def score(self, source: npt.NDArray[np.int16]) -> tuple[float, float]:
        """Return the share of frames (F, k) that are right in every marker, and that with a wrong point."""
        exact = (source == self.source).all(axis=1)
        wrong = ((source >= 0) & (source != self.source)).any(axis=1)
        return float(exact.mean()), float(wrong.mean())


def make_take(
    motion: Motion, n_cycles: float, conditions: Conditions = USUAL, *, rate_hz: float = 100.0, seed: int = 0
) -> MadeTake:
    """Return a take of a motion; the same arguments give the same take.

    Parameters
    ----------
    motion : Motion
    n_cycles : float
        Length of the take; of a motion that does not repeat, in its cycle times.
    conditions : Conditions
    rate_hz : float
        Frames a second.
    seed : int
        Of noise, gaps, ghosts, and of how cycles differ.
    """
    rng = np.random.default_rng((seed, motion.seed))
    n_frames = int(n_cycles * motion.cycle_s * rate_hz)
    time_s = np.arange(n_frames) / rate_hz
    cycles = time_s / motion.cycle_s
    shift_rad = _draw_shift(motion, cycles, n_cycles, conditions, rng)
    places = np.array([*motion.arc_length_m, motion.length_m])
    true_m = motion.points_at(cycles, np.broadcast_to(places, (n_frames, len(places))), shift_rad)
    seen = ~_draw_hidden(n_frames, len(places) - 1, conditions, rng)
    ghosts_m = _draw_ghosts(motion, cycles, shift_rad, conditions, rng)
    points_m, offsets, source = _list_points(true_m[:, :-1], seen, ghosts_m, conditions.noise_m, rng)
    cycle = np.floor(cycles).astype(np.int64) if motion.repeats else np.zeros(n_frames, dtype=np.int64)
    return MadeTake(
        points_m=points_m,
        offsets=offsets,
        time_ns=START_NS + np.round(time_s * 1e9).astype(np.int64),
        cycle=cycle,
        phase=cycles - cycle if motion.repeats else cycles / n_cycles,
        anchor_m=np.broadcast_to(ANCHOR_M, (n_frames, 3)),
        end_m=true_m[:, -1] + rng.normal(scale=conditions.end_error_m, size=3),
        end_sigma_m=np.full(n_frames, conditions.end_error_m),
        source=source,
        marker_m=true_m[:, :-1],
        arc_length_m=motion.arc_length_m,
        length_m=motion.length_m,
    )


def _draw_shift(
    motion: Motion, cycles: Floats, n_cycles: float, conditions: Conditions, rng: np.random.Generator
) -> Floats:
    """Return what jitter and drift add to the modes' coefficients, (F, 8)."""
    n_modes = motion.coefficients_at(cycles[:1]).shape[1]
    scale = 1.0 / _reach_m(motion, n_modes)
    knots = np.arange(int(n_cycles * KNOTS_PER_CYCLE) + 3) / KNOTS_PER_CYCLE
    jitter = CubicSpline(knots, rng.normal(size=(len(knots), n_modes)))(cycles)
    drift = np.multiply.outer(cycles / n_cycles, rng.normal(size=n_modes))
    return np.asarray(scale * (conditions.jitter_m * jitter + conditions.drift_m * drift))


def _reach_m(motion: Motion, n_modes: int) -> float:
    """Return how far the markers move for independent changes of the coefficients, root mean square, m per rad."""
    small_rad, cycles = 1e-3, np.linspace(0, 1, 16, endpoint=False)
    places = np.broadcast_to(motion.arc_length_m, (len(cycles), len(motion.arc_length_m)))
    planned = motion.points_at(cycles, places)
    moved = [
        motion.points_at(cycles, places, np.broadcast_to(mode, (len(cycles), n_modes))) - planned
        for mode in small_rad * np.eye(n_modes)
    ]
    return float(np.sqrt((np.square(moved).sum(axis=(0, 3))).mean()) / small_rad)


def _draw_hidden(n_frames: int, n_markers: int, conditions: Conditions, rng: np.random.Generator) -> Bools:
    """Return (F, k) who is hidden: bursts and the times between them have geometric lengths."""
    hidden = np.zeros((n_frames, n_markers), dtype=bool)
    share, burst = conditions.miss_share, conditions.burst_frames
    if share == 0.0:
        return hidden
    between = burst * (1.0 - share) / share
    for marker in range(n_markers):
        n_pairs = int(2 * n_frames / (burst + between)) + 20
        lengths = np.stack([rng.geometric(1 / between, n_pairs), rng.geometric(1 / burst, n_pairs)], axis=1)
        state = np.repeat(np.tile([False, True], n_pairs), lengths.ravel())
        begin = int(rng.integers(0, max(1, min(int(burst + between), len(state) - n_frames))))
        hidden[:, marker] = np.resize(state[begin:], n_frames)
    return hidden


def _draw_ghosts(
    motion: Motion, cycles: Floats, shift_rad: Floats, conditions: Conditions, rng: np.random.Generator
) -> Floats:
    """Return (F, n_ghosts, 3) positions: a reflection, then ghosts of short lives, each followed by the next."""
    n_frames, found = len(cycles), np.empty((len(cycles), conditions.n_ghosts, 3))
    for ghost in range(conditions.n_ghosts):
        lives = np.array([n_frames]) if ghost == 0 else rng.geometric(1 / GHOST_LIFE_FRAMES, n_frames)
        born = np.concatenate([[0], np.cumsum(lives)])
        born = born[born < n_frames]
        which = np.repeat(np.arange(len(born)), np.diff(np.append(born, n_frames)))
        near = rng.random(len(born)) < (conditions.near_share if ghost else 0.0)
        riding = near & (rng.random(len(born)) < conditions.riding_share)
        reach_m = np.where(near, NEAR_M, FAR_M) * rng.random(len(born)) ** (1 / 3)  # uniform in the ball
        place = rng.uniform(0, motion.length_m, len(born))
        moment = np.where(riding[which], np.arange(n_frames), born[which])
        base = motion.points_at(cycles[moment], place[which][:, None], shift_rad[moment])[:, 0]
        found[:, ghost] = base + (reach_m[:, None] * _draw_directions(len(born), rng))[which]
    return found


def _draw_directions(n_wanted: int, rng: np.random.Generator) -> Floats:
    drawn = rng.normal(size=(n_wanted, 3))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def _list_points(
    marker_m: Floats, seen: Bools, ghosts_m: Floats, noise_m: float, rng: np.random.Generator
) -> tuple[npt.NDArray[np.float32], Ints, npt.NDArray[np.int16]]:
    """Return points, offsets and each marker's index among its frame's points, in shuffled order."""
    everything = np.concatenate([marker_m, ghosts_m], axis=1)
    everything = everything + rng.normal(scale=noise_m, size=everything.shape)
    listed = np.concatenate([seen, np.ones(ghosts_m.shape[:2], dtype=bool)], axis=1)
    order = np.argsort(np.where(listed, rng.random(listed.shape), 2.0), axis=1)
    place = np.argsort(order, axis=1)
    counts = listed.sum(axis=1)
    shuffled = np.take_along_axis(everything, order[..., None], axis=1)
    points_m = shuffled[np.arange(listed.shape[1]) < counts[:, None]].astype(np.float32)
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return points_m, offsets, np.where(seen, place[:, : seen.shape[1]], -1).astype(np.int16)
