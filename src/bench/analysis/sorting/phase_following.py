"""Frames inside cycles sorted by the template of the cycle: gates, the compiled loop, and how sure each marker is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.analysis.arrays import Floats, Floats32, Indices, Ints
from bench.analysis.sorting.markers import MarkerReason, PointFrames, gather_positions
from bench.analysis.sorting.phase_template import PhaseTemplate

__all__ = ["FollowedFrames", "follow_frames", "measure_movement"]

SIGMAS_SEEN, SIGMAS_HIDDEN = 7.0, 5.5
"""Gates. A marker seen in the frame before is seen again with odds of 100 to 1, so only a far point is not its own; one
that was hidden then stays hidden with 7 to 1, and a point farther off than 5.5 standard deviations is rather a ghost:
for 10 % of the markers hidden, in bursts of 8 frames, and two ghosts within 20 mm of a cable of 1 m."""
DOUBT = 0.2
"""Of squared misfits, in gates: of two points that differ by less, the odds are below 20 to 1."""


@dataclass(frozen=True, eq=False)
class FollowedFrames:
    """C frames sorted by a template."""

    source: Indices
    """(C, k)"""
    misfit: Floats32
    """(C, k): distance of each marker's point from where it was expected, in gates."""
    rival: Floats32
    """(C, k): the same of the next best point that nobody has, at most 1."""

    @property
    def confidence(self) -> Floats32:
        """(C, k): odds against the next best point, and against a ghost, which lies at the gate as likely as inside."""
        odds = np.exp(-0.5 * SIGMAS_HIDDEN**2 * (self.rival**2 - self.misfit**2))
        return np.where(self.source >= 0, 1.0 / (1.0 + odds), 0.0).astype(np.float32)

    @property
    def reason(self) -> npt.NDArray[np.uint8]:
        """(C, k): `MarkerReason`."""
        alike = self.rival**2 - self.misfit**2 <= DOUBT
        given = np.where(alike, MarkerReason.AMBIGUOUS, MarkerReason.FOUND)
        return np.where(self.source >= 0, given, MarkerReason.HIDDEN).astype(np.uint8)

    def take(self, rows: slice) -> FollowedFrames:
        """Return some of the frames (C,)."""
        return FollowedFrames(self.source[rows], self.misfit[rows], self.rival[rows])

    def sure_positions(self, frames: PointFrames) -> Floats32:
        """Return (C, k, 3) positions of the markers that are found without doubt in those C frames, else NaN."""
        sure = np.where(self.reason == MarkerReason.FOUND, self.source, -1).astype(np.int16)
        return gather_positions(frames.points_m, frames.offsets, sure)


def follow_frames(frames: PointFrames, rows: Ints, template: PhaseTemplate) -> FollowedFrames:
    """Sort the frames `rows` (C,), which are in order of time and inside cycles, by the template."""
    from bench.analysis.kernels.phase_following import CycleMemory, follow_phase

    n_bins, k = len(template.position_m) - 1, template.position_m.shape[1]
    found = FollowedFrames(
        np.empty((len(rows), k), dtype=np.int16),
        np.empty((len(rows), k), dtype=np.float32),
        np.empty((len(rows), k), dtype=np.float32),
    )
    phase = np.asarray(frames.phase)[rows]
    memory = CycleMemory(
        np.ascontiguousarray(template.position_m),
        _gates(template),
        template.bin_s,
        template.left,
        template.right,
        template.weight,
        SIGMAS_SEEN * template.beside_sigma_m,
        DOUBT,
    )
    follow_phase(
        frames.points_m,
        frames.offsets,
        frames.usable,
        rows,
        np.asarray((frames.time_ns[rows] - frames.time_ns[rows[:1]]) * 1e-9, dtype=np.float64),
        np.clip(phase, 0.0, 1.0) * n_bins,
        memory,
        found.source,
        found.misfit,
        found.rival,
    )
    return found


def measure_movement(template: PhaseTemplate, newer: PhaseTemplate) -> float:
    """Return by how much the marker that moved most has moved along the path (root mean square), in gates."""
    square = np.square(newer.position_m - template.position_m).sum(axis=2)
    known = np.isfinite(square)
    mean = np.where(known, square, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return float((np.sqrt(mean) / _gates(template)[:, -1]).max())


def _gates(template: PhaseTemplate) -> Floats:
    """Return (k, 65): how far from where it is expected a marker may be, after so many bins without a point."""
    gate = SIGMAS_HIDDEN * template.sigma_m
    gate[:, :2] = SIGMAS_SEEN * template.sigma_m[:, :2]
    return np.asarray(np.minimum(gate, template.reach_m[:, None]))
