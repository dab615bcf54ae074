"""What an analysis found: the one object from which tables, figures and the page are made."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from bench.config import Config
from bench.model import Outcome, Severity

__all__ = [
    "ClockFinding",
    "CycleColumns",
    "Drift",
    "DriftChange",
    "DriftColumns",
    "DriftTrend",
    "EndColumns",
    "ExampleFrame",
    "FrameColumns",
    "NotedLine",
    "Results",
    "StreamFinding",
]

Floats = npt.NDArray[np.float64]
Floats32 = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class FrameColumns:
    """One row for each of the F tracker frames, in order of capture."""

    frame_number: Ints
    time_ns: Ints
    """Capture time, host Unix nanoseconds, by the offline clock map."""
    cycle_index: Ints
    """-1 outside any cycle."""
    cycle_phase: Floats
    """0…1, NaN outside any cycle."""
    source: npt.NDArray[np.int16]
    """(F, k): index in the recorded frame's point list given to each marker, -1 where not found."""
    position_m: Floats32
    """(F, k, 3): lab frame, NaN where not found."""
    confidence: Floats32
    """(F,): 0…1, mean of the markers'."""
    marker_confidence: Floats32
    """(F, k): 0…1, 0 where not found."""
    reason: npt.NDArray[np.uint8]
    """(F, k): `bench.analysis.MarkerReason`, why a marker has its point or none."""
    curvature_per_m: Floats32
    """(F, G): magnitude of the curvature at `Results.arc_length_m`, NaN where no curve could be drawn."""
    sigma_per_m: Floats32
    """(F, G): its standard deviation, from the markers' noise."""


@dataclass(frozen=True, eq=False)
class CycleColumns:
    """One row for each cycle: the columns of ``cycles.parquet``, by the same names."""

    cycle_index: Ints
    start_ns: Ints
    start_from: list[str]
    """`motion`: the last sample before the joints moved; `signal`: as the robot showed it."""
    end_ns: Ints
    duration_s: Floats
    n_frames: Ints
    verdict: list[str]
    complete_fraction: Floats
    max_curvature_per_m: Floats
    max_curvature_sigma_per_m: Floats
    max_curvature_arc_length_m: Floats
    min_bend_radius_mm: Floats
    mean_curvature_per_m: Floats


@dataclass(frozen=True)
class StreamFinding:
    """What became of one topic."""

    topic: str
    rate_hz: float
    received: int
    written: int
    dropped: int
    missed: int
    """Gaps in the device's own sequence: never arrived."""


@dataclass(frozen=True)
class ClockFinding:
    """How one device's clock relates to ours, one clock segment."""

    device: str
    segment: int
    method: str
    offset_s: float
    """Host Unix time minus device time at the start of the segment."""
    drift_ppm: float
    residual_sd_us: float
    n_samples: int
    residual_p50_us: float = float("nan")
    """Median distance of the evidence from the line: of arrivals, how late they came."""
    residual_p99_us: float = float("nan")
    stamped_by: str = ""
    """Who stamped the arrivals: the `kernel`, or the `program` when it was woken; empty where it is not recorded."""


@dataclass(frozen=True)
class NotedLine:
    """One sentence of the run's log."""

    host_ns: int
    severity: Severity
    name: str
    """Who said it: `run`, `robot`, `tracker`, `recorder`."""
    text: str


@dataclass(frozen=True, eq=False)
class ExampleFrame:
    """One frame shown as the paper's Fig. 5 shows it."""

    frame_number: int
    cycle_index: int
    cycle_phase: float
    points_m: Floats32
    """(n, 3): as recorded, in the tracker's order."""
    position_m: Floats32
    """(k, 3): in the order found along the cable."""
    anchor_m: Floats
    """(3,): where the chain starts; NaN where unknown, or for a cable without anchor."""
    curve_m: Floats
    """(G, 3): the interpolated cable at `Results.arc_length_m`."""
    curvature_per_m: Floats32
    sigma_per_m: Floats32
    up_axis: int = 1
    """Which axis of the lab frame points up: 1, y, as Motive has it by default, unless the tracker says otherwise."""


@dataclass(frozen=True, eq=False)
class EndColumns:
    """The cable's ends in each of the F frames: the columns of ``ends.parquet``, by the same names."""

    anchor_tangent: Floats
    """(F, 3): from the clamp into the free cable, lab frame; NaN where unknown, as in all of these."""
    anchor_tangent_sigma_rad: Floats
    """(F,)"""
    end_position_m: Floats
    """(F, 3): lab frame."""
    end_position_sigma_m: Floats
    """(F,): in the worst direction."""
    end_tangent: Floats
    """(F, 3): from the clamp into the free cable, lab frame."""
    end_tangent_sigma_rad: Floats
    """(F,)"""


