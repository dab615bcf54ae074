"""What the simulated tracker's cameras see of the cable at one instant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import PurePath

import numpy as np
import numpy.typing as npt

from bench.config import Config, SimulationConfig
from bench.model import RigidBody
from bench.simulation.bodies import BODY_SIZE
from bench.simulation.cable import Cable
from bench.simulation.ghosts import Ghosts, draw_reflections
from bench.simulation.layout import Layout
from bench.simulation.markers import Markers
from bench.simulation.path import JointPath
from bench.simulation.points import Points
from bench.simulation.program import PULSE_PHASE, Motion, PathProgram
from bench.simulation.sight import Occlusion, SelfOcclusion
from bench.simulation.wear import LEVELS, Wear, WearTable

__all__ = ["Exposure", "Scene", "TruthSink", "make_cable", "make_layout", "make_path"]

CALIBRATION_PROGRAM = "calibrate"
"""A [robot] program of this name, whatever its ending, moves the flange in space and turns it about three axes."""

WORN_STIFFNESS = 0.5
"""Of the new cable's stiffness: what a worn one has."""
FEWEST_MEMBERS = 3
"""A body of which fewer markers are seen is not tracked."""

TruthSink = Callable[[int, int, Motion, npt.NDArray[np.int16]], None]
"""Takes frame number, mid-exposure host time, motion, and the index of each of the cable's markers in the frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """All points of one frame, in the order in which the tracker sends them."""

    points_m: npt.NDArray[np.float32]
    """(n, 3): lab frame."""
    ids: npt.NDArray[np.uint32]
    """(n,): body << 16 | member for a rigid body's marker; else a number that changes after each gap."""
    flags: npt.NDArray[np.uint32]
    """(n,): NatNet marker parameters, 0x12 unlabeled, 0x0A labeled, 0x0B labeled and filled in."""
    size_m: npt.NDArray[np.float32]
    residual_m: npt.NDArray[np.float32]
    bodies: tuple[RigidBody, ...]


def make_layout(config: Config) -> Layout:
    """Return where everything stands for a configuration; its anchor is where `position_m` says, if it does."""
    return Layout(config.cable.length_m, config.cable.anchor.position_m)


def make_path(config: Config) -> JointPath:
    """Return the path that the program of a configuration goes along."""
    layout = make_layout(config)
    calibrates = config.robot is not None and PurePath(config.robot.program).stem == CALIBRATION_PROGRAM
    return JointPath(layout.path_amplitude, layout.swing if calibrates else None)


def make_cable(config: Config, path: JointPath, wear: float = 0.0) -> Cable:
    """Solve a configuration's cable along a path, at a share of its wear. `ConfigError` if it cannot be simulated."""
    simulation = config.simulation or SimulationConfig()
    return Cable(
        make_layout(config),
        path,
        weight_n_per_m=simulation.weight_n_per_m,
        stiffness_nm2=simulation.bending_stiffness_nm2 * (1.0 + (WORN_STIFFNESS - 1.0) * wear),
    )


def _make_wear(config: Config, path: JointPath, cable: Cable | None) -> Wear:
    n_cycles = (config.simulation or SimulationConfig()).half_stiffness_after_cycles
    worn = LEVELS[1:] if n_cycles else ()
    return Wear([cable or make_cable(config, path), *(make_cable(config, path, level) for level in worn)], n_cycles)


