"""The cable's two ends in every frame: where they are and which way they point, as far as what holds them tells."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from bench.analysis import (
    CableEnd,
    ClampDirection,
    ClampedEnds,
    MarkerReason,
    PointFrames,
    RigidTransform,
    get_sorter,
    make_gates,
    place_end,
    spread_frames,
)
from bench.config import Calibration, Config, HolderConfig
from bench.recording import Run
from bench.report.markers import ChainStart, TrackedBodies, make_sort_settings, turn_matrices
from bench.report.results import EndColumns
from bench.report.robot_in_lab import RobotInLab
from bench.report.trace import TracedCable, find_nodes

__all__ = ["AT_THE_TCP", "END_BEND", "CableEnds", "find_cable_ends", "find_up_axis", "verify_end", "warn_of_end_bend"]

END_BEND = "The cable bends most"
"""How the warning begins that names the clamp beside which a bend is read too gently."""

Floats = npt.NDArray[np.float64]

STANDS_STILL = RigidTransform(np.eye(3), np.zeros(3))
KNOWN_EXACTLY = np.zeros((6, 6))
AT_THE_TCP = (0.0, 0.0, 0.0)
SEEN_SIGMA_M = 5e-4
"""Standard deviation of a clamp's place that the tracker sees: 0.12-0.74 mm of noise, and the clamp's drawing."""
CENTRE_SIGMA_M = 0.01
"""Of a body's centre of gravity as the cable's end: its markers sit around the clamp, a centimetre beside the cable."""
COMPARED_FRAMES = 200
"""Spread over the recording, to see whether the last marker is near the end."""
END_SIGMAS = 3.0
ON_CURVE_SIGMA_M = 2e-3
"""Worse known than this, an end's place tells the sorter where to look, but nothing of how the cable bends there."""
STANDS_OUT = 1.1
"""A bend beside an end is told where it is this times the usual one elsewhere: on a cable bent alike all along, noise
alone puts the largest there."""


@dataclass(eq=False)
class CableEnds:
    """Both ends of the cable."""

    anchor: CableEnd | None = None
    """None where nothing tells a place on the cable's curve, nor its direction."""
    end: CableEnd | None = None
    """None without [cable.end], or where what holds it is not known."""
    warnings: list[str] = field(default_factory=list)

    def columns(self, n_frames: int) -> EndColumns | None:
        """Return what is known as columns, None without any."""
        if self.end is None and (self.anchor is None or np.isnan(self.anchor.tangent).all()):
            return None
        unknown = CableEnd(*(np.full((n_frames, 3)[:n], np.nan) for n in (2, 1, 2, 1)))
        anchor, end = self.anchor or unknown, self.end or unknown
        return EndColumns(
            anchor.tangent,
            anchor.tangent_sigma_rad,
            end.position_m,
            end.position_sigma_m,
            end.tangent,
            end.tangent_sigma_rad,
        )

    def describe_unused(self) -> list[str]:
        """Return what to say of ends whose places are known too badly for the curve."""
        return [
            f"The place of [cable.{name}] is known to {1e3 * np.nanmedian(end.position_sigma_m):.0f} mm (standard "
            f"deviation): it guides the sorting, but curvature uses places known to {1e3 * ON_CURVE_SIGMA_M:.0f} mm or "
            "better. Give clamp_m, or calibrate better."
            for name, end in (("anchor", self.anchor), ("end", self.end))
            if end is not None and np.isfinite(end.position_m).any() and np.isnan(_place_on_curve(end)).all()
        ]

    def clamps(self, length_m: float, up_axis: int) -> ClampedEnds:
        """Return what they tell an estimator of the curve; `up_axis` is the lab frame's vertical."""
        x, y, z = np.eye(3)[up_axis]
        return ClampedEnds(_on_curve(self.anchor), _on_curve(self.end), length_m, (x, y, z))


def find_up_axis(run: Run) -> int:
    """Return the lab frame's vertical axis as the tracker names it; y where it does not say."""
    named = [device.detail.get("up_axis", "") for device in run.devices]
    return next(("xyz".index(name) for name in named if name in ("x", "y", "z")), 1)


def find_cable_ends(start: ChainStart, robot: RobotInLab | None, config: Config) -> CableEnds:
    """Find both ends: the anchor's direction by its clamp, the other end by the robot's pose or its rigid body."""
    ends = CableEnds()
    anchor, end = config.cable.anchor, config.cable.end
    if start.anchor_m is not None and start.bodies is not None:
        ends.anchor = _place_held(anchor, start.anchor_m, start.bodies)
    if end is None or start.bodies is None:
        return ends
    if end.kind == "tcp" and robot is not None:
        ends.end = robot.place(end.clamp_m or AT_THE_TCP, _configured(end) or _calibrated(config.calibration.measured))
    elif end.kind == "tcp":
        ends.warnings.append(
            "[cable.end] kind = 'tcp' is not used: it needs a robot that tells its TCP pose, and a calibration "
            "([calibration] file, made by `bench calibrate`)."
        )
    elif end.kind == "rigid_body":
        ends.end = _place_held(end, start.bodies.place_clamp(end), start.bodies)
    return ends


