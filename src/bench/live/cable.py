"""The cable in the newest frames, sorted and drawn by the report's own functions."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from bench.analysis import ClampedEnds, CurveEstimate, fit_elastica, fit_menger_gp, interpolate_curve, whole_take
from bench.config import Config
from bench.errors import AnalysisError, BenchError
from bench.model import CycleEventKind
from bench.recording import BODIES, CLOCK, CYCLE, FRAME, POINTS, Run, RunFollower
from bench.report.ends import find_cable_ends, find_up_axis
from bench.report.markers import ChainStart, find_chain_start, list_points
from bench.report.source import TrackerFrames, read_frames
from bench.report.trace import trace_cable

__all__ = ["LiveCable", "TracedFrame"]

Floats = npt.NDArray[np.float64]
Floats32 = npt.NDArray[np.float32]

_TOPICS = (FRAME, POINTS, BODIES, CLOCK)
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class TracedFrame:
    """The cable in one frame."""

    frame_number: int
    capture_ns: int
    arrival_ns: int
    confidence: float
    line_m: Floats
    """(g, 3): the curve through the markers that were found, lab frame."""
    line_curvature_per_m: Floats
    """(g,): along the line."""
    arc_length_m: Floats
    """(G,)"""
    curvature_per_m: Floats
    """(G,): NaN where a marker was not found."""
    sigma_per_m: Floats
    """(G,)"""


class LiveCable:
    """Finds the cable in one part of a run after the other.

    A static marker whose place is not configured is looked for once a cycle has been completed: until then nothing has
    moved, and every marker is static.
    """

    def __init__(self, follower: RunFollower) -> None:
        self.problem = "no frame has been read"
        """Why there is no cable, or why it is drawn by another method than configured; empty without either."""
        self._follower = follower
        self._config: Config | None = None
        self._has_moved = False

    def notice(self, part: Run) -> None:
        """See whether a cycle has been completed."""
        self._has_moved |= bool((part[CYCLE].kind == CycleEventKind.COMPLETED).any())

    def trace(self, part: Run, rows: npt.NDArray[np.int64]) -> Iterator[TracedFrame]:
        """Yield the cable in the frames `rows` of a part of the run, but for those in which it is not found."""
        try:
            yield from self._trace(part, rows)
        except BenchError as error:
            self.problem = str(error)

    def _trace(self, part: Run, rows: npt.NDArray[np.int64]) -> Iterator[TracedFrame]:
        config = self._configure(part)
        if config is None:
            self.problem = "its static marker is looked for when the first cycle is completed"
            return
        frames = read_frames(part)
        start = _find_start(part, frames, config)
        ends = find_cable_ends(start, None, config).clamps(config.cable.length_m, find_up_axis(part))
        by_rod = config.analysis.curvature == "elastica"
        traced = trace_cable(list_points(frames, start), config, ends, _fit_rod_or_bends if by_rod else None)
        self.problem = " ".join(traced.curve.notes) if by_rod and traced.curve.method != "elastica" else ""
        for row in rows[traced.trusted[rows]].tolist():
            curve = traced.curve
            line = interpolate_curve(traced.markers.position_m[row], traced.marker_arc_length_m, traced.arc_length_m)
            seen = np.isfinite(line[:, 0])
            yield TracedFrame(
                frame_number=int(frames.frame_number[row]),
                capture_ns=int(frames.time_ns[row]),
                arrival_ns=int(part[FRAME].log_time_ns[row]),
                confidence=float(traced.markers.confidence[row]),
                line_m=line[seen],
                line_curvature_per_m=np.asarray(curve.curvature_per_m[row], np.float64)[seen],
                arc_length_m=traced.arc_length_m,
                curvature_per_m=curve.curvature_per_m[row],
                sigma_per_m=curve.sigma_per_m[row],
            )

    def _configure(self, part: Run) -> Config | None:
        """Return the run's configuration with the anchor's place; None before it can be known."""
        if self._config is None:
            anchor = part.config.cable.anchor
            if anchor.kind != "static_marker" or anchor.position_m is not None:
                self._config = part.config
            elif self._has_moved:
                self._config = self._with_anchor(part.config)
        return self._config

    def _with_anchor(self, config: Config) -> Config:
        recent = self._follower.recent()
        recent.load(_TOPICS)
        start = _find_start(recent, read_frames(recent), config)
        if start.anchor_m is None or not len(start.anchor_m):
            return config
        x, y, z = start.anchor_m[0].tolist()
        anchor = config.cable.anchor.model_copy(update={"position_m": (x, y, z)})
        return config.model_copy(update={"cable": config.cable.model_copy(update={"anchor": anchor})})


def _find_start(run: Run, frames: TrackerFrames, config: Config) -> ChainStart:
    times = frames.time_ns if len(frames) else np.zeros(1, np.int64)
    return find_chain_start(run, frames, config, whole_take(int(times[0]), int(times[-1])))


def _fit_rod_or_bends(
    position_m: Floats32,
    marker_arc_length_m: Floats,
    arc_length_m: Floats,
    noise_m: float,
    *,
    ends: ClampedEnds | None = None,
    with_vector: bool = False,
) -> CurveEstimate:
    """Fit the heavy rod; where it cannot be fitted to what is known by now, read the bends between the markers.

    An end at the TCP is known only afterwards: its place needs the robot's clock over the whole run.
    """
    given = position_m, marker_arc_length_m, arc_length_m, noise_m
    try:
        return fit_elastica(*given, ends=ends, with_vector=with_vector)
    except AnalysisError as error:
        bends = fit_menger_gp(*given, ends=ends, with_vector=with_vector)
        return replace(bends, notes=[f"drawn by 'menger_gp' while the run goes on. {error.args[0]}"])
