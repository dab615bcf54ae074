"""What was found, as the calibration file has it."""

from __future__ import annotations

from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import PurePath

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from bench.analysis import ClampDirection, HandEye, MarkerPlaces, PulseOffset
from bench.config import Calibration, ClampCalibration, SpaceCalibration, SpacingCalibration, TimeCalibration
from bench.recording import Run

__all__ = ["describe_findings"]

Floats = npt.NDArray[np.float64]
Triple = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]
SixBySix = tuple[Six, Six, Six, Six, Six, Six]


def describe_findings(
    run: Run,
    tcp_offset: Floats,
    found: HandEye,
    by_pulses: PulseOffset | None,
    places: MarkerPlaces | None,
    clamp: ClampDirection | None,
) -> Calibration:
    """Return a calibration's content; its time is what is known best."""
    return Calibration(
        run_file=PurePath(run.path).name,
        run_id=run.run_id,
        created_utc=datetime.now(tz=UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        bench_version=version("cable-bench"),
        time=_describe_time(found, by_pulses),
        space=_describe_space(found, tcp_offset),
        spacing=_describe_places(places) if places else None,
        clamp=_describe_clamp(clamp) if clamp else None,
    )


def _describe_time(found: HandEye, by_pulses: PulseOffset | None) -> TimeCalibration:
    if by_pulses is not None and not found.sigma[12] <= by_pulses.sigma_s:
        return TimeCalibration(offset_ms=by_pulses.offset_s * 1e3, offset_sd_ms=by_pulses.sigma_s * 1e3)
    return TimeCalibration(offset_ms=found.offset_s * 1e3, offset_sd_ms=float(found.sigma[12]) * 1e3)


def _describe_places(places: MarkerPlaces) -> SpacingCalibration:
    return SpacingCalibration(
        marker_arc_length_m=tuple(np.round(places.arc_length_m, 6).tolist()),
        sd_mm=tuple(np.round(places.sigma_m * 1e3, 4).tolist()),
    )


def _describe_clamp(clamp: ClampDirection) -> ClampCalibration:
    return ClampCalibration(direction=_triple(clamp.direction), direction_sd_deg=float(np.rad2deg(clamp.sigma_rad)))


def _describe_space(found: HandEye, tcp_offset: Floats) -> SpaceCalibration:
    used = found.residual_m[found.used]
    has_body = bool(np.isfinite(found.sigma[6:9]).all())
    lab, body = found.lab_from_base, found.tcp_from_body
    return SpaceCalibration(
        method="rigid body" if has_body else "marker",
        lab_from_base_rotation_rad=_triple(Rotation.from_matrix(lab.rotation).as_rotvec()),
        lab_from_base_shift_m=_triple(lab.shift_m),
        lab_from_base_covariance=_matrix(found.covariance[:6, :6]),
        tcp_from_body_rotation_rad=_triple(Rotation.from_matrix(body.rotation).as_rotvec()) if has_body else None,
        tcp_from_body_shift_m=_triple(body.shift_m),
        tcp_from_body_sd_mm=_triple(found.sigma[9:12] * 1e3),
        tcp_offset=_six(tcp_offset) if np.isfinite(tcp_offset).all() else None,
        residual_rms_mm=float(np.sqrt(np.mean(used**2))) * 1e3,
        residual_max_mm=float(used.max()) * 1e3,
        n_frames=int(np.isfinite(found.residual_m).sum()),
        n_outliers=int(np.isfinite(found.residual_m).sum() - found.used.sum()),
    )


def _triple(values: Floats) -> Triple:
    x, y, z = values.tolist()
    return x, y, z


def _matrix(values: Floats) -> SixBySix:
    a, b, c, d, e, f = (_six(row) for row in values)
    return a, b, c, d, e, f


def _six(values: Floats) -> Six:
    a, b, c, d, e, f = values.tolist()
    return a, b, c, d, e, f
