"""Which points may be the cable's and where its chain starts: the paper's two cases."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from bench.analysis import (
    CableEnd,
    CycleTable,
    PointFrames,
    SortSettings,
    StaticMarker,
    bridge_poses,
    centre_of_labeled,
    check_points,
    exclude_near,
    find_reflections,
    find_static_marker,
    is_symmetric,
    locate_static_marker,
    make_gates,
    match_body,
    spread_frames,
)
from bench.config import CableConfig, Config, EndConfig, HolderConfig
from bench.errors import AnalysisError
from bench.model import UNLABELED
from bench.recording import Run
from bench.report.source import TrackerFrames

__all__ = ["ChainStart", "TrackedBodies", "find_chain_start", "list_points", "make_sort_settings", "turn_matrices"]

Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

HAS_MODEL = 0x08
"""NatNet's bit for a marker that the tracker gives to a rigid body or a skeleton."""
SCANNED_CYCLES = 2
"""Cycles in which the static marker is looked for."""
LOW_PRESENCE = 0.5


@dataclass(eq=False)
class ChainStart:
    """What the sorter is given besides the points."""

    usable: Bools
    """(N,): points that may be the cable's."""
    anchor_m: Floats | None = None
    """(F, 3): where the chain starts, NaN where unknown; None for a cable without anchor."""
    bodies: TrackedBodies | None = None
    """None without a single point."""
    warnings: list[str] = field(default_factory=list)
    facts: dict[str, str] = field(default_factory=dict)


def make_sort_settings(config: Config) -> SortSettings:
    """Return what a sorter knows of the configured cable."""
    cable, analysis = config.cable, config.analysis
    return SortSettings(
        cable.arc_length_m,
        cable.stretch_ratio,
        cable.shorten,
        tolerance_m=analysis.gate_tolerance_mm * 1e-3,
        length_m=cable.length_m,
        noise_m=analysis.marker_noise_mm * 1e-3,
    )


def find_chain_start(run: Run, frames: TrackerFrames, config: Config, table: CycleTable) -> ChainStart:
    """Take out the points that are not the cable's, and find the anchor in every frame.

    Raises
    ------
    AnalysisError
        The configured rigid body is not in the recording, no static marker is found, or lengths are not in metres.
    """
    checks = check_points(frames.points_m, frames.offsets, config.cable.arc_length_m)
    start = ChainStart(usable=~_is_labeled(frames.flags) & checks.good, warnings=checks.warnings)
    if len(frames.points_m) == 0:
        start.warnings.append("The tracker saw no markers: check the cameras' exposure and the markers' reflection.")
        start.anchor_m = np.full((len(frames), 3), np.nan)
        return start
    start.bodies = bodies = TrackedBodies(run, frames)
    start.usable &= ~bodies.is_body
    anchor, end = config.cable.anchor, config.cable.end
    if end is not None:
        _exclude_end(start, frames, end, bodies, table)
    if anchor.kind == "rigid_body":
        start.anchor_m = _body_anchor(start, bodies, anchor)
    elif anchor.kind == "static_marker":
        _set_static_anchor(start, frames, config, table)
    else:
        _go_without_anchor(start, config)
    _exclude_reflections(start, frames, config)
    start.warnings.extend(bodies.warnings)
    return start


def list_points(
    frames: TrackerFrames,
    start: ChainStart,
    row: Ints | None = None,
    phase: Floats | None = None,
    end: CableEnd | None = None,
) -> PointFrames:
    """Return the frames as a sorter takes them: `row` and `phase` (F,) are each frame's place in the cycles."""
    return PointFrames(
        frames.points_m,
        frames.offsets,
        start.usable,
        start.anchor_m,
        frames.time_ns,
        end.position_m if end else None,
        end.position_sigma_m if end else None,
        row,
        phase,
    )


def _is_labeled(flags: npt.NDArray[np.uint32]) -> Bools:
    return np.asarray((flags & HAS_MODEL != 0) & (flags & UNLABELED == 0), dtype=bool)


