"""The configuration file as data. Keys carry their unit; every default carries its reason.

``bench config schema`` prints the JSON schema of these models.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, Tag, field_validator, model_validator

from bench.config.calibration import CalibrationConfig
from bench.config.modbus import ModbusRobotConfig
from bench.config.policy import PolicyConfig
from bench.config.section import PROGRAM_FILE, Section, choose_by_kind
from bench.config.simulation import SimulationConfig
from bench.config.tracker import AnyTrackerConfig

__all__ = [
    "AnalysisConfig",
    "AnchorConfig",
    "AnyRobotConfig",
    "CableConfig",
    "Config",
    "CycleConfig",
    "EndConfig",
    "HolderConfig",
    "RobotConfig",
    "RunConfig",
]

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._-]*$"
Name = Annotated[str, Field(pattern=NAME_PATTERN, max_length=80)]
Register = Annotated[int, Field(ge=0, le=47)]
ArcLengths = Annotated[tuple[Annotated[float, Field(ge=0, strict=True)], ...], Field(strict=False)]
Joints = Annotated[tuple[float, float, float, float, float, float], Field(strict=False)]
Point = Annotated[tuple[float, float, float], Field(strict=False)]


SMALLEST_PART_MB = 1.0
"""Some seconds of recording: ending a part costs a handful of syncs, which must not be most of what the disk does."""


class RunConfig(Section):
    """What the run is called and where its file goes."""

    name: Name = Field("run", description="Goes into file names.")
    sample_id: str = Field("", max_length=200, description="Whatever identifies the cable under test.")
    operator: str = Field("", max_length=200, description="Who is responsible for the test.")
    output_dir: str = Field("runs", description="Folder of the run file when --output is left out.")
    split_mb: float = Field(
        0.0,
        ge=0,
        le=1_000_000,
        description="Size from which on the recording goes on in another file, NAME.2.mcap and so on, 1 MB at least; "
        "all are read as one run. 0: it stays in one file.",
    )
    first_cycle_speed: float = Field(
        1.0,
        ge=0.02,
        le=1,
        description="Where the speed slider stands in the first cycle after each start, so that somebody can watch it; "
        "then it is set back to where it was. 1: it is left alone. Below 0.02 a controller may stop protectively.",
    )

    @field_validator("split_mb")
    @classmethod
    def _parts_last(cls, split_mb: float) -> float:
        if 0 < split_mb < SMALLEST_PART_MB:
            raise ValueError(f"a part has {SMALLEST_PART_MB:g} MB at least; 0: the recording is not split")
        return split_mb

    @property
    def split_bytes(self) -> int:
        """Size in bytes from which on the recording goes on in another file; 0: never."""
        return round(self.split_mb * 1e6)


class CycleConfig(Section):
    """How the robot's program says which cycle it is in, and how it is allowed to begin one."""

    source: Literal["counter", "digital_output", "joint_return"] = Field(
        "counter",
        description="How cycles show: a counter register, a digital output, or the joints' return to the start pose.",
    )
    grant: bool | None = Field(
        None,
        description="Whether the program waits for a grant before each cycle; left out: only with a counter.",
    )
    counter_register: Register = Field(
        24, alias="register", description="output_int_register: cycles completed since the program started."
    )
    running_register: Register = Field(25, description="output_int_register: 1 while on the path, 0 while waiting.")
    grant_register: Register = Field(24, description="input_int_register: cycles the program may have begun.")
    phase_register: Register | None = Field(
        None, description="output_double_register: place on the path, 0 to 1, if the program writes it."
    )
    digital_output: int | None = Field(
        None, ge=0, le=17, description="Output of 'digital_output': 0-7 standard, 8-15 configurable, 16-17 tool."
    )
    digital_output_mode: Literal["level", "pulse"] = Field(
        "level", description="'level': high on the path, low while waiting; 'pulse': rises once at each start."
    )
    joint_tolerance_deg: float = Field(
        0.5, gt=0, le=20, description="How near to the start pose each joint must be for 'joint_return'."
    )
    start_joints_deg: Joints | None = Field(
        None, description="Start pose of 'joint_return'; left out: where the robot stands when the program starts."
    )
    timeout_s: float = Field(
        600.0, gt=0, le=86_400, description="Longest time for one cycle before the run gives up: 10 minutes."
    )

    @property
    def is_granted(self) -> bool:
        """Whether the program waits for a grant before each cycle."""
        return self.source == "counter" if self.grant is None else self.grant

    @model_validator(mode="after")
    def _registers_differ(self) -> CycleConfig:
        if self.counter_register == self.running_register:
            raise ValueError("register and running_register are both output_int_register: they must differ")
        return self

    @model_validator(mode="after")
    def _fits_its_source(self) -> CycleConfig:
        belongs = {
            "digital_output": ("digital_output", "digital_output_mode"),
            "joint_return": ("joint_tolerance_deg", "start_joints_deg"),
        }
        for source, keys in belongs.items():
            for key in keys:
                if self.source != source and getattr(self, key) != type(self).model_fields[key].default:
                    raise ValueError(f"{key} belongs to source = '{source}', not to '{self.source}'")
        if self.source == "digital_output" and self.digital_output is None:
            raise ValueError("source = 'digital_output' needs digital_output = N, the output's number")
        return self

    @model_validator(mode="after")
    def _can_be_granted(self) -> CycleConfig:
        if self.source == "counter" and not self.is_granted:
            raise ValueError("grant = false does not fit source = 'counter': a program that counts waits for its grant")
        if self.is_granted and self.digital_output_mode == "pulse":
            raise ValueError(
                "grant = true does not fit digital_output_mode = 'pulse': there the next start ends a cycle, "
                "and it would wait for a grant that waits for the end"
            )
        return self


