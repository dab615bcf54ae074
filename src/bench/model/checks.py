"""One line of a check: what was asked, what was found, and what to do about it."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CheckItem"]


@dataclass(frozen=True, slots=True)
class CheckItem:
    """One check."""

    name: str
    limit: str
    value: str
    verdict: str
    """`ok`, `warn`, `fail`, or `open` where it could not be judged."""
    sentence: str = ""
    """What is wrong or missing, and what to do, when it is not ok."""
    exit_code: int = 3
