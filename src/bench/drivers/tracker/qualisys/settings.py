"""What QTM tells about itself: XML, of which four things are of use."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

from bench.errors import ProtocolError

__all__ = ["Settings", "read_settings"]


@dataclass(frozen=True, slots=True)
class Settings:
    """The part of QTM's settings that a recording needs."""

    rate_hz: float
    """Capture frequency; NaN where QTM does not say."""
    up_axis: str
    """Such as ``+Z``; empty where QTM does not say."""
    labels: tuple[str, ...] = ()
    """Names of the identified trajectories, in the order in which they are sent."""
    bodies: tuple[str, ...] = ()
    """Names of the rigid bodies, in the order in which they are sent."""


def read_settings(text: bytes) -> Settings:
    """Read the answer to ``GetParameters``. `ProtocolError` if it is no XML.

    Element names have changed their case over the protocol's versions, and new ones come with each.
    """
    try:
        root = ElementTree.fromstring(text)  # noqa: S314 - see above
    except ElementTree.ParseError as error:
        raise ProtocolError(
            f"QTM's settings cannot be read: {error}; they begin with {text[:40]!r}.",
            hint="Is this QTM's real-time port (22223)?",
        ) from error
    found = {element.tag.lower(): element for element in root}
    return Settings(
        rate_hz=_number(_texts(found.get("general"), "frequency")),
        up_axis=(_texts(found.get("the_3d"), "axisupwards") or ("",))[0],
        labels=_names(found.get("the_3d"), "label"),
        bodies=_names(found.get("the_6d"), "body"),
    )


def _texts(parent: ElementTree.Element | None, tag: str) -> tuple[str, ...]:
    children = () if parent is None else parent
    return tuple((child.text or "").strip() for child in children if child.tag.lower() == tag)


def _names(parent: ElementTree.Element | None, tag: str) -> tuple[str, ...]:
    """Return each child's name: an element in it, or an attribute."""
    children = [] if parent is None else [child for child in parent if child.tag.lower() == tag]
    return tuple((_texts(child, "name") or (child.get("Name", ""),))[0] for child in children)


def _number(texts: tuple[str, ...]) -> float:
    try:
        return float(texts[0])
    except (IndexError, ValueError):
        return float("nan")