class Scene:
    """The cable's markers, its anchors, ghosts and reflections, seen with noise and gaps.

    Everything random comes from the configured seed and depends on the order of exposures only.

    Parameters
    ----------
    config : Config
        Cable and simulation; without a ``[simulation]`` table its defaults.
    program : PathProgram
        Tells where the robot is.
    cable : Cable, optional
        Left out, it is solved here (a tenth of a second).
    truth : TruthSink, optional
        Is given what the scene knows of each exposure.
    """

    def __init__(
        self, config: Config, program: PathProgram, *, cable: Cable | None = None, truth: TruthSink | None = None
    ) -> None:
        simulation = config.simulation or SimulationConfig()
        self._program = program
        self.truth = truth
        """May be given before the first exposure."""
        self._wear = wear = _make_wear(config, program.path, cable)
        self.cable = wear.new
        self._markers = markers = Markers(config, self.cable)
        self._true = wear.tabulate(lambda one: markers.table if one is wear.new else Markers(config, one).table)
        self._flange_body = config.calibration.flange_body
        pulses = config.robot is not None and config.robot.cycle.digital_output_mode == "pulse"
        self._lit_until = PULSE_PHASE if pulses else 2.0
        self.bodies = {body.body_id: (body.name, body.markers_m.copy()) for body in markers.bodies}
        """Rigid bodies by id: name and (4, 3) marker offsets in the body's own coordinates."""
        self._last_bodies: dict[int, RigidBody] = {}
        self._rng = np.random.default_rng(simulation.seed)
        self._prepare_sight(simulation)
        self._prepare_points(simulation)

    def expose(self, frame_number: int, host_ns: int) -> Exposure:
        """Return what is seen at `host_ns`, and hand the truth of it to the truth's sink."""
        motion = self._program.motion_at(host_ns)
        points, n_loose = self._points, self._points.n_loose
        true_m = self._true.at(motion.place, motion.cycles_driven)
        if len(self._ghosts.positions_m):
            points.renew(n_loose + self._ghosts.step(true_m[: self._markers.n_cable]))
        all_m = np.concatenate([true_m[:n_loose], self._ghosts.positions_m, self._reflections_m, true_m[n_loose:]])
        noise = self._rng.standard_normal(all_m.shape) * self._noise_m
        bodies = self._hide(motion, noise[points.first_member :])
        order = points.order()
        if self.truth is not None:
            self.truth(frame_number, host_ns, motion, self._sources(order))
        return Exposure(
            (all_m + noise)[order].astype(np.float32),
            points.ids[order],
            points.flags[order],
            points.size_m[order],
            points.residual_m[order],
            bodies,
        )

    def curvature(self, arc_length_m: npt.NDArray[np.float64]) -> WearTable:
        """Return the cable's signed curvature (G,), 1/m, at G arc lengths, anywhere on the path and in its life."""
        return self._wear.tabulate(lambda cable: cable.curvature(arc_length_m))

    def facts(self) -> dict[str, object]:
        """Return what an analysis has to find out, as JSON has it: for the truth file."""
        layout, markers = self.cable.layout, self._markers
        on_flange = next((body for body in markers.bodies if body.name == self._flange_body), None)
        base_to_lab = {"rotation": layout.lab_rotation.ravel().tolist(), "shift_m": layout.lab_shift_m.tolist()}
        return {
            "base_to_lab": base_to_lab,
            "flange_body": None if on_flange is None else on_flange.facts(),
            "marker_arc_length_m": markers.arc_length_m.tolist(),
            "marker_side_m": markers.offsets_m[0].tolist(),
            "marker_above_m": markers.offsets_m[1].tolist(),
        }

    def _prepare_sight(self, simulation: SimulationConfig) -> None:
        markers = self._markers
        self._occlusion = Occlusion(simulation, markers.n_loose, self._rng)
        self._shadow: SelfOcclusion | None = None
        if simulation.camera_count:
            layout, path = self.cable.layout, self._program.path
            self._shadow = SelfOcclusion(simulation.camera_count, layout, path, markers.table)
        self._ghosts = Ghosts(simulation.ghost_count, simulation.ghost_near_share, self._rng)
        start_m = markers.table.at(0.0)[: markers.n_cable]
        self._reflections_m = draw_reflections(simulation.reflection_count, start_m, self._rng)

    def _prepare_points(self, simulation: SimulationConfig) -> None:
        n_loose, n_ghosts = self._markers.n_loose, simulation.ghost_count
        self._points = Points(
            n_loose,
            n_ghosts,
            simulation.reflection_count,
            list(self.bodies),
            shuffles=simulation.point_order == "shuffle",
            rng=self._rng,
        )
        self._noise_m = np.full((len(self._points), 1), simulation.noise_mm * 1e-3)
        shaky_mm = np.hypot(simulation.noise_mm, simulation.reflection_jitter_mm)
        self._noise_m[n_loose + n_ghosts : self._points.first_member] = shaky_mm * 1e-3

    def _hide(self, motion: Motion, members_noise_m: npt.NDArray[np.float64]) -> tuple[RigidBody, ...]:
        """Hide what is hidden in this frame and return the bodies as the tracker sees them."""
        place, hidden = motion.place, self._occlusion.step()
        if self._markers.lamp_m is not None and not self._is_lit(motion):
            hidden = hidden.copy()
            hidden[-1] = True
        if self._shadow is None:
            self._points.hide(hidden)
            return self._markers.measure_bodies(place, members_noise_m)
        shadow = self._shadow.at(place)
        n_loose = self._points.n_loose
        self._points.hide(hidden | shadow[:n_loose])
        # What the tracker fills in for a hidden marker of a body follows from the others.
        members_noise_m[shadow[n_loose:]] = 0.0
        lost = shadow[n_loose:].reshape(-1, BODY_SIZE).sum(axis=1) > BODY_SIZE - FEWEST_MEMBERS
        self._points.hide_members(shadow[n_loose:], lost)
        bodies = self._markers.measure_bodies(place, members_noise_m)
        return tuple(self._track(body, bool(is_lost)) for body, is_lost in zip(bodies, lost, strict=True))

    def _is_lit(self, motion: Motion) -> bool:
        """Tell whether the digital output that switches the lamp is high."""
        return motion.cycle_running == 1 and motion.phase < self._lit_until

    def _track(self, body: RigidBody, is_lost: bool) -> RigidBody:
        """Return a body, or its last pose and that it is not tracked."""
        if is_lost:
            return replace(self._last_bodies.get(body.body_id, body), tracking_valid=False)
        self._last_bodies[body.body_id] = body
        return body

    def _sources(self, order: npt.NDArray[np.intp]) -> npt.NDArray[np.int16]:
        place_in_list = np.full(len(self._points), -1, dtype=np.int16)
        place_in_list[order] = np.arange(len(order), dtype=np.int16)
        return place_in_list[: self._markers.n_cable]
