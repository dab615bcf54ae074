"""What all tables of a configuration have in common."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Discriminator

__all__ = ["PROGRAM_FILE", "Section", "choose_by_kind"]

PROGRAM_FILE = (
    "Copy of that program, saved from the controller, relative to this configuration's folder: it travels in the run "
    "file, with its SHA-256. At most 16 MB. Left out: the run file knows the program's name only."
)
"""What the key of this name says for every kind of robot."""


class Section(BaseModel):
    """Base of every table: unknown keys are refused, numbers are not guessed from text."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def choose_by_kind(*kinds: str) -> Discriminator:
    """Choose the model of a table by its ``kind``, the first without one: only that model's keys are asked for."""

    def kind_of(table: object) -> str:
        kind = table.get("kind", kinds[0]) if isinstance(table, dict) else getattr(table, "kind", kinds[0])
        return kind if kind in kinds else "unknown"

    allowed = " or ".join(repr(kind) for kind in kinds)
    return Discriminator(kind_of, custom_error_type="unknown_kind", custom_error_message=f"Input should be {allowed}")
