"""What is wrong with a line that is no TOML, and what to write instead: for people who write one for the first time."""

from __future__ import annotations

import re
import tomllib

__all__ = ["describe_syntax_fault"]

PLACE = re.compile(r"\(at (?:line (\d+), column \d+|end of document)\)")
TWICE = re.compile(r"Cannot declare \((.*)\) twice")
VALUE = r"^[^=#]*=\s*"
"""A line up to its value."""
NO_KEY = "Write: key = value."
HINTS = (
    (r"[“”„‘’«»]", 'Use straight quotes: "text".'),
    (VALUE + r"-?\d+,\d+\s*(#|$)", "Write a decimal point, not a comma."),
    (VALUE + r"-?\d+(\.\d+)?\s*[A-Za-zµ%°]+\s*(#|$)", "Write the number alone: its unit is part of the key."),
    (VALUE + r"\d[\d.]*\.\d+\.\d", 'Put an address in quotes: "192.168.0.10".'),
    (VALUE + r"\"[^\"]*\\", "In a path write / instead of \\, or put it in single quotes."),
    (VALUE + r"[A-Za-z/][^\"'\[{]*$", 'Put text in quotes: "text"; true and false stand without.'),
    (VALUE + r"(\"[^\"]*|'[^']*)$", "The quote at the end of the text is missing."),
    (VALUE + r"(#|$)", "The value is missing."),
    (r"^\s*\[[^\]]*$", "The bracket ] at the end is missing."),
    (r"^[^=\[]+$", NO_KEY),
)
"""Looked for in this order in the line at which the reader stopped, and what to do."""
UNCLOSED = "The list before this line has no ] at its end."


def describe_syntax_fault(text: str, source: str, error: tomllib.TOMLDecodeError) -> tuple[str, str]:
    """Return the sentence for a text that is no TOML, with its line and what stands there, and what to do.

    Parameters
    ----------
    text : str
    source : str
        Name of the file.
    error : tomllib.TOMLDecodeError
        What the reader said; its place is taken from the message, for not every version of Python tells it otherwise.
    """
    reason = TWICE.sub(_say_twice, PLACE.sub("", str(error)).strip()).replace(
        "Cannot overwrite a value", "this key stands twice in its table"
    )
    place = PLACE.search(str(error))
    lines = text.rstrip().splitlines() or [""]
    number = int(place.group(1)) if place and place.group(1) else len(lines)
    line = lines[min(number, len(lines)) - 1]
    hint = next((hint for pattern, hint in HINTS if re.search(pattern, line)), "")
    if reason.startswith("Unclosed array"):
        hint = UNCLOSED
    elif hint in ("", NO_KEY) and (place is None or not place.group(1)):
        hint = "A bracket or a quote that was opened is not closed."
    return f"{source}, line {number} is not valid TOML: {line.strip()} ({reason[:1].lower()}{reason[1:]}).", hint


def _say_twice(found: re.Match[str]) -> str:
    name = ".".join(re.findall(r"'([^']*)'", found.group(1)))
    return f"[{name}] stands twice"
