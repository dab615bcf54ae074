"""The [tracker] table: which tracker, where it is and how its frames come."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from bench.config.section import Section

__all__ = ["TrackerConfig"]


class TrackerConfig(Section):
    """The optical tracker."""

    kind: Literal["natnet"] = Field("natnet", description="OptiTrack Motive, NatNet unicast.")
    host: str = Field(min_length=1, description="Address of the PC that runs Motive.")
    command_port: int = Field(1510, ge=1, le=65535, description="NatNet command port.")
    local_address: str = Field("", description="Our own address towards the tracker; empty: chosen by the system.")
