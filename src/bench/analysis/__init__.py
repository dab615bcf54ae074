"""Sorting, curvature and cycles as functions on arrays; no files, no sockets, no configuration.

Frames come as one flat list of points with offsets: the points of frame f are ``points_m[offsets[f]:offsets[f + 1]]``.
"""

from bench.analysis.calibration.alignment import AlignedClock, SegmentClock, align_by_arrival, align_by_echo
from bench.analysis.calibration.frame_rate import fastest_speed, judge_frame_rate
from bench.analysis.calibration.hand_eye import FlangeSightings, HandEye, fit_hand_eye
from bench.analysis.calibration.motion_offset import MotionOffset, estimate_motion_offset
from bench.analysis.calibration.pose_track import PoseTrack
from bench.analysis.calibration.rigid import RigidFit, RigidTransform, fit_rigid
from bench.analysis.calibration.sync_pulses import PulseOffset, SwitchTimes, estimate_pulse_offset, see_lamp
from bench.analysis.calibration.visibility import HiddenStretch, find_hidden_stretches
from bench.analysis.curvature.bends import TRUSTED_CONFIDENCE, CycleBends, find_tighter, summarise_cycles
from bench.analysis.curvature.best_curve import estimate_best
from bench.analysis.curvature.elastica import fit_elastica
from bench.analysis.curvature.ends import CableEnd, ClampDirection, estimate_clamp_direction, place_end
from bench.analysis.curvature.estimate import ClampedEnds, CurveEstimate, CurveEstimator
from bench.analysis.curvature.estimators import ESTIMATORS, get_estimator
from bench.analysis.curvature.folds import find_folds
from bench.analysis.curvature.isolated import find_isolated_bends
from bench.analysis.curvature.menger import fit_menger_gp
from bench.analysis.curvature.phase_mean import (
    LargestBend,
    PhaseMean,
    average_by_phase,
    find_largest_bend,
)
from bench.analysis.curvature.radius import BendRadius, bend_radius
from bench.analysis.curvature.spline import fit_spline, interpolate_curve
from bench.analysis.curvature.twist_free import resolve_curvature
from bench.analysis.cycles.drift_changes import FEWEST_VALUES, LevelChange, SeriesDrift, describe_drift
from bench.analysis.cycles.drift_line import measure_along_change
from bench.analysis.cycles.drift_shape import CycleShapes, ShapeDistances, gather_shapes, measure_distances
from bench.analysis.cycles.gaps import Gaps, find_gaps
from bench.analysis.cycles.periodicity import find_repeated_cycles
from bench.analysis.cycles.phase import phase_from_register, phase_from_time
from bench.analysis.cycles.phase_path import Travel, measure_travel, phase_from_path
from bench.analysis.cycles.sources import (
    CycleFollower,
    CycleSource,
    RobotSigns,
    count_cycles,
    describe_source,
    make_cycle_source,
)
from bench.analysis.cycles.starts import refine_starts
from bench.analysis.cycles.table import CounterColumns, CycleTable, find_cycles, whole_take
from bench.analysis.cycles.verdicts import CycleVerdicts, judge_cycles
from bench.analysis.sorting.anchors import (
    StaticMarker,
    exclude_near,
    find_static_marker,
    locate_static_marker,
    spread_frames,
)
from bench.analysis.sorting.bodies import BodyMatch, bridge_poses, centre_of_labeled, match_body
from bench.analysis.sorting.chain import sort_by_chain
from bench.analysis.sorting.chain_spacing import SpacingCalibration, calibrate_spacing
from bench.analysis.sorting.following import follow_marker
from bench.analysis.sorting.free_chain import is_symmetric
from bench.analysis.sorting.gates import SortSettings, SpacingGates, make_gates
from bench.analysis.sorting.invariants import take_broken_away, tell_broken
from bench.analysis.sorting.markers import MarkerReason, PointFrames, SortedMarkers, gather_positions
from bench.analysis.sorting.paper import sort_by_paper
from bench.analysis.sorting.phase_sorting import sort_by_phase
from bench.analysis.sorting.point_checks import PointChecks, check_points
from bench.analysis.sorting.reflections import Reflections, find_reflections
from bench.analysis.sorting.sorters import SORTERS, Sorter, get_sorter, sort_automatically
from bench.analysis.sorting.spacing import MarkerPlaces, measure_marker_places
from bench.analysis.sorting.track_sorting import sort_by_track
from bench.analysis.study.comparison import (
    MotionDifference,
    align_in_space,
    align_in_time,
    compare_motions,
    draw_motion,
    median_cycle,
    shift_motion,
)
from bench.analysis.study.error_study import Condition, ErrorFigures, make_ends, make_frames, measure_errors
from bench.analysis.study.shape_fit import ShapeFit, average_frames, fit_shape, fit_size, verify_on_shape
from bench.analysis.study.shapes import Catenary, Circle, KnownShape, SampledShape, Straight

