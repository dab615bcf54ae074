"""What ties the tracker's space and time to the robot's, as ``bench calibrate`` measured it."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bench.config.section import Section

__all__ = [
    "Calibration",
    "CalibrationConfig",
    "ClampCalibration",
    "SpaceCalibration",
    "SpacingCalibration",
    "TimeCalibration",
]

Triple = Annotated[tuple[float, float, float], Field(strict=False)]
Six = Annotated[tuple[float, float, float, float, float, float], Field(strict=False)]
SixBySix = Annotated[tuple[Six, Six, Six, Six, Six, Six], Field(strict=False)]
Lengths = Annotated[tuple[Annotated[float, Field(ge=0)], ...], Field(strict=False)]


class TimeCalibration(Section):
    """The constant between both devices' clocks."""

    offset_ms: float = Field(ge=-1e4, le=1e4, description="Is added to the tracker's times.")
    offset_sd_ms: float = Field(ge=0, description="Standard deviation of the offset.")


class SpaceCalibration(Section):
    """Where the robot stands in the lab frame, and the body in the TCP's."""

    method: Literal["rigid body", "marker"] = Field(description="What was seen on the flange.")
    lab_from_base_rotation_rad: Triple = Field(description="Rotation vector from the robot's base frame to the lab's.")
    lab_from_base_shift_m: Triple = Field(description="Origin of the robot's base frame in the lab frame.")
    lab_from_base_covariance: SixBySix = Field(
        description="Of a small turn about the lab frame's axes (rad) and of the shift (m), in this order."
    )
    tcp_from_body_rotation_rad: Triple | None = Field(
        None, description="Rotation vector from the body's frame to the TCP's."
    )
    tcp_from_body_shift_m: Triple = Field(description="The body's origin, or the marker, in the TCP frame.")
    tcp_from_body_sd_mm: Triple = Field(description="Standard deviation of its coordinates.")
    tcp_offset: Six | None = Field(
        None, description="The TCP in the flange frame, as set on the controller (m, rad): the TCP frame that is meant."
    )
    residual_rms_mm: float = Field(ge=0, description="Distance between both devices' positions, root mean square.")
    residual_max_mm: float = Field(ge=0, description="The largest that was used.")
    n_frames: int = Field(ge=1, description="Frames compared.")
    n_outliers: int = Field(ge=0, description="Of these, left out as wrong.")


class SpacingCalibration(Section):
    """Where the markers sit on the cable, by the tracker: what [cable] marker_arc_length_m should say."""

    marker_arc_length_m: Lengths = Field(description="Arc length of each marker from the anchor.")
    sd_mm: Lengths = Field(description="Standard deviation of each.")


class ClampCalibration(Section):
    """Which way the clamp on the robot holds the cable."""

    direction: Triple = Field(description="Unit vector from the clamp into the free cable, in the TCP frame.")
    direction_sd_deg: float = Field(gt=0, description="Standard deviation of its angle.")


class Calibration(Section):
    """A calibration file."""

    format: Literal[1] = Field(1, description="Version of the file's layout.")
    run_file: str = Field(description="The recording it was measured from.")
    run_id: str = Field(description="Its run id.")
    created_utc: str = Field(description="When it was calculated.")
    bench_version: str = Field(description="By which version of bench.")
    time: TimeCalibration
    space: SpaceCalibration
    spacing: SpacingCalibration | None = None
    clamp: ClampCalibration | None = None


class CalibrationConfig(Section):
    """What the cameras see of the robot, and the calibration measured with it."""

    flange_body: str = Field(
        "", max_length=200, description="Rigid body that is fixed to the flange, by its name in the tracker's software."
    )
    flange_marker_m: Triple | None = Field(
        None,
        description="Instead of a body: lab-frame position, at the beginning of a calibration run and to 30 mm, of a "
        "single marker that is fixed to the flange.",
    )
    sync_output: int | None = Field(
        None,
        ge=0,
        le=63,
        description="Digital output of the robot that switches a lamp which the cameras see as a marker: bench "
        "calibrate finds the time offset from its pulses too, and takes what is known better.",
    )
    sync_marker_m: Triple | None = Field(None, description="Lab-frame position of that lamp, to 10 mm.")
    file: str = Field(
        "", max_length=1000, description="File written by 'bench calibrate', relative to this configuration's folder."
    )
    measured: Calibration | None = Field(
        None, description="Content of that file: put here when the configuration is read, so that it travels in runs."
    )

    @model_validator(mode="after")
    def _one_thing_is_on_the_flange(self) -> Self:
        if self.flange_body and self.flange_marker_m is not None:
            raise ValueError("give flange_body or flange_marker_m, not both")
        return self

    @model_validator(mode="after")
    def _the_lamp_is_described_whole(self) -> Self:
        if (self.sync_output is None) != (self.sync_marker_m is None):
            raise ValueError("sync_output and sync_marker_m belong together: what switches the lamp, and where it is")
        return self

    @property
    def offset_s(self) -> float:
        """Is added to the tracker's times; 0 without a calibration."""
        return self.measured.time.offset_ms * 1e-3 if self.measured else 0.0
