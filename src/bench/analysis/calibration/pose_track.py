"""A pose that was sampled, at any moment between its samples."""

from __future__ import annotations

import numpy as np
import scipy

from bench.analysis.arrays import Bools, Floats
from bench.errors import AnalysisError

__all__ = ["PoseTrack"]

FEWEST_SAMPLES = 4
LONGEST_STEP = 3.0
"""Times the usual step: over a longer gap nothing is interpolated."""


class PoseTrack:
    """The robot's TCP pose as a function of time: cubic splines through positions and quaternions.

    Parameters
    ----------
    time_s : (n,)
        Ascending; samples that do not come later than the one before are left out.
    pose : (n, 6)
        x, y, z (m) and rotation vector (rad) in the base frame; samples with a NaN are left out.

    Raises
    ------
    AnalysisError
        Fewer than four samples have a pose.
    """

    def __init__(self, time_s: Floats, pose: Floats) -> None:
        kept = np.flatnonzero(np.isfinite(pose).all(axis=1))
        kept = kept[np.diff(time_s[kept], prepend=-np.inf) > 0]
        if len(kept) < FEWEST_SAMPLES:
            raise AnalysisError(
                f"The robot's TCP pose is known in {len(kept)} samples; at least {FEWEST_SAMPLES} are needed.",
                hint="A calibration needs a robot that tells its TCP pose.",
            )
        self.time_s = time_s[kept]
        """(m,): moments at which the pose is known."""
        self.usual_step_s = float(np.median(np.diff(self.time_s)))
        quaternion = scipy.spatial.transform.Rotation.from_rotvec(pose[kept, 3:]).as_quat()
        flips = np.where((quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0, -1.0, 1.0)
        quaternion[1:] *= np.cumprod(flips)[:, None]
        self._spline = scipy.interpolate.CubicSpline(self.time_s, np.hstack([pose[kept, :3], quaternion]))

    def covers(self, time_s: Floats) -> Bools:
        """Return for each moment whether the pose is known on both sides of it, without a gap between."""
        after = np.searchsorted(self.time_s, time_s, side="right")
        inside = (after > 0) & (after < len(self.time_s))
        after = np.clip(after, 1, len(self.time_s) - 1)
        return inside & (self.time_s[after] - self.time_s[after - 1] <= LONGEST_STEP * self.usual_step_s)

    def positions_at(self, time_s: Floats) -> Floats:
        """Return the positions (m, 3) at moments (m,), base frame."""
        return np.asarray(self._spline(time_s)[:, :3], dtype=np.float64)

    def at(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Return rotations (m, 3, 3) and positions (m, 3) at moments (m,), base frame."""
        values = self._spline(time_s)
        return scipy.spatial.transform.Rotation.from_quat(values[:, 3:]).as_matrix(), values[:, :3]
