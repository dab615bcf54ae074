"""Where everything stands: pole, robot and the tracker's coordinate system."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.errors import ConfigError
from bench.simulation.kinematics import D_M
from bench.simulation.path import BASE_JOINT_RAD, FLANGE_CENTRE_M, Swing

__all__ = ["POLE_CLAMP_RAD", "Layout"]

Floats = npt.NDArray[np.float64]

SHORTEST_M, LONGEST_M = 0.3, 6.0
"""Between them the scaled layout gives a hanging cable; 6 m is a pole 3.7 m from the flange."""
FULL_SIZE_M = 1.2
"""From this length on the robot makes its whole path; for shorter cables the path shrinks with the cable."""
SPAN_RATIO = 0.62
"""Distance between pole and the middle of the path over the cable's length: slack enough to bend, never taut."""
POLE_RISE_RATIO = 0.05
"""The pole's clamp is higher than the middle of the path by this share of the cable's length."""
POLE_CLAMP_RAD = -0.8
"""The cable leaves the pole towards the robot and down: with the tool's swing, min radii of 90 to 250 mm at 1.2 m."""
WIDEST_SWING_RAD = 0.25
WIDEST_SWING_M = 0.2
"""How far a calibration swings the flange to either side of its plane: within the arm's reach, however far the pole."""
LAB_HEADING_RAD = 2.1
"""Turn of the lab frame about the vertical against the base frame."""
LAB_FROM_BASE_M = (1.31, 1.62, -0.47)
"""Lab position of the base frame's origin: the robot stands on a 1.6 m column, so that 3 m of cable clear the floor."""


@dataclass(frozen=True, slots=True)
class Layout:
    """The bench for a cable of given length.

    The lab frame is OptiTrack's: Y is up. It differs from the base frame (Z is up) by one fixed turn and shift.
    """

    length_m: float
    anchor_m: tuple[float, float, float] | None = None
    """Lab position the pole's clamp must have; the lab frame is shifted to suit. None: wherever it comes to be."""

    def __post_init__(self) -> None:
        if not SHORTEST_M <= self.length_m <= LONGEST_M:
            raise ConfigError(
                f"[cable] length_m = {self.length_m:g} does not fit the simulated bench, "
                f"which takes cables of {SHORTEST_M:g} to {LONGEST_M:g} m.",
                hint="Choose a length in that range for a simulated run.",
            )

    @property
    def path_amplitude(self) -> float:
        """Amplitude of `bench.simulation.path.JointPath`."""
        return min(1.0, self.length_m / FULL_SIZE_M)

    @property
    def pole_in_plane_m(self) -> tuple[float, float]:
        """Clamp of the pole in plane coordinates (`bench.simulation.path`)."""
        x, y = FLANGE_CENTRE_M
        return x - SPAN_RATIO * self.length_m, y + POLE_RISE_RATIO * self.length_m

    @property
    def middle_m(self) -> Floats:
        """(3,): half-way between pole and the middle of the path, lab frame."""
        return self.plane_to_lab((np.array(self.pole_in_plane_m) + FLANGE_CENTRE_M) / 2.0)

    @property
    def swing(self) -> Swing:
        """How the path swings about the pole in a calibration."""
        x, y, _ = _plane_to_base(np.array(self.pole_in_plane_m)).tolist()
        return Swing((x, y), min(WIDEST_SWING_RAD, WIDEST_SWING_M / (SPAN_RATIO * self.length_m)))

    @property
    def lab_rotation(self) -> Floats:
        """(3, 3): turns base frame vectors into lab frame vectors."""
        c, s = np.cos(LAB_HEADING_RAD), np.sin(LAB_HEADING_RAD)
        heading = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        z_up_to_y_up = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        return np.asarray(heading @ z_up_to_y_up)

    @property
    def up(self) -> Floats:
        """(3,): upwards in the lab frame."""
        return np.asarray(self.lab_rotation[:, 2])

    @property
    def ahead(self) -> Floats:
        """(3,): horizontal in the lab frame, from the pole to the robot."""
        return np.asarray(self.lab_rotation @ np.array([np.cos(BASE_JOINT_RAD), np.sin(BASE_JOINT_RAD), 0.0]))

    @property
    def lab_shift_m(self) -> Floats:
        """(3,): lab position of the base frame's origin."""
        if self.anchor_m is None:
            return np.array(LAB_FROM_BASE_M)
        return np.array(self.anchor_m) - self.lab_rotation @ _plane_to_base(np.array(self.pole_in_plane_m))

    def base_to_lab(self, points_m: Floats) -> Floats:
        """Map (..., 3) points from the base frame to the lab frame."""
        return np.asarray(points_m @ self.lab_rotation.T + self.lab_shift_m)

    def plane_to_lab(self, points_m: Floats) -> Floats:
        """Map (..., 2) plane coordinates to (..., 3) points in the lab frame."""
        return self.base_to_lab(_plane_to_base(points_m))


def _plane_to_base(points_m: Floats) -> Floats:
    # The wrist's offset d4 puts the plane beside the base joint's axis.
    c, s = np.cos(BASE_JOINT_RAD), np.sin(BASE_JOINT_RAD)
    along, up, normal = np.array([c, s, 0.0]), np.array([0.0, 0.0, 1.0]), np.array([s, -c, 0.0])
    return np.asarray(points_m[..., :1] * along + points_m[..., 1:] * up + D_M[3] * normal)
