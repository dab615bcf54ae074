"""The [tracker] table: which tracker, where it is and how its frames come."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag

from bench.config.section import Section

__all__ = ["AnyTrackerConfig", "QualisysConfig", "TrackerConfig"]


class TrackerConfig(Section):
    """The optical tracker."""

    kind: Literal["natnet"] = Field("natnet", description="OptiTrack Motive, NatNet unicast.")
    host: str = Field(min_length=1, description="Address of the PC that runs Motive.")
    command_port: int = Field(1510, ge=1, le=65535, description="NatNet command port.")
    local_address: str = Field("", description="Our own address towards the tracker; empty: chosen by the system.")


class QualisysConfig(Section):
    """A Qualisys system: Qualisys Track Manager (QTM), by its real-time protocol."""

    kind: Literal["qualisys"] = Field("qualisys", description="Qualisys Track Manager; needs bench's extra 'qualisys'.")
    host: str = Field(min_length=1, description="Address of the PC that runs QTM.")
    port: int = Field(22223, ge=1, le=65535, description="QTM's little-endian port: its base port (22222) plus 1.")


def _kind_of(tracker: object) -> str:
    """Choose the model of a [tracker] table; without a kind it is NatNet's."""
    if isinstance(tracker, QualisysConfig) or (isinstance(tracker, dict) and tracker.get("kind") == "qualisys"):
        return "qualisys"
    known = not isinstance(tracker, dict) or tracker.get("kind", "natnet") == "natnet"
    return "natnet" if known else "unknown"


AnyTrackerConfig = Annotated[
    Annotated[TrackerConfig, Tag("natnet")] | Annotated[QualisysConfig, Tag("qualisys")],
    Discriminator(
        _kind_of, custom_error_type="unknown_kind", custom_error_message="Input should be 'natnet' or 'qualisys'"
    ),
]