class RobotConfig(Section):
    """A Universal Robots controller."""

    kind: Literal["ur"] = Field("ur", description="Universal Robots: state by RTDE, program as program_control says.")
    host: str = Field(min_length=1, description="Address of the controller.")
    program: str = Field(min_length=1, description="Program on the controller, such as bend_test.urp.")
    program_file: str = Field("", max_length=1000, description=PROGRAM_FILE)
    rate_hz: float = Field(500.0, ge=1, le=500, description="State samples a second; CB3 controllers give 125.")
    rtde_port: int = Field(30004, ge=1, le=65535, description="Port of the state stream.")
    program_control: Literal["auto", "dashboard", "robot_api"] = Field(
        "auto",
        description="Who loads, starts and stops the program. 'auto': PolyScope X (version 10 and later) by its Robot "
        "API, CB3 and PolyScope 5 by their dashboard.",
    )
    robot_api_port: int = Field(80, ge=1, le=65535, description="HTTP port of PolyScope X, where its Robot API is.")
    cycle: CycleConfig = Field(default_factory=CycleConfig)


AnyRobotConfig = Annotated[
    Annotated[RobotConfig, Tag("ur")] | Annotated[ModbusRobotConfig, Tag("modbus")], choose_by_kind("ur", "modbus")
]