@dataclass(frozen=True, eq=False)
class DriftColumns:
    """How far each cycle is from the first ones: the columns of ``drift.parquet``, by the same names."""

    cycle_index: Ints
    watched: npt.NDArray[np.bool_]
    """Whether the cycle's verdict is ok, so that it counts for the drift."""
    shape_distance_mm: Floats
    """Root mean square over markers and phases, without what the reference cycles differ by; NaN where unknown."""
    shape_distance_fitted_mm: Floats
    """Level, steps and trend that were found, as a distance from the reference; NaN where the cycle is not watched."""
    max_curvature_change_per_m: Floats
    """Against the median of the reference cycles."""
    max_curvature_change_sigma_per_m: Floats
    max_curvature_change_fitted_per_m: Floats


@dataclass(frozen=True)
class DriftChange:
    """A lasting change from one cycle to the next."""

    quantity: str
    """`shape`, in mm, or `max_curvature`, in 1/m: that of `size`, `sigma` and `largest`."""
    cycle_index: int
    """The first cycle after it."""
    size: float
    """Of the step in the quantity of ``drift.parquet``."""
    sigma: float
    arc_length_m: float
    """Where along the cable the cycles after it differ most from those before; NaN where unknown, as the next two."""
    cycle_phase: float
    """At which phase."""
    largest: float
    """By how much, there: distance of a marker, or curvature."""
    matters: bool
    """Whether it is larger than a marker's noise; or than a hundredth of the curvature, and beside an end its band."""


@dataclass(frozen=True)
class DriftTrend:
    """The line in a quantity besides its steps: of one that is bent, the slope on the whole."""

    quantity: str
    per_1000_cycles: float
    sigma_per_1000_cycles: float
    stands_out: bool
    """Whether noise alone would hardly give it."""
    matters: bool
    """Whether it stands out and adds up, over the whole run, to more than a change must have to matter."""


@dataclass(frozen=True, eq=False)
class Drift:
    """What the cycles say of a cable that changes."""

    columns: DriftColumns
    reference_cycle_index: Ints
    """The first cycles with verdict ok, against which the others are held."""
    usual_shape_distance_mm: float
    """What a reference cycle differs from the others by."""
    changes: list[DriftChange]
    """In order of cycles."""
    trends: list[DriftTrend]


@dataclass(frozen=True, eq=False)
class Results:
    """Everything the report says."""

    run_path: str
    """Name of the run file (without its folder)."""
    config: Config
    config_sha256: str
    versions: dict[str, str]
    methods: dict[str, str]
    """`sorting`, `curvature`, `cycles`: the names of the methods used."""
    exit_status: str
    """How the run ended: success, abort, fail, or unfinished; `import` for a take."""
    exit_reason: str
    outcome: Outcome
    outcome_reasons: list[str]
    """Each one sentence: why the outcome is not PASS."""
    run_facts: dict[str, str]
    """What was run, in the order shown: devices, program, times, operator, sample."""
    arc_length_m: Floats
    """(G,): where curvature is given."""
    marker_arc_length_m: Floats
    """(k,)."""
    frames: FrameColumns
    cycles: CycleColumns
    phase_grid: Floats
    """(P,): centres of the phase bins of `bend_map_per_m`."""
    bend_map_per_m: Floats
    """(P, G): median curvature over all cycles by phase and arc length; NaN where nothing was seen."""
    example: ExampleFrame | None
    """None when no frame was complete enough to draw."""
    streams: list[StreamFinding]
    clocks: list[ClockFinding]
    program_facts: dict[str, str] = field(default_factory=dict)
    """What the recording says of the robot's program: of the loaded one, and of the copy that it carries."""
    attention: dict[int, list[str]] = field(default_factory=dict)
    """Cycles that need a look, by index, with the reasons in words."""
    noted: list[NotedLine] = field(default_factory=list)
    """The run's log, in order."""
    warnings: list[str] = field(default_factory=list)
    """Sentences about the analysis itself that the reader must know."""
    method_notes: dict[str, list[str]] = field(default_factory=dict)
    """By step as in `methods`: why this method, what it learnt from this recording."""
    ends: EndColumns | None = None
    """None where nothing tells more of the ends than the anchor's place."""
    drift: Drift | None = None
    """None with fewer than 20 cycles of verdict ok."""
    analysis_s: float = float("nan")
    """Time the analysis took, on this machine."""
