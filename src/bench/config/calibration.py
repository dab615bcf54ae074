"""What ties the tracker's space to the robot's."""

from __future__ import annotations

from pydantic import Field

from bench.config.section import Section

__all__ = ["CalibrationConfig"]


class CalibrationConfig(Section):
    """What the cameras see of the robot, so that the lab frame can be tied to its base frame."""

    flange_body: str = Field(
        "", max_length=200, description="Rigid body that is fixed to the flange, by its name in the tracker's software."
    )
