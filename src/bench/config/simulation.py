"""The simulated bench as a table of the configuration."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from bench.config.section import Section

__all__ = ["SimulationConfig"]


class SimulationConfig(Section):
    """The simulated bench. Its presence makes ``bench run`` start it; a real bench has no such table."""

    controller: Literal["e-series", "cb3", "polyscope-x"] = Field(
        "e-series",
        description="The simulated robot's controller: PolyScope 5; a CB3, 125 Hz and without remote control; or "
        "PolyScope X, its Robot API on [robot] robot_api_port instead of a dashboard.",
    )
    seed: int = Field(1, ge=0, description="The same seed gives the same misses, ghosts and noise.")
    cycle_s: float = Field(2.0, gt=0.1, le=3600, description="Duration of one pass along the path.")
    tracker_rate_hz: float = Field(100.0, gt=0, le=1000, description="Exposures a second.")
    noise_mm: float = Field(0.05, ge=0, le=10, description="Standard deviation of the markers' noise, per axis.")
    placement_sd_mm: float = Field(
        0.0, ge=0, le=20, description="How far off its place along the cable each marker sits: standard deviation."
    )
    mounting_sd_mm: float = Field(
        0.0,
        ge=0,
        le=20,
        description="How far each marker of the cable sits off the centreline, to the side and up: standard deviation "
        "of each. Constant, as glue holds it.",
    )
    miss_probability: float = Field(0.0, ge=0, le=1, description="Chance of each marker to be hidden in a frame.")
    burst_probability: float = Field(
        0.0, ge=0, le=1, description="Chance of each marker in a frame to be hidden from then on for 5 to 50 frames."
    )
    camera_count: int = Field(
        0,
        ge=0,
        le=64,
        description="Cameras, behind the robot. Its arm hides what fewer than 2 of them see past it; 0: nothing.",
    )
    ghost_count: int = Field(0, ge=0, le=50, description="Ghost markers in each frame.")
    ghost_near_share: float = Field(
        0.5,
        ge=0,
        le=1,
        description="Share of them that is born within 0.25 m of the cable; 0.05 in real recordings. The others are "
        "2 m away at the median.",
    )
    reflection_count: int = Field(0, ge=0, le=50, description="Shiny spots that are seen all the time, as a marker is.")
    reflection_jitter_mm: float = Field(
        0.0, ge=0, le=50, description="How much more than a marker they jitter; 1.6-4.9 mm in real recordings."
    )
    point_order: Literal["ids", "shuffle"] = Field(
        "ids", description="Order in a frame. 'ids': as Motive has it, labeled first, both by ascending number."
    )
    robot_clock_ppm: float = Field(
        25.0, ge=-500, le=500, description="How much faster than host time the robot's clock runs."
    )
    tracker_clock_ppm: float = Field(-42.0, ge=-500, le=500, description="The same for the tracker's clock.")
    tracker_stamp_delay_ms: float = Field(
        0.0, ge=-100, le=100, description="How much later than the exposure the tracker's stamps say it was."
    )
    tracker_jitter_ms: float = Field(
        0.009,
        ge=0,
        le=10,
        description="Standard deviation of the time between two exposures, by their stamps; measured on real cameras, "
        "as the next six.",
    )
    received_after_ms: float = Field(
        4.60, ge=0, le=1000, description="From the middle of an exposure to its camera data, complete in the PC."
    )
    received_sd_ms: float = Field(0.09, ge=0, le=100, description="Standard deviation of that.")
    transmit_after_ms: float = Field(5.41, ge=0, le=1000, description="From the middle of an exposure to its frame.")
    transmit_sd_ms: float = Field(0.14, ge=0, le=100, description="Standard deviation of that.")
    late_share: float = Field(0.003, ge=0, le=1, description="Share of the frames that leave later than the others.")
    latest_ms: float = Field(5.0, ge=0, le=1000, description="How much later at most.")
    frame_loss_probability: float = Field(0.0, ge=0, le=1, description="Chance of each frame to get lost on its way.")
    frame_duplicate_probability: float = Field(0.0, ge=0, le=1, description="Chance of each frame to come twice.")
    frame_reorder_probability: float = Field(
        0.0, ge=0, le=1, description="Chance of each frame to come after the one or two that follow it."
    )
    frame_jump_probability: float = Field(
        0.0, ge=0, le=1, description="Chance that 1 to 10 frame numbers are left out after a frame."
    )
    usb_cameras: bool = Field(
        False,
        description="True: no stamp of the middle of the exposure, as with cameras on USB; the next best is used.",
    )
    ptp: bool = Field(False, description="True: frames carry the time of a PTP clock, from NatNet 4.1 on.")
    natnet_version: Literal["2.9", "2.10", "3.0", "3.1", "4.0", "4.1", "4.2", "4.3"] = Field(
        "4.1",
        description="Version of the tracker's protocol: that of Motive 1.9, 1.10, 2.0, 2.1, 3.0, 3.1, 3.2 or 3.3. "
        "Before 3.0 frames have no stamps and the tracker's clock cannot be asked.",
    )
    natnet_multicast: bool = Field(
        False, description="True: frames go to the group, in the server's version, instead of to each client."
    )
    natnet_group: str = Field(
        "239.255.42.99",
        pattern=r"^(22[4-9]|23\d)(\.(25[0-5]|2[0-4]\d|1\d\d|[1-9]?\d)){3}$",
        description="Multicast group of the frames.",
    )
    natnet_other_markers: Literal["bodies", "unlabeled"] = Field(
        "bodies",
        description="What a frame lists as other markers. 'bodies': those of the rigid bodies, as Motive does; "
        "'unlabeled': the loose ones, as its manual says.",
    )
    bending_stiffness_nm2: float = Field(0.02, gt=0, le=100, description="EI of the cable.")
    half_stiffness_after_cycles: int = Field(
        0,
        ge=0,
        le=10_000_000,
        description="The cable wears: its bending stiffness falls evenly with every cycle and is half after so many, "
        "then it stays. 0: it does not wear. Every start of the simulated bench begins with a new cable.",
    )
    weight_n_per_m: float = Field(1.5, gt=0, le=1000, description="Weight of the cable per metre.")
    remote_control: bool = Field(
        True, description="False: the controller is in local mode, as when its pendant is in use."
    )
    admin_port: int = Field(
        0, ge=0, le=65535, description="Port on the robot's address that takes commands for faults; 0: none."
    )

    @model_validator(mode="after")
    def _sees(self) -> SimulationConfig:
        if self.camera_count == 1:
            raise ValueError("camera_count = 1 sees nothing: two lines of sight are needed for a point in space")
        return self
