"""Sorting, curvature and cycles as functions on arrays; no files, no sockets, no configuration.

Frames come as one flat list of points with offsets: the points of frame f are ``points_m[offsets[f]:offsets[f + 1]]``.
"""

from bench.analysis.alignment import AlignedClock, SegmentClock, align_by_arrival, align_by_echo
from bench.analysis.anchors import StaticMarker, exclude_near, find_static_marker, locate_static_marker, spread_frames
from bench.analysis.bends import TRUSTED_CONFIDENCE, CycleBends, find_tighter, map_by_phase, summarise_cycles
from bench.analysis.beyond_gaps import follow_beyond_gaps
from bench.analysis.bodies import BodyMatch, centre_of_labeled, match_body
from bench.analysis.both_ends import fill_from_end
from bench.analysis.chain import sort_by_chain
from bench.analysis.chain_spacing import SpacingCalibration, calibrate_spacing
from bench.analysis.curve import ClampedEnds, CurveEstimate, CurveEstimator
from bench.analysis.cycles import CounterColumns, CycleTable, find_cycles, whole_take
from bench.analysis.ends import CableEnd, ClampDirection, estimate_clamp_direction, place_end
from bench.analysis.estimators import ESTIMATORS, get_estimator
from bench.analysis.following import follow_marker
from bench.analysis.frame_rate import fastest_speed, judge_frame_rate
from bench.analysis.free_chain import is_symmetric
from bench.analysis.gaps import Gaps, find_gaps
from bench.analysis.gates import SortSettings, SpacingGates, make_gates
from bench.analysis.hand_eye import FlangeSightings, HandEye, fit_hand_eye
from bench.analysis.invariants import take_broken_away
from bench.analysis.isolated import find_isolated_bends
from bench.analysis.markers import MarkerReason, PointFrames, SortedMarkers, gather_positions
from bench.analysis.motion_offset import MotionOffset, estimate_motion_offset
from bench.analysis.paper import sort_by_paper
from bench.analysis.phase import phase_from_register, phase_from_time
from bench.analysis.phase_sorting import sort_by_phase
from bench.analysis.rigid import RigidFit, RigidTransform, fit_rigid
from bench.analysis.sorting import SORTERS, Sorter, get_sorter, sort_automatically
from bench.analysis.sources import (
    CycleFollower,
    CycleSource,
    RobotSigns,
    count_cycles,
    describe_source,
    make_cycle_source,
)
from bench.analysis.spacing import MarkerPlaces, measure_marker_places
from bench.analysis.spline import fit_spline, interpolate_curve
from bench.analysis.starts import refine_starts
from bench.analysis.sync_pulses import PulseOffset, SwitchTimes, estimate_pulse_offset, see_lamp
from bench.analysis.tracks import PoseTrack
from bench.analysis.verdicts import CycleVerdicts, judge_cycles
from bench.analysis.visibility import HiddenStretch, find_hidden_stretches

__all__ = [
    "ESTIMATORS",
    "SORTERS",
    "TRUSTED_CONFIDENCE",
    "AlignedClock",
    "BodyMatch",
    "CableEnd",
    "ClampDirection",
    "ClampedEnds",
    "CounterColumns",
    "CurveEstimate",
    "CurveEstimator",
    "CycleBends",
    "CycleFollower",
    "CycleSource",
    "CycleTable",
    "CycleVerdicts",
    "FlangeSightings",
    "Gaps",
    "HandEye",
    "HiddenStretch",
    "MarkerPlaces",
    "MarkerReason",
    "MotionOffset",
    "PointFrames",
    "PoseTrack",
    "PulseOffset",
    "RigidFit",
    "RigidTransform",
    "RobotSigns",
    "SegmentClock",
    "SortSettings",
    "SortedMarkers",
    "Sorter",
    "SpacingCalibration",
    "SpacingGates",
    "StaticMarker",
    "SwitchTimes",
    "align_by_arrival",
    "align_by_echo",
    "calibrate_spacing",
    "centre_of_labeled",
    "count_cycles",
    "describe_source",
    "estimate_clamp_direction",
    "estimate_motion_offset",
    "estimate_pulse_offset",
    "exclude_near",
    "fastest_speed",
    "fill_from_end",
    "find_cycles",
    "find_gaps",
    "find_hidden_stretches",
    "find_isolated_bends",
    "find_static_marker",
    "find_tighter",
    "fit_hand_eye",
    "fit_rigid",
    "fit_spline",
    "follow_beyond_gaps",
    "follow_marker",
    "gather_positions",
    "get_estimator",
    "get_sorter",
    "interpolate_curve",
    "is_symmetric",
    "judge_cycles",
    "judge_frame_rate",
    "locate_static_marker",
    "make_cycle_source",
    "make_gates",
    "map_by_phase",
    "match_body",
    "measure_marker_places",
    "phase_from_register",
    "phase_from_time",
    "place_end",
    "refine_starts",
    "see_lamp",
    "sort_automatically",
    "sort_by_chain",
    "sort_by_paper",
    "sort_by_phase",
    "spread_frames",
    "summarise_cycles",
    "take_broken_away",
    "whole_take",
]
