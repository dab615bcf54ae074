"""The paper's error analysis, its section 4, with every estimator there is: shapes, errors, what came out."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.analysis import (
    Catenary,
    Circle,
    ClampedEnds,
    Condition,
    CurveEstimate,
    CurveEstimator,
    ErrorFigures,
    KnownShape,
    SampledShape,
    make_ends,
    make_frames,
    measure_errors,
)
from bench.errors import AnalysisError
from bench.report.results import Floats32

__all__ = [
    "CONDITIONS",
    "TURN_RAD",
    "Study",
    "StudyRow",
    "Subject",
    "estimate",
    "make_conditions",
    "make_paper_subjects",
    "make_rod_subject",
    "run_study",
]

Floats = npt.NDArray[np.float64]

N_FRAMES = 100
"""Frames of each case with noise: a median over them is good to a tenth of their scatter."""
SEED = 2026
TURN_RAD = float(np.deg2rad(0.3))
"""Standard deviation of the clamps' directions: what a calibrated flange gives."""
N_PLACES = 401
"""Places at which radii are compared: the largest error is found to 0.01 %."""
HIGH_NOISE_M = 1e-3
PLACEMENT_M = 5e-3
"""Markers are taped on by hand."""
CONDITIONS = ("ideal", "noise", "high noise", "placement", "1 hidden", "2 hidden")


@dataclass(frozen=True, eq=False)
class Subject:
    """A known shape with its markers, and what may be done to them."""

    key: str
    """Short name, for tables and file columns."""
    title: str
    shape: KnownShape
    marker_arc_length_m: Floats
    conditions: tuple[str, ...]
    """Of `CONDITIONS`."""
    is_rod: bool = False

    @property
    def arc_length_m(self) -> Floats:
        """(G,): where radii are compared, from the first marker to the last."""
        return np.linspace(self.marker_arc_length_m[0], self.marker_arc_length_m[-1], N_PLACES)


@dataclass(frozen=True, eq=False)
class StudyRow:
    """One estimator in one case."""

    subject: str
    condition: str
    estimator: str
    ends: str
    """`unknown`, `known`: both clamps' places and directions are given; `unused`: they change nothing."""
    n_frames: int
    figures: ErrorFigures | None
    """None where the estimator gave nothing."""
    skipped: str = ""
    """Why not."""


@dataclass(frozen=True, eq=False)
class Study:
    """All cases."""

    subjects: list[Subject]
    conditions: Mapping[str, Condition]
    rows: list[StudyRow]
    seconds: float

    def find(self, subject: str, condition: str, estimator: str, ends: Sequence[str]) -> StudyRow | None:
        """Return the row of a case, with the ends known or not."""
        wanted = (subject, condition, estimator)
        return next((r for r in self.rows if (r.subject, r.condition, r.estimator) == wanted and r.ends in ends), None)

    @property
    def variants(self) -> list[tuple[str, str]]:
        """Estimators that gave something, with what they know of the ends, in the order in which they were tried."""
        return list(dict.fromkeys((row.estimator, row.ends) for row in self.rows if row.figures))


def make_conditions(noise_m: float) -> dict[str, Condition]:
    """Return the errors that are studied, by name, for a tracker of this noise."""
    made = (
        Condition(),
        Condition(noise_m),
        Condition(HIGH_NOISE_M),
        Condition(noise_m, placement_m=PLACEMENT_M),
        Condition(noise_m, n_hidden=1),
        Condition(noise_m, n_hidden=2),
    )
    return dict(zip(CONDITIONS, made, strict=True))


def make_paper_subjects() -> list[Subject]:
    """Return the paper's circle and catenary, its Fig. 6.

    The circle's 8 markers are at s = 0, D, … 7 D with D an eighth of the circle: an open arc of 315 degrees. The
    catenary's 12 markers are equally spaced along its 2 m.
    """
    radius, length = 0.4, 2.0
    around = np.arange(8.0) * (2 * np.pi * radius / 8)
    hung = np.linspace(0.0, length, 12)
    return [
        Subject("circle", "Circle, r = 0.4 m, 8 markers", Circle(radius), around, CONDITIONS),
        Subject("catenary", "Catenary, a = 0.5 m, 12 markers", Catenary(0.5, length / 2), hung, CONDITIONS),
    ]


def make_rod_subject(stiffness_nm2: float, shape: SampledShape, n_markers: int) -> Subject:
    """Return a clamped rod with evenly spaced markers, the first and the last in its clamps."""
    places = np.linspace(0.0, shape.length_m, n_markers)
    title = f"Clamped cable, EI = {stiffness_nm2:g} N m²"
    return Subject(f"rod {stiffness_nm2:g}", title, shape, places, ("noise",), is_rod=True)


def run_study(subjects: Sequence[Subject], estimators: Mapping[str, CurveEstimator], noise_m: float) -> Study:
    """Try every estimator on every shape under every condition, without and with known ends.

    Parameters
    ----------
    subjects : sequence of Subject
    estimators : mapping
        By name.
    noise_m : float
        Standard deviation of a tracked marker's coordinates.

    Returns
    -------
    Study
        The same numbers for the same arguments: every case has its own seed.
    """
    begin, conditions = time.perf_counter(), make_conditions(noise_m)
    rows: list[StudyRow] = []
    for number, subject in enumerate(subjects):
        for name in subject.conditions:
            seed = SEED + 100 * number + 10 * CONDITIONS.index(name)
            rows.extend(_try_case(subject, name, conditions[name], estimators, seed))
    return Study(list(subjects), conditions, rows, time.perf_counter() - begin)


def _try_case(
    subject: Subject, name: str, condition: Condition, estimators: Mapping[str, CurveEstimator], seed: int
) -> Iterator[StudyRow]:
    n_frames = N_FRAMES if condition.noise_m else 1
    markers = subject.marker_arc_length_m
    frames = make_frames(subject.shape, markers, condition, n_frames, np.random.default_rng(seed))
    span = float(markers[0]), float(markers[-1])
    ends = make_ends(subject.shape, span, TURN_RAD, condition, n_frames, seed + 1)
    truth = subject.shape.curvature(subject.arc_length_m)
    for estimator, fit in estimators.items():
        free, why = estimate(fit, frames, markers, subject.arc_length_m, condition.told_noise_m)
        held, why_held = estimate(fit, frames, markers, subject.arc_length_m, condition.told_noise_m, ends)
        unused = free is not None and held is not None and _are_equal(free, held)
        tried = [("unused", free, why)] if unused else [("unknown", free, why), ("known", held, why_held)]
        for label, curve, reason in tried:
            figures = measure_errors(curve, truth) if curve else None
            yield StudyRow(subject.key, name, estimator, label, n_frames, figures, reason)


def estimate(
    fit: CurveEstimator,
    position_m: Floats32,
    marker_arc_length_m: Floats,
    arc_length_m: Floats,
    noise_m: float,
    ends: ClampedEnds | None = None,
) -> tuple[CurveEstimate | None, str]:
    """Return an estimator's curve, or None and the reason why it gives none."""
    try:
        curve = fit(position_m, marker_arc_length_m, arc_length_m, noise_m, ends=ends)
    except AnalysisError as error:
        return None, str(error)
    if np.isfinite(curve.curvature_per_m).any():
        return curve, ""
    return None, " ".join(["It gives no curvature in any frame.", *curve.notes])


def _are_equal(one: CurveEstimate, other: CurveEstimate) -> bool:
    return np.array_equal(one.curvature_per_m, other.curvature_per_m, equal_nan=True)
