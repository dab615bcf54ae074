"""What all tables of a configuration have in common."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Discriminator

__all__ = ["Section", "choose_by_kind"]


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