class HolderConfig(Section):
    """What holds the cable at a known place."""

    kind: str
    position_m: Point | None = Field(
        None, description="Lab-frame position of the static marker; left out: found in the first frames."
    )
    name: str = Field("", description="Name of the rigid body, as in the tracker's software.")
    clamp_direction: Point | None = Field(
        None,
        description="Which way the clamp holds the cable, from the clamp into the free cable: in the frame of the "
        "rigid body or the TCP, of a static marker's clamp in the lab frame.",
    )
    clamp_sd_deg: float = Field(
        2.0, gt=0, le=45, description="Standard deviation of clamp_direction; 2 degrees: by a ruler."
    )
    clamp_m: Point | None = Field(
        None,
        description="Where the cable leaves its clamp, in the frame of the rigid body or the TCP. Left out: at the "
        "TCP; at the centre of gravity of the body's markers, which is beside the cable and no place on its curve.",
    )

    @model_validator(mode="after")
    def _fits_its_kind(self) -> Self:
        if self.kind == "rigid_body" and not self.name:
            raise ValueError("kind = 'rigid_body' needs name = '…', the rigid body's name in the tracker's software")
        if self.kind != "rigid_body" and self.name:
            raise ValueError(f"name belongs to kind = 'rigid_body', not to '{self.kind}'")
        if self.kind != "static_marker" and self.position_m is not None:
            raise ValueError(f"position_m belongs to kind = 'static_marker', not to '{self.kind}'")
        if self.kind not in ("rigid_body", "tcp") and self.clamp_m is not None:
            raise ValueError(f"clamp_m belongs to what moves (kind = 'rigid_body' or 'tcp'), not to '{self.kind}'")
        return self

    @model_validator(mode="after")
    def _direction_has_a_length(self) -> Self:
        if self.clamp_direction is not None and not any(self.clamp_direction):
            raise ValueError("clamp_direction is a vector of any length but zero")
        if self.clamp_direction is not None and self.kind == "none":
            raise ValueError("clamp_direction needs something that holds the cable, not kind = 'none'")
        return self


class AnchorConfig(HolderConfig):
    """A known place on the cable, fixed in the lab or on a rigid body."""

    kind: Literal["static_marker", "rigid_body", "none"] = Field(description="The paper's two cases, or no anchor.")


class EndConfig(HolderConfig):
    """The cable's other end."""

    kind: Literal["static_marker", "rigid_body", "tcp", "none"] = Field(
        description="As for the anchor; 'tcp': from the robot's TCP pose, by the calibration."
    )


class CableConfig(Section):
    """The cable, its markers and its catalogue limit."""

    length_m: float = Field(gt=0, le=100, description="Length between the two clamps.")
    diameter_mm: float = Field(gt=0, le=500, description="Outer diameter.")
    marker_arc_length_m: ArcLengths | None = Field(
        None, description="Arc length of each marker from the anchor, ascending."
    )
    marker_count: int | None = Field(None, ge=1, le=500, description="With marker_spacing_m: evenly spaced markers.")
    marker_spacing_m: float | None = Field(
        None, gt=0, le=10, description="Distance from the anchor to the first marker, and between markers."
    )
    stretch: float = Field(
        0.02, ge=0, le=1, description="e1 / D of the paper: how much a distance may grow. 2 % covers placement errors."
    )
    axial_stiffness_n: float | None = Field(
        None, gt=0, description="EA; with max_tension_n gives stretch by Hooke's law."
    )
    max_tension_n: float | None = Field(None, ge=0, description="Largest tension in the test.")
    shorten: float = Field(
        0.25, ge=0, lt=1, description="e2 / D of the paper: how much a chord may shorten. Soft cables reach 0.20-0.30."
    )
    max_speed_m_s: float | None = Field(
        None,
        gt=0,
        le=100,
        description="Speed of the fastest marker when the robot drives at full speed; left out: not known, and the "
        "frame rate not checked. 'bench check --cycle' measures it; twice the speed of the TCP is the paper's guess.",
    )
    minimum_bend_radius_mm: float = Field(gt=0, description="Catalogue limit: a smaller radius is outcome FAIL.")
    anchor: AnchorConfig
    end: EndConfig | None = Field(None, description="Second anchor: its markers are not the cable's.")

    @model_validator(mode="after")
    def _markers_make_sense(self) -> CableConfig:
        listed = self.marker_arc_length_m is not None
        counted = self.marker_count is not None and self.marker_spacing_m is not None
        if listed == counted or (listed and (self.marker_count is not None or self.marker_spacing_m is not None)):
            raise ValueError("give either marker_arc_length_m, or marker_count and marker_spacing_m")
        places = self.arc_length_m
        if len(places) < 2:
            raise ValueError(f"{len(places)} marker gives no curve: at least 2 are needed, 4 for a spline")
        if any(b <= a for a, b in pairwise(places)):
            raise ValueError("marker_arc_length_m must ascend from the anchor")
        if places[-1] > self.length_m:
            raise ValueError(f"the last marker is at {places[-1]:g} m, beyond the cable's length_m = {self.length_m:g}")
        return self

    @model_validator(mode="after")
    def _hooke_needs_both(self) -> CableConfig:
        if (self.axial_stiffness_n is None) != (self.max_tension_n is None):
            raise ValueError("axial_stiffness_n and max_tension_n belong together (Hooke's law)")
        return self

    @property
    def arc_length_m(self) -> tuple[float, ...]:
        """Arc length of each marker from the anchor."""
        if self.marker_arc_length_m is not None:
            return self.marker_arc_length_m
        spacing, count = self.marker_spacing_m or 0.0, self.marker_count or 0
        return tuple(spacing * (i + 1) for i in range(count))

    @property
    def stretch_ratio(self) -> float:
        """e1 / D: from Hooke's law where stiffness and tension are given, else `stretch`."""
        if self.axial_stiffness_n is not None and self.max_tension_n is not None:
            return self.max_tension_n / self.axial_stiffness_n
        return self.stretch