def verify_end(ends: CableEnds, points: PointFrames, config: Config) -> dict[str, str]:
    """Return how well the last marker agrees with the cable's end as a fact; an end that it contradicts is not used.

    A sorter that is given a wrong end finds a chain to it. So the last marker is looked for without it first, in some
    frames: where it usually is out of the end's reach, the end is dropped with a warning.

    Parameters
    ----------
    ends : CableEnds
        Loses `end` if it is contradicted.
    points : PointFrames
        Without the end.
    config : Config
    """
    if ends.end is None:
        return {}
    known = np.flatnonzero(np.isfinite(ends.end.position_m).all(axis=1))
    rows = known[spread_frames(0, len(known), COMPARED_FRAMES)]
    markers = get_sorter("chain")(points.take(rows), make_sort_settings(config))
    chord = np.linalg.norm(ends.end.position_m[rows] - markers.position_m[:, -1], axis=1)
    chord = chord[markers.reason[:, -1] == MarkerReason.FOUND]
    if not len(chord):
        return {"Cable's end": _describe(ends.end)}
    beyond_m = config.cable.length_m - config.cable.arc_length_m[-1]
    gates = make_gates(replace(make_sort_settings(config), arc_length_m=(beyond_m,)))
    usual_m, slack_m = float(np.median(chord)), END_SIGMAS * float(np.nanmedian(ends.end.position_sigma_m[rows]))
    apart = f"last marker {usual_m * 1e3:.1f} mm from it (sd {chord.std() * 1e3:.2f} mm)"
    fact = f"{_describe(ends.end)}; {apart}, {beyond_m * 1e3:.1f} mm of cable by the configuration"
    if not gates.low_m[0] - slack_m <= usual_m <= gates.high_m[0] + slack_m:
        ends.warnings.append(
            f"The last marker is {usual_m * 1e3:.1f} mm from the cable's end, where the configuration has "
            f"{beyond_m * 1e3:.1f} mm of cable, so this end is not used: check length_m, the last marker's place, "
            "clamp_m and the calibration."
        )
        ends.end = None
    return {"Cable's end": fact}


def warn_of_end_bend(ends: CableEnds, traced: TracedCable, bend_map_per_m: Floats) -> list[str]:
    """Return what to say where the cable bends most beside an end of the curve whose direction is not known.

    Up to the next marker nothing shows how the cable bends there, and beside a clamp it bends most.

    Parameters
    ----------
    ends : CableEnds
    traced : TracedCable
    bend_map_per_m : (P, G)
        Median curvature by phase and place; NaN where nothing was seen.
    """
    largest = np.where(np.isfinite(bend_map_per_m), bend_map_per_m, 0.0).max(axis=0, initial=0.0)
    if not largest.any() or "elastica" in traced.curve.method:
        return []
    bend_m = float(traced.arc_length_m[largest.argmax()])
    nodes = find_nodes(traced)
    for holder, end, (last_m, next_m) in (("anchor", ends.anchor, nodes[:2]), ("end", ends.end, nodes[:-3:-1])):
        known = end is not None and bool(np.isfinite(end.tangent).any())
        beside = np.abs(traced.arc_length_m - last_m) < abs(next_m - last_m)
        if not known and beside[largest.argmax()] and largest.max() > STANDS_OUT * np.median(largest[~beside]):
            apart_mm, side = 1e3 * abs(bend_m - last_m), "anchor's" if holder == "anchor" else "far"
            where = f"{apart_mm:.0f} mm from" if apart_mm >= 1 else "at"
            told = (
                f"{END_BEND} {where} the {side} end of its curve: the next marker there is "
                f"{1e3 * abs(next_m - last_m):.0f} mm away, and the direction of the clamp is not known: it may be "
                f"bent tighter there than any interval says. Give [cable.{holder}] clamp_direction, or set markers "
                "closer to that clamp."
            )
            return [told]
    return []


def _describe(end: CableEnd) -> str:
    """Return how well the end is known."""
    place = f"place sd {np.nanmedian(end.position_sigma_m) * 1e3:.2f} mm"
    known = np.isfinite(end.tangent_sigma_rad)
    if not known.any():
        return f"{place}, direction unknown"
    return f"{place}, direction sd {np.rad2deg(np.median(end.tangent_sigma_rad[known])):.2f} degrees"


def _place_held(holder: HolderConfig, place_m: Floats, bodies: TrackedBodies) -> CableEnd:
    """Place an end whose holder the tracker sees, `place_m` (F, 3) being where."""
    turn = np.broadcast_to(np.eye(3), (len(place_m), 3, 3))
    if holder.kind == "rigid_body":
        turn = turn_matrices(bodies.poses(bodies.id_of(holder.name))[1])
    held = place_end(turn, place_m, np.zeros(3), _configured(holder), STANDS_STILL, KNOWN_EXACTLY)
    own_sigma_m = CENTRE_SIGMA_M if holder.kind == "rigid_body" and holder.clamp_m is None else SEEN_SIGMA_M
    return replace(held, position_sigma_m=np.hypot(held.position_sigma_m, own_sigma_m))


def _on_curve(end: CableEnd | None) -> CableEnd | None:
    """Return what is known of an end as a place and direction of the curve; None without either."""
    if end is None:
        return None
    end = replace(end, position_m=_place_on_curve(end))
    return end if np.isfinite(end.position_m).any() or np.isfinite(end.tangent).any() else None


def _place_on_curve(end: CableEnd) -> Floats:
    """Return the end's place (F, 3), NaN where it is too vague for the curve."""
    vague = ~(end.position_sigma_m <= ON_CURVE_SIGMA_M)
    return np.where(vague[:, None], np.nan, end.position_m)


def _configured(holder: HolderConfig) -> ClampDirection | None:
    if holder.clamp_direction is None:
        return None
    direction = np.array(holder.clamp_direction)
    return ClampDirection(direction / np.linalg.norm(direction), float(np.deg2rad(holder.clamp_sd_deg)))


def _calibrated(calibration: Calibration | None) -> ClampDirection | None:
    clamp = calibration.clamp if calibration else None
    if clamp is None:
        return None
    return ClampDirection(np.array(clamp.direction), float(np.deg2rad(clamp.direction_sd_deg)))