class TrackedBodies:
    """The recording's rigid bodies: poses by name, and which points are their own markers."""

    def __init__(self, run: Run, frames: TrackerFrames) -> None:
        self._frames = frames
        tracker = next((device for device in run.devices if device.device == "tracker"), None)
        self.names = dict(tracker.bodies) if tracker else {}
        self.is_body = np.zeros(len(frames.points_m), dtype=bool)
        self.warnings: list[str] = []
        self._centres: dict[int, Floats] = {}
        markers = _recorded_body_markers(run)
        for body_id, name in self.names.items():
            if name in markers:
                self._match(body_id, name, markers[name])

    def centre(self, body_id: int) -> Floats:
        """Return the body's centre of gravity in each frame, (F, 3)."""
        if body_id in self._centres:
            return self._centres[body_id]
        position, _ = self.poses(body_id)
        own = _is_labeled(self._frames.flags) & (self._frames.ids >> 16 == body_id)
        return centre_of_labeled(self._frames.points_m, self._frames.offsets, own, position)

    def place_clamp(self, holder: HolderConfig) -> Floats:
        """Return where a body holds the cable in each frame, (F, 3): its centre of gravity where no clamp is given."""
        body_id = self.id_of(holder.name)
        if holder.clamp_m is None:
            return self.centre(body_id)
        position, quaternion = self.poses(body_id)
        return np.asarray(position + turn_matrices(quaternion) @ np.array(holder.clamp_m))

    def id_of(self, name: str) -> int:
        """Return the id of the body of that name; `AnalysisError` if the recording has none."""
        for body_id, known in self.names.items():
            if known == name:
                return body_id
        known_names = ", ".join(f"'{known}'" for known in self.names.values()) or "none"
        raise AnalysisError(
            f"The recording has no rigid body '{name}'; it has: {known_names}.",
            hint="Correct the name in the [cable] table of a copy of the configuration and give it with --config.",
        )

    def _match(self, body_id: int, name: str, markers_m: Floats) -> None:
        position, quaternion = self.poses(body_id)
        bridged = bridge_poses(self._frames.time_ns, position, quaternion)
        found = match_body(self._frames.points_m, self._frames.offsets, *bridged, markers_m)
        is_tracked = np.isfinite(position[:, :1])
        n_expected = int(is_tracked.sum()) * len(markers_m)
        if found.is_body.sum() * 2 >= n_expected:
            self.is_body |= found.is_body
            self._centres[body_id] = np.where(is_tracked, found.centre_m, np.nan)
        elif not self._has_labels(body_id):
            self.warnings.append(
                f"Fewer than half of the markers of the rigid body '{name}' are where its pose puts them: "
                "they may be taken for the cable's."
            )

    def _has_labels(self, body_id: int) -> bool:
        return bool((_is_labeled(self._frames.flags) & (self._frames.ids >> 16 == body_id)).any())

    def poses(self, body_id: int) -> tuple[Floats, Floats]:
        """Return the body's positions (F, 3) and quaternions (F, 4), NaN where it was not tracked."""
        bodies, n_frames = self._frames.bodies, len(self._frames)
        mine = bodies.body_id == body_id
        position, quaternion = np.full((n_frames, 3), np.nan), np.full((n_frames, 4), np.nan)
        position[bodies.frame[mine]] = bodies.position_m[mine]
        quaternion[bodies.frame[mine]] = bodies.quaternion_xyzw[mine]
        return position, quaternion


def turn_matrices(quaternion_xyzw: Floats) -> Floats:
    """Return rotations (F, 3, 3) of quaternions (F, 4), NaN where there is none."""
    known = np.isfinite(quaternion_xyzw).all(axis=1) & (np.linalg.norm(quaternion_xyzw, axis=1) > 0)
    turn = np.full((len(quaternion_xyzw), 3, 3), np.nan)
    if known.any():
        turn[known] = Rotation.from_quat(quaternion_xyzw[known]).as_matrix()
    return turn


def _recorded_body_markers(run: Run) -> Mapping[str, Floats]:
    """Return the markers (m, 3) of rigid bodies in their own frames, by name, as the tracker's description has them."""
    described: dict[str, Floats] = {}
    for device in run.devices:
        if device.device == "tracker" and "body_markers" in device.detail:
            for name, markers in json.loads(device.detail["body_markers"]).items():
                described[name] = np.array(markers, dtype=np.float64).reshape(-1, 3)
    return {name: markers for name, markers in described.items() if len(markers)}


