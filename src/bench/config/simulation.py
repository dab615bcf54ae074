"""The simulated bench as a table of the configuration."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

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
    miss_probability: float = Field(0.0, ge=0, le=1, description="Chance of each marker to be hidden in a frame.")
    ghost_count: int = Field(0, ge=0, le=50, description="Ghost markers in each frame.")
    robot_clock_ppm: float = Field(
        25.0, ge=-500, le=500, description="How much faster than host time the robot's clock runs."
    )
    tracker_clock_ppm: float = Field(-42.0, ge=-500, le=500, description="The same for the tracker's clock.")
    bending_stiffness_nm2: float = Field(0.02, gt=0, le=100, description="EI of the cable.")
    weight_n_per_m: float = Field(1.5, gt=0, le=1000, description="Weight of the cable per metre.")
    remote_control: bool = Field(
        True, description="False: the controller is in local mode, as when its pendant is in use."
    )
    admin_port: int = Field(
        0, ge=0, le=65535, description="Port on the robot's address that takes commands for faults; 0: none."
    )
