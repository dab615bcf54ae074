"""A calibration in words: the table that ``bench calibrate`` prints."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.analysis import MarkerPlaces
from bench.report.calibrating import CalibrationResults

__all__ = ["describe_calibration"]

Floats = npt.NDArray[np.float64]

WIDTH = 26
CLEAR_SIGMAS = 3.0
CLEAR_M = 0.001
"""A marker that sits further than this from its place, beyond noise, is worth correcting: tape is good to 2 mm."""


def describe_calibration(found: CalibrationResults) -> list[str]:
    """Return the lines of the table: transforms, residuals, time offset, markers' places."""
    lines = [*_describe_space(found), *_describe_time(found)]
    if found.calibration.clamp is not None:
        clamp = found.calibration.clamp
        way = ", ".join(f"{value:.4f}" for value in clamp.direction)
        lines.append(_row("clamp's direction", f"({way}) in the TCP frame, sd {clamp.direction_sd_deg:.2f} degrees"))
    if found.places is not None:
        lines += _describe_places(found.places, found.configured_m)
    return [*lines, *(f"warning: {text}" for text in found.warnings)]


def _row(name: str, text: str) -> str:
    return f"{name:<{WIDTH}}{text}"


def _describe_space(found: CalibrationResults) -> list[str]:
    space, sigma = found.calibration.space, found.hand_eye.sigma
    lines = [
        _row(
            "frames",
            f"{found.n_frames}, flange seen in {found.n_seen}, compared {space.n_frames}, "
            f"left out as wrong {space.n_outliers}",
        ),
        _row("residual", f"{space.residual_rms_mm:.3f} mm rms, {space.residual_max_mm:.3f} mm largest"),
        _row("base in lab frame", _shift(space.lab_from_base_shift_m, sigma[3:6])),
        _row("", _turn(space.lab_from_base_rotation_rad, sigma[:3])),
        _row("body in TCP frame", _shift(space.tcp_from_body_shift_m, sigma[9:12])),
    ]
    if space.tcp_from_body_rotation_rad is not None:
        lines.append(_row("", _turn(space.tcp_from_body_rotation_rad, sigma[6:9])))
    return lines


def _describe_time(found: CalibrationResults) -> list[str]:
    time = found.calibration.time
    lines = [_row("tracker's time offset", f"{time.offset_ms:+.3f} ms (sd {time.offset_sd_ms:.3f})")]
    if found.motion_offset is None:
        return [*lines, _row("  by the speed alone", "not told: the speed hardly changes, or repeats itself")]
    alone = found.motion_offset
    text = f"{alone.offset_s * 1e3:+.2f} ms (sd {alone.sigma_s * 1e3:.2f}), speeds agree to {alone.agreement:.1%}"
    return [*lines, _row("  by the speed alone", text)]


def _describe_places(places: MarkerPlaces, configured_m: Floats) -> list[str]:
    apart = places.arc_length_m - configured_m
    lines = [f"{'marker':<8}{'configured':>12}{'measured':>12}{'sd':>9}{'difference':>12}   (mm, from the anchor)"]
    rows = zip(configured_m * 1e3, places.arc_length_m * 1e3, places.sigma_m * 1e3, apart * 1e3, strict=True)
    lines += [f"{i:<8}{was:>12.2f}{now:>12.2f}{sd:>9.3f}{by:>+12.2f}" for i, (was, now, sd, by) in enumerate(rows)]
    wrong = np.flatnonzero(np.abs(apart) > np.maximum(CLEAR_SIGMAS * places.sigma_m, CLEAR_M))
    if len(wrong):
        measured = ", ".join(f"{value:.4f}" for value in places.arc_length_m)
        lines.append(f"{len(wrong)} of {len(apart)} markers sit elsewhere than configured; in [cable] write instead:")
        lines.append(f"marker_arc_length_m = [{measured}]")
    return lines


def _shift(shift_m: tuple[float, float, float], sigma_m: Floats) -> str:
    place = ", ".join(f"{value * 1e3:.2f}" for value in shift_m)
    return f"({place}) mm, sd {sigma_m.max() * 1e3:.3f} mm"


def _turn(rotation_rad: tuple[float, float, float], sigma_rad: Floats) -> str:
    vector = ", ".join(f"{value:.3f}" for value in np.rad2deg(rotation_rad))
    return f"turned by ({vector}) degrees, sd {np.rad2deg(sigma_rad.max()):.4f} degrees"