__all__ = [
    "ESTIMATORS",
    "FEWEST_VALUES",
    "SORTERS",
    "TRUSTED_CONFIDENCE",
    "AlignedClock",
    "BendRadius",
    "BodyMatch",
    "CableEnd",
    "Catenary",
    "Circle",
    "ClampDirection",
    "ClampedEnds",
    "Condition",
    "CounterColumns",
    "CurveEstimate",
    "CurveEstimator",
    "CycleBends",
    "CycleFollower",
    "CycleShapes",
    "CycleSource",
    "CycleTable",
    "CycleVerdicts",
    "ErrorFigures",
    "FlangeSightings",
    "Gaps",
    "HandEye",
    "HiddenStretch",
    "KnownShape",
    "LargestBend",
    "LevelChange",
    "MarkerPlaces",
    "MarkerReason",
    "MotionDifference",
    "MotionOffset",
    "PhaseMean",
    "PointChecks",
    "PointFrames",
    "PoseTrack",
    "PulseOffset",
    "Reflections",
    "RigidFit",
    "RigidTransform",
    "RobotSigns",
    "SampledShape",
    "SegmentClock",
    "SeriesDrift",
    "ShapeDistances",
    "ShapeFit",
    "SortSettings",
    "SortedMarkers",
    "Sorter",
    "SpacingCalibration",
    "SpacingGates",
    "StaticMarker",
    "Straight",
    "SwitchTimes",
    "Travel",
    "align_by_arrival",
    "align_by_echo",
    "align_in_space",
    "align_in_time",
    "average_by_phase",
    "average_frames",
    "bend_radius",
    "bridge_poses",
    "calibrate_spacing",
    "centre_of_labeled",
    "check_points",
    "compare_motions",
    "count_cycles",
    "describe_drift",
    "describe_source",
    "draw_motion",
    "estimate_best",
    "estimate_clamp_direction",
    "estimate_motion_offset",
    "estimate_pulse_offset",
    "exclude_near",
    "fastest_speed",
    "find_cycles",
    "find_folds",
    "find_gaps",
    "find_hidden_stretches",
    "find_isolated_bends",
    "find_largest_bend",
    "find_reflections",
    "find_repeated_cycles",
    "find_static_marker",
    "find_tighter",
    "fit_elastica",
    "fit_hand_eye",
    "fit_menger_gp",
    "fit_rigid",
    "fit_shape",
    "fit_size",
    "fit_spline",
    "follow_marker",
    "gather_positions",
    "gather_shapes",
    "get_estimator",
    "get_sorter",
    "interpolate_curve",
    "is_symmetric",
    "judge_cycles",
    "judge_frame_rate",
    "locate_static_marker",
    "make_cycle_source",
    "make_ends",
    "make_frames",
    "make_gates",
    "match_body",
    "measure_along_change",
    "measure_distances",
    "measure_errors",
    "measure_marker_places",
    "measure_travel",
    "median_cycle",
    "phase_from_path",
    "phase_from_register",
    "phase_from_time",
    "place_end",
    "refine_starts",
    "resolve_curvature",
    "see_lamp",
    "shift_motion",
    "sort_automatically",
    "sort_by_chain",
    "sort_by_paper",
    "sort_by_phase",
    "sort_by_track",
    "spread_frames",
    "summarise_cycles",
    "take_broken_away",
    "tell_broken",
    "verify_on_shape",
    "whole_take",
]