def _body_anchor(start: ChainStart, bodies: TrackedBodies, holder: HolderConfig) -> Floats:
    anchor, name = bodies.place_clamp(holder), holder.name
    n_lost = int(np.isnan(anchor[:, 0]).sum())
    start.facts["Anchor"] = f"{'clamp' if holder.clamp_m else 'centre of gravity'} of the rigid body '{name}'"
    if n_lost:
        start.warnings.append(
            f"The rigid body '{name}' was not tracked in {n_lost} of {len(anchor)} frames: nothing tells where the "
            "cable starts in them."
        )
    return anchor


def _exclude_end(
    start: ChainStart, frames: TrackerFrames, end: EndConfig, bodies: TrackedBodies, table: CycleTable
) -> None:
    """Take out the markers of the cable's other end; those of rigid bodies are out already."""
    if end.kind == "rigid_body":
        bodies.id_of(end.name)
    elif end.kind == "static_marker" and end.position_m is not None:
        marker = _locate(start, frames, end.position_m, table)
        start.usable = exclude_near(frames.points_m, frames.offsets, start.usable, marker.position_m)
    elif end.kind == "static_marker":
        start.warnings.append("[cable.end] has no position_m: its marker is not told from the cable's.")


def _set_static_anchor(start: ChainStart, frames: TrackerFrames, config: Config, table: CycleTable) -> None:
    configured = config.cable.anchor.position_m
    if configured is None:
        settings = make_sort_settings(config)
        scanned = _scanned_frames(frames, table)
        marker = find_static_marker(frames.points_m, frames.offsets, start.usable, scanned, settings)
    else:
        marker = _locate(start, frames, configured, table)
    start.usable = exclude_near(frames.points_m, frames.offsets, start.usable, marker.position_m)
    start.anchor_m = np.broadcast_to(marker.position_m, (len(frames), 3))
    _describe_static(start, marker, config.cable)


def _describe_static(start: ChainStart, marker: StaticMarker, cable: CableConfig) -> None:
    place = ", ".join(f"{value:.4f}" for value in marker.position_m)
    how = "found" if cable.anchor.position_m is None else "configured"
    start.facts["Anchor"] = f"static marker at ({place}) m, {how}, seen in {marker.presence:.0%} of the frames searched"
    if marker.presence < LOW_PRESENCE:
        start.warnings.append(f"The static marker at ({place}) m is seen in only {marker.presence:.0%} of the frames.")


def _go_without_anchor(start: ChainStart, config: Config) -> None:
    start.facts["Anchor"] = "none: the chain is found by its spacings"
    if is_symmetric(make_gates(make_sort_settings(config))):
        start.warnings.append(
            "Without an anchor, spacings that are the same from both ends do not tell which end is first: arc lengths "
            "may count from the other end, and frames with a hidden marker are not sorted."
        )


def _exclude_reflections(start: ChainStart, frames: TrackerFrames, config: Config) -> None:
    found = find_reflections(list_points(frames, start), make_sort_settings(config))
    if len(found.place_m):
        places = "; ".join(", ".join(f"{value:.3f}" for value in place) for place in found.place_m)
        start.facts["Reflections"] = f"points that stand still, left out: {len(found.place_m)}, at ({places}) m"
        start.usable = found.usable


def _locate(
    start: ChainStart, frames: TrackerFrames, position_m: tuple[float, float, float], table: CycleTable
) -> StaticMarker:
    scanned = _scanned_frames(frames, table)
    return locate_static_marker(frames.points_m, frames.offsets, start.usable, scanned, np.array(position_m))


def _scanned_frames(frames: TrackerFrames, table: CycleTable) -> Ints:
    """Return frames spread over the first completed cycles, in which the robot moves; else over the whole take."""
    moving = np.flatnonzero(table.complete)[:SCANNED_CYCLES]
    row = table.locate(frames.time_ns)
    inside = np.flatnonzero(np.isin(row, moving))
    chosen = inside if len(inside) else np.arange(len(frames))
    return chosen[spread_frames(0, len(chosen))]
