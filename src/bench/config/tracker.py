"""The [tracker] table: which tracker, where it is and how its frames come."""

from __future__ import annotations

from ipaddress import IPv4Address
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, Tag, model_validator

from bench.config.section import Section, choose_by_kind

__all__ = ["AnyTrackerConfig", "QualisysConfig", "TrackerConfig"]


Accuracy = Annotated[
    float,
    Field(
        gt=0,
        le=1000,
        description="How far a marker may go between two frames, so that the frame rate must be [cable] max_speed_m_s "
        "over this; the paper's 10 mm.",
    ),
]


def _verify_group(text: str) -> str:
    if text and not _is_group(text):
        raise ValueError(f"'{text}' is no multicast group: those are 224.0.0.0 to 239.255.255.255")
    return text


def _is_group(text: str) -> bool:
    try:
        return IPv4Address(text).is_multicast
    except ValueError:
        return False


class TrackerConfig(Section):
    """OptiTrack Motive."""

    kind: Literal["natnet"] = Field("natnet", description="OptiTrack Motive, by NatNet 2.9 or newer.")
    host: str = Field(min_length=1, description="Address of the PC that runs Motive.")
    command_port: int = Field(1510, ge=1, le=65535, description="NatNet command port.")
    connection: Literal["auto", "unicast", "multicast"] = Field(
        "auto", description="How the frames come. 'auto': as Motive says that it streams."
    )
    multicast_group: Annotated[str, AfterValidator(_verify_group)] = Field(
        "", description="Group of a multicast; empty: the one that Motive names."
    )
    data_port: int | None = Field(
        None, ge=1, le=65535, description="Port of a multicast; left out: the one that Motive names, usually 1511."
    )
    local_address: str = Field(
        "",
        description="Our own address towards the tracker, which also says on which network card a multicast is "
        "received; empty: chosen by the system.",
    )
    accuracy_mm: Accuracy = 10.0

    @model_validator(mode="after")
    def _belongs_to_a_multicast(self) -> TrackerConfig:
        for key in ("multicast_group", "data_port"):
            if self.connection == "unicast" and getattr(self, key):
                raise ValueError(f"{key} belongs to a multicast, not to connection = 'unicast'")
        return self


class QualisysConfig(Section):
    """A Qualisys system: Qualisys Track Manager (QTM), by its real-time protocol."""

    kind: Literal["qualisys"] = Field("qualisys", description="Qualisys Track Manager; needs bench's extra 'qualisys'.")
    host: str = Field(min_length=1, description="Address of the PC that runs QTM.")
    port: int = Field(22223, ge=1, le=65535, description="QTM's little-endian port: its base port (22222) plus 1.")
    accuracy_mm: Accuracy = 10.0


AnyTrackerConfig = Annotated[
    Annotated[TrackerConfig, Tag("natnet")] | Annotated[QualisysConfig, Tag("qualisys")],
    choose_by_kind("natnet", "qualisys"),
]
