"""A calibration in words: the table that ``bench calibrate`` prints."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.report.calibration.run import CalibrationResults
from bench.report.places_text import describe_places

__all__ = ["describe_calibration"]

Floats = npt.NDArray[np.float64]

WIDTH = 26


def describe_calibration(found: CalibrationResults) -> list[str]:
    """Return the lines of the table: transforms, residuals, time offset, markers' places."""
    lines = [*_describe_space(found), *_describe_time(found)]
    if found.calibration.clamp is not None:
        clamp = found.calibration.clamp
        digits = int(np.clip(-np.floor(np.log10(np.deg2rad(max(clamp.direction_sd_deg, 1e-3)) / 3)), 1, 4))
        way = ", ".join(f"{value:.{digits}f}" for value in clamp.direction)
        lines.append(_row("clamp's direction", f"({way}) in the TCP frame, sd {clamp.direction_sd_deg:.2f} degrees"))
    spacing = found.calibration.spacing
    if spacing is not None:
        measured_m, sigma_m = np.array(spacing.marker_arc_length_m), np.array(spacing.sd_mm) * 1e-3
        lines += describe_places(measured_m, sigma_m, found.configured_m)
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
        _row(f"{space.method.removeprefix('rigid ')} in TCP frame", _shift(space.tcp_from_body_shift_m, sigma[9:12])),
    ]
    if space.tcp_from_body_rotation_rad is not None:
        lines.append(_row("", _turn(space.tcp_from_body_rotation_rad, sigma[6:9])))
    return lines


def _describe_time(found: CalibrationResults) -> list[str]:
    time = found.calibration.time
    lines = [_row("tracker's time offset", f"{time.offset_ms:+.3f} ms (sd {time.offset_sd_ms:.3f})")]
    if found.pulse_offset is not None:
        pulses, pose_sd_s = found.pulse_offset, float(found.hand_eye.sigma[12])
        text = f"{pulses.offset_s * 1e3:+.2f} ms (sd {pulses.sigma_s * 1e3:.2f})"
        switchings = f"{pulses.n_agreeing} of {pulses.n_edges} switchings agree"
        lines.append(
            _row("  by the flange's pose", f"{found.hand_eye.offset_s * 1e3:+.3f} ms (sd {pose_sd_s * 1e3:.3f})")
        )
        lines.append(_row("  by the sync lamp", f"{text}, {switchings}"))
    if found.motion_offset is None:
        return [*lines, _row("  by the speed alone", "not told: the speed hardly changes, or repeats itself")]
    alone = found.motion_offset
    text = f"{alone.offset_s * 1e3:+.2f} ms (sd {alone.sigma_s * 1e3:.2f}), speeds agree to {alone.agreement:.1%}"
    return [*lines, _row("  by the speed alone", text)]


def _shift(shift_m: tuple[float, float, float], sigma_m: Floats) -> str:
    place = ", ".join(f"{value * 1e3:.2f}" for value in shift_m)
    return f"({place}) mm, sd {sigma_m.max() * 1e3:.3f} mm"


def _turn(rotation_rad: tuple[float, float, float], sigma_rad: Floats) -> str:
    vector = ", ".join(f"{value:.3f}" for value in np.rad2deg(rotation_rad))
    return f"turned by ({vector}) degrees, sd {np.rad2deg(sigma_rad.max()):.4f} degrees"
