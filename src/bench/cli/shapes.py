"""A known shape on the command line: what ``bench accuracy`` and ``bench compare`` hold a recording against."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from bench.errors import ConfigError

if TYPE_CHECKING:
    from bench.analysis import KnownShape

__all__ = ["AMmOption", "ChosenShape", "RadiusMmOption", "ShapeKind", "ShapeOption", "choose_shape"]


class ShapeKind(StrEnum):
    """Shapes that a lab can make."""

    CIRCLE = "circle"
    CATENARY = "catenary"
    STRAIGHT = "straight"


ShapeOption = Annotated[
    ShapeKind | None, typer.Option("--shape", help="The known shape: a circle, a catenary, a straight rod.")
]
RadiusMmOption = Annotated[
    float | None, typer.Option("--radius-mm", min=1.0, help="Of a circle: radius of the cable's axis.")
]
AMmOption = Annotated[
    float | None,
    typer.Option("--a-mm", min=1.0, help="Of a catenary: a, the bend radius at its lowest place."),
]


@dataclass(frozen=True)
class ChosenShape:
    """A known shape, and how to make it of another size."""

    kind: ShapeKind
    shape: KnownShape
    make: Callable[[float], KnownShape] | None
    """None for a shape without a size."""
    size_m: float


def choose_shape(kind: ShapeKind, radius_mm: float | None, a_mm: float | None) -> ChosenShape:
    """Return the shape of the options; raise `ConfigError` where its size is missing or another's is given."""
    from bench.analysis import Catenary, Circle, Straight

    sizes = {"--radius-mm": radius_mm, "--a-mm": a_mm}
    own = {ShapeKind.CIRCLE: "--radius-mm", ShapeKind.CATENARY: "--a-mm"}.get(kind, "")
    others = [name for name, value in sizes.items() if value is not None and name != own]
    if others:
        raise ConfigError(f"{others[0]} does not belong to --shape {kind}.")
    if kind is ShapeKind.STRAIGHT:
        return ChosenShape(kind, Straight(), None, float("nan"))
    size_mm = sizes[own]
    if size_mm is None:
        raise ConfigError(f"--shape {kind} needs {own}, its size in millimetres.")
    make: Callable[[float], KnownShape] = Circle if kind is ShapeKind.CIRCLE else Catenary
    return ChosenShape(kind, make(size_mm * 1e-3), make, size_mm * 1e-3)
