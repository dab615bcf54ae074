"""The numbers of the report's first screen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.analysis import bend_radius
from bench.model import Verdict
from bench.report.results import Results
from bench.report.streams import find_missing

__all__ = ["Headline", "TightestBend", "find_tightest_bend", "find_unjudged_bend", "summarise"]

NAN = float("nan")
JUDGED = (Verdict.OK, Verdict.SLOW)
"""Verdicts of the cycles on which an outcome may rest: they were driven and recorded whole."""


@dataclass(frozen=True)
class TightestBend:
    """The smallest bend radius of the whole run, with its place."""

    cycle_index: int
    radius_mm: float
    low_mm: float
    """Lower end of the interval of two standard deviations of curvature."""
    high_mm: float
    """Upper end; infinite where the curvature may be zero, NaN where its standard deviation is unknown."""
    arc_length_mm: float
    cycle_phase: float
    """0…1, NaN when no frame can be named."""


@dataclass(frozen=True)
class Headline:
    """What a person wants to know first."""

    n_cycles: int
    n_ok: int
    limit_mm: float
    """Catalogue limit of the bend radius."""
    tightest: TightestBend | None
    """None when no cycle has a curvature."""
    n_recorded: int
    n_dropped: int
    missed_from: dict[str, int]
    """Records that never came, by device; devices of which nothing is missing are left out."""

    @property
    def n_missed(self) -> int:
        """Records that never came from any device."""
        return sum(self.missed_from.values())

    @property
    def limit_inside_interval(self) -> bool:
        """Whether the catalogue limit lies inside the tightest bend's interval, so that neither side is certain."""
        return self.tightest is not None and self.tightest.low_mm < self.limit_mm < self.tightest.high_mm


def summarise(results: Results) -> Headline:
    """Return the numbers of the first screen."""
    return Headline(
        n_cycles=int(results.cycles.cycle_index.size),
        n_ok=sum(verdict == Verdict.OK for verdict in results.cycles.verdict),
        limit_mm=results.config.cable.minimum_bend_radius_mm,
        tightest=find_tightest_bend(results),
        n_recorded=sum(stream.written for stream in results.streams),
        n_dropped=sum(stream.dropped for stream in results.streams),
        missed_from={device: lost.missed for device, lost in find_missing(results.streams).items()},
    )


def find_tightest_bend(results: Results) -> TightestBend | None:
    """Return the largest of the cycles' maxima as a bend radius with its place, None when no cycle has one.

    Only cycles on which the outcome rests (ok, slow) are asked, unless none of them has a curvature.
    """
    judged = np.isin(results.cycles.verdict, JUDGED)
    bend = _tightest_of(results, judged)
    return _tightest_of(results, ~judged) if bend is None else bend


def find_unjudged_bend(results: Results) -> TightestBend | None:
    """Return the tightest bend of the cycles on which no outcome rests, if it is tighter than all that were judged."""
    judged = np.isin(results.cycles.verdict, JUDGED)
    best, other = _tightest_of(results, judged), _tightest_of(results, ~judged)
    return other if best is not None and other is not None and other.radius_mm < best.radius_mm else None


def _tightest_of(results: Results, chosen: npt.NDArray[np.bool_]) -> TightestBend | None:
    cycles = results.cycles
    value = np.where(chosen & np.isfinite(cycles.max_curvature_per_m), cycles.max_curvature_per_m, -1.0)
    if not (value >= 0).any():
        return None
    row = int(value.argmax())
    bend = bend_radius(value[row], cycles.max_curvature_sigma_per_m[row])
    return TightestBend(
        cycle_index=int(cycles.cycle_index[row]),
        radius_mm=1e3 * float(bend.radius_m),
        low_mm=1e3 * float(bend.low_m),
        high_mm=1e3 * float(bend.high_m),
        arc_length_mm=1e3 * float(cycles.max_curvature_arc_length_m[row]),
        cycle_phase=_phase_of_maximum(results, row),
    )


def _phase_of_maximum(results: Results, row: int) -> float:
    """Return the phase of the frame whose curvature, at the place of the maximum, comes nearest to it."""
    frames, cycles = results.frames, results.cycles
    inside = np.flatnonzero(frames.cycle_index == cycles.cycle_index[row])
    place = cycles.max_curvature_arc_length_m[row]
    if not inside.size or not np.isfinite(place):
        return NAN
    sample = int(np.abs(results.arc_length_m - place).argmin())
    apart = np.abs(frames.curvature_per_m[inside, sample] - cycles.max_curvature_per_m[row])
    if not np.isfinite(apart).any():
        return NAN
    return float(frames.cycle_phase[inside[int(np.nanargmin(apart))]])
