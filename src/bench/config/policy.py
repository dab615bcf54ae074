"""What a run does when something is not as it should be, as data."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from bench.config.section import Section

__all__ = ["PolicyConfig"]

Action = Literal["hold", "stop", "abort"]


class PolicyConfig(Section):
    """What a run does when something is not as it should be.

    "hold": grant no further cycle until it is as before. "stop": end after the cycle under way. "abort": end now, in
    the middle of a cycle. Whatever stopped the robot, only a person at its pendant makes it go on: never bench.
    """

    tracker_silent: Action = Field(
        "hold", description="No frames: what comes after them is as good as what was before."
    )
    robot_link_lost: Action = Field(
        "hold", description="The robot ends its cycle and waits; the link is tried again. 'abort': it is not."
    )
    protective_stop: Action = Field("hold", description="A person looks, clears it at the pendant and resumes there.")
    safeguard_stop: Action = Field("hold", description="Somebody opened the cell, and will close it again.")
    emergency_stop: Literal["abort"] = Field(
        "abort", description="The program has lost its place: only a new run, with --resume, can go on."
    )
    program_replaced: Literal["abort"] = Field(
        "abort", description="The program stopped by itself, or is another one: as after an emergency stop."
    )
    slider_moved: Action = Field("hold", description="Cycles at another speed are another test: until it is back.")
    disk_low: Action = Field("stop", description="The rest of the run does not fit; nobody frees space at night.")
    clock_residual: Action = Field(
        "hold", description="The robot's packages queue: their arrival times are worth less. Not at a --speed."
    )
    hold_timeout_s: float = Field(
        43_200.0, gt=0, le=604_800, description="Longest hold before the run gives up: 12 hours, a night."
    )
    tracker_silence_s: float = Field(
        2.0, ge=0.2, le=60, description="Time without a frame that is silence: 40 ms to 0.4 s happen on busy machines."
    )
    clock_residual_ms: float = Field(
        250.0, gt=0, le=10_000, description="All packages of a second later than this: stalls of 0.4 s are survived."
    )
    free_space_mb: float = Field(
        200.0, ge=0, description="Reserve on the run file's disk, beyond what the rest of the run is foretold to take."
    )
