"""What the simulated tracker's cameras see of the cable at one instant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np
import numpy.typing as npt

from bench.config import Config, SimulationConfig
from bench.model import UNLABELED, RigidBody
from bench.simulation.bodies import BODY_SIZE
from bench.simulation.cable import Cable
from bench.simulation.ghosts import Ghosts
from bench.simulation.layout import Layout
from bench.simulation.markers import Markers
from bench.simulation.path import JointPath
from bench.simulation.program import Motion, PathProgram

__all__ = ["Exposure", "Scene", "TruthSink", "make_cable", "make_layout", "make_path"]

CALIBRATION_PROGRAM = "calibrate"
"""A [robot] program of this name, whatever its ending, moves the flange in space and turns it about three axes."""

POINT_CLOUD_SOLVED = 0x02
HAS_MODEL = 0x08
UNLABELED_FLAGS = UNLABELED | POINT_CLOUD_SOLVED
LABELED_FLAGS = HAS_MODEL | POINT_CLOUD_SOLVED
"""NatNet marker parameters as real packets have them: 18 and 10."""
FIRST_LOOSE_ID = 50_001
"""Motive numbers unlabeled points from about here; a real recording has 50007."""
MARKER_SIZE_M = (0.008, 0.011)
RESIDUAL_M = (0.00022, 0.00069)
"""Range of the residual field in a real recording, steady for each marker."""

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
    """(n,): NatNet marker parameters, 0x12 unlabeled, 0x0A labeled."""
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


def make_cable(config: Config, path: JointPath) -> Cable:
    """Solve the cable of a configuration along a path. `ConfigError` if it cannot be simulated."""
    simulation = config.simulation or SimulationConfig()
    return Cable(
        make_layout(config),
        path,
        weight_n_per_m=simulation.weight_n_per_m,
        stiffness_nm2=simulation.bending_stiffness_nm2,
    )


class Scene:
    """The cable's markers, its anchors and the ghosts, seen with noise and gaps, in shuffled order.

    Everything random comes from one generator with the configured seed and depends on the order of exposures only.

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
        self.cable = cable or make_cable(config, program.path)
        self._markers = Markers(config, self.cable)
        self._flange_body = config.calibration.flange_body
        self._noise_m = simulation.noise_mm * 1e-3
        self._miss_probability = simulation.miss_probability
        self._rng = np.random.default_rng(simulation.seed)
        self._ghosts = Ghosts(simulation.ghost_count, self._rng)
        self.bodies = {body.body_id: (body.name, body.markers_m.copy()) for body in self._markers.bodies}
        """Rigid bodies by id: name and (4, 3) marker offsets in the body's own coordinates."""
        self._prepare_points(simulation.ghost_count)

    def expose(self, frame_number: int, host_ns: int) -> Exposure:
        """Return what is seen at `host_ns`, and hand the truth of it to the truth's sink."""
        motion = self._program.motion_at(host_ns)
        markers, n_loose = self._markers, self._markers.n_loose
        true_m = markers.positions_at(motion.place)
        self._new_ids(n_loose + self._ghosts.step(true_m[: markers.n_cable]))
        all_m = np.concatenate([true_m[:n_loose], self._ghosts.positions_m, true_m[n_loose:]])
        noise = self._rng.normal(scale=self._noise_m, size=all_m.shape)
        order = self._rng.permutation(self._see())
        if self.truth is not None:
            self.truth(frame_number, host_ns, motion, self._sources(order))
        return Exposure(
            (all_m + noise)[order].astype(np.float32),
            self._ids[order],
            self._flags[order],
            self._size_m[order],
            self._residual_m[order],
            markers.measure_bodies(motion.place, noise[self._first_member :]),
        )

    def facts(self) -> dict[str, object]:
        """Return what an analysis has to find out, as JSON has it: for the truth file."""
        layout, markers = self.cable.layout, self._markers
        on_flange = next((body for body in markers.bodies if body.name == self._flange_body), None)
        return {
            "base_to_lab": {
                "rotation": layout.lab_rotation.ravel().tolist(),
                "shift_m": layout.lab_shift_m.tolist(),
            },
            "flange_body": on_flange
            and {
                "name": on_flange.name,
                "shift_m": list(on_flange.mount_m),
                "quaternion_xyzw": list(on_flange.mount_xyzw),
            },
            "marker_arc_length_m": markers.arc_length_m.tolist(),
            "marker_side_m": markers.offsets_m[0].tolist(),
            "marker_above_m": markers.offsets_m[1].tolist(),
        }

    def _prepare_points(self, n_ghosts: int) -> None:
        # Every point that can ever be seen has its fixed place: loose markers, ghosts, bodies' markers.
        n_loose, n_bodies = self._markers.n_loose, len(self._markers.bodies)
        self._first_member = n_loose + n_ghosts
        n_points = self._first_member + BODY_SIZE * n_bodies
        self._ids = np.zeros(n_points, dtype=np.uint32)
        self._next_id = FIRST_LOOSE_ID
        self._new_ids(np.arange(self._first_member))
        members = np.arange(1, BODY_SIZE + 1, dtype=np.uint32)
        for index, body in enumerate(self._markers.bodies):
            start = self._first_member + index * len(members)
            self._ids[start : start + len(members)] = (body.body_id << 16) | members
        self._flags = np.full(n_points, UNLABELED_FLAGS, dtype=np.uint32)
        self._flags[self._first_member :] = LABELED_FLAGS
        self._size_m = self._rng.uniform(*MARKER_SIZE_M, n_points).astype(np.float32)
        self._residual_m = self._rng.uniform(*RESIDUAL_M, n_points).astype(np.float32)
        self._visible = np.ones(n_points, dtype=np.bool_)

    def _new_ids(self, points: npt.NDArray[np.intp]) -> None:
        # As Motive does: a point that appears gets a number that was never used.
        if len(points):
            self._ids[points] = np.arange(self._next_id, self._next_id + len(points), dtype=np.uint32)
            self._next_id += len(points)

    def _see(self) -> npt.NDArray[np.intp]:
        """Draw which points are seen; loose markers that come back have new numbers."""
        if self._miss_probability == 0.0:
            return np.arange(len(self._ids))
        n_loose = self._markers.n_loose
        seen = self._rng.random(n_loose) >= self._miss_probability
        self._new_ids(np.flatnonzero(seen & ~self._visible[:n_loose]))
        self._visible[:n_loose] = seen
        return np.flatnonzero(self._visible)

    def _sources(self, order: npt.NDArray[np.intp]) -> npt.NDArray[np.int16]:
        place_in_list = np.full(len(self._ids), -1, dtype=np.int16)
        place_in_list[order] = np.arange(len(order), dtype=np.int16)
        return place_in_list[: self._markers.n_cable]