class AnalysisConfig(Section):
    """Methods and limits of the report."""

    sorting: Literal["auto", "phase", "track", "chain", "paper"] = Field(
        "auto",
        description="'auto': what suits the recording; 'phase': by the robot's cycle, which repeats; 'track': points "
        "followed through time, then named, for motion that does not repeat; 'chain': the most probable chain, each "
        "frame by itself; 'paper': the greedy chain of the paper.",
    )
    curvature: Literal["auto", "elastica", "menger_gp", "spline"] = Field(
        "auto",
        description="'elastica': a heavy rod between both clamps, whose places and directions must be known; "
        "'menger_gp': discrete bends, smoothed, with a band; 'spline': the paper's cubic spline.",
    )
    cycles: Literal["auto", "whole"] = Field(
        "auto",
        description="'auto': as the robot shows them; without a robot as the motion repeats, at least three times, "
        "else the whole take as cycle 0. 'whole': always that.",
    )
    marker_noise_mm: float = Field(
        0.2, gt=0, le=50, description="Standard deviation of a marker's position; 0.12-0.74 mm measured on OptiTrack."
    )
    gate_tolerance_mm: float = Field(
        4.0,
        ge=0,
        le=100,
        description="Added to both sides of every spacing gate: two markers taped to ±2 mm are ±4 mm apart.",
    )
    arc_length_samples: int = Field(100, ge=4, le=2000, description="Places along the cable where curvature is given.")
    slow_cycle_ratio: float = Field(
        1.1, gt=1, le=10, description="A cycle longer than this times the median is 'slow'."
    )


class Config(Section):
    """A whole configuration file."""

    run: RunConfig = Field(default_factory=RunConfig)
    robot: AnyRobotConfig | None = None
    tracker: AnyTrackerConfig | None = None
    cable: CableConfig
    analysis: AnalysisConfig = Field(default_factory=AnalysisConfig)
    calibration: CalibrationConfig = Field(default_factory=CalibrationConfig)
    policy: PolicyConfig = Field(default_factory=PolicyConfig)
    simulation: SimulationConfig | None = None

    @model_validator(mode="after")
    def _slow_cycle_is_granted(self) -> Config:
        if self.run.first_cycle_speed < 1.0 and self.robot is not None and not self.robot.cycle.is_granted:
            raise ValueError(
                "[run] first_cycle_speed needs a program that waits for a grant before each cycle: only between two "
                "cycles can the speed slider be set back"
            )
        return self
