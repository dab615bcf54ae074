"""What a stranger on the network says, made fit for a sentence of ours."""

from __future__ import annotations

__all__ = ["one_line"]

QUOTED_CHARACTERS = 200
"""So much of it goes into a sentence."""


def one_line(text: str, limit: int = QUOTED_CHARACTERS) -> str:
    """Return at most `limit` characters of a text, in one line and printable."""
    short = " ".join(text.split())[:limit]
    return "".join(character if character.isprintable() else "?" for character in short)
