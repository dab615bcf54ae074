"""The message definitions of a run file: ros2msg texts, packaged as files, and their meaning as field tables.

The text is the only description of a layout: the encoder, the numpy dtype and the reader's columns are all derived
from it (`bench.recording.messages.cdr`), and a reader derives them again from the text it finds in the file.

References
----------
ROS 2 interface definition: docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html. Concatenation with
``MSG:`` separators: MCAP's registry of well-known schema encodings, ``ros2msg``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

from bench.errors import RecordingError

__all__ = ["PRIMITIVES", "Field", "Schema", "load_schema", "parse_schema"]

PRIMITIVES: Mapping[str, str] = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""ros2msg's numbers as `struct` codes."""

SEPARATOR = "=" * 80
LONGEST_ARRAY = 4096
"""A fixed array longer than this is not one of ours; the bound keeps a hostile text from taking the memory."""

_FIELD = re.compile(r"(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?P<array>\[(?:<=)?\d*\])?\s+(?P<name>[A-Za-z]\w*)(?P<rest>.*)")


@dataclass(frozen=True, slots=True)
class Field:
    """One line of a message definition."""

    name: str
    type: str
    """A key of `PRIMITIVES`, ``string``, or ``package/Message``."""
    length: int | None
    """None for a single value, -1 for a sequence of any length, else the length of the fixed array."""


@dataclass(frozen=True, slots=True)
class Schema:
    """A message definition with all it depends on."""

    name: str
    """``package/msg/Message``."""
    text: str
    """As it stands in the file."""
    types: Mapping[str, tuple[Field, ...]]
    """Fields by ``package/Message``, of the message itself and of every message inside it."""

    @property
    def fields(self) -> tuple[Field, ...]:
        """Fields of the message itself."""
        return self.types[self.name.replace("/msg/", "/")]


def parse_schema(name: str, text: str) -> Schema:
    """Read a concatenated ros2msg text.

    Raises
    ------
    RecordingError
        The text is no message definition, or uses a message that it does not define.
    """
    parts = re.split(r"^={20,}\nMSG: *(\S+)\n", text, flags=re.MULTILINE)
    sources = {name.replace("/msg/", "/"): parts[0]}
    sources.update((key.replace("/msg/", "/"), body) for key, body in zip(parts[1::2], parts[2::2], strict=True))
    types = {key: tuple(_parse_fields(key, body, sources)) for key, body in sources.items()}
    for key in types:
        _verify_finite(key, types, ())
    return Schema(name, text, types)


@cache
def load_schema(name: str) -> Schema:
    """Return the packaged definition of ``package/msg/Message`` with the text of all messages inside it."""
    own, *inner = _with_dependencies(name.replace("/msg/", "/"))
    text = _read_text(own) + "".join(f"{SEPARATOR}\nMSG: {key}\n{_read_text(key)}" for key in inner)
    return parse_schema(name, text)


def _read_text(key: str) -> str:
    package, message = key.split("/")
    return (
        resources.files("bench.recording.messages")
        .joinpath("msg", package, f"{message}.msg")
        .read_text(encoding="utf-8")
    )


def _with_dependencies(key: str) -> list[str]:
    found = [key]
    for kind in re.findall(r"^([A-Za-z][\w/]*)", _read_text(key), flags=re.MULTILINE):
        if kind not in PRIMITIVES and kind != "string":
            inner = kind if "/" in kind else f"{key.split('/')[0]}/{kind}"
            found.extend(name for name in _with_dependencies(inner) if name not in found)
    return found


def _parse_fields(key: str, body: str, sources: Mapping[str, str]) -> list[Field]:
    fields = []
    for raw in body.splitlines():
        line = raw.split("#", 1)[0].strip()
        if not line:
            continue
        match = _FIELD.fullmatch(line)
        if match is None:
            raise RecordingError(f"The definition of {key} has a line that is no field: '{line[:80]}'.")
        if match["rest"].lstrip().startswith("="):
            continue  # a constant: nothing of it is in the message
        fields.append(Field(match["name"], _resolve(key, match["type"], sources), _parse_length(key, match["array"])))
    return fields


def _resolve(key: str, kind: str, sources: Mapping[str, str]) -> str:
    if kind in PRIMITIVES or kind == "string":
        return kind
    full = kind.replace("/msg/", "/") if "/" in kind else f"{key.split('/')[0]}/{kind}"
    if full not in sources:
        raise RecordingError(f"The definition of {key} uses {full}, which the file does not define.")
    return full


def _parse_length(key: str, array: str | None) -> int | None:
    if array is None:
        return None
    inside = array[1:-1]
    if inside == "" or inside.startswith("<="):
        return -1
    if not 0 < int(inside) <= LONGEST_ARRAY:
        raise RecordingError(f"The definition of {key} has an array of {inside}; {LONGEST_ARRAY} is the limit.")
    return int(inside)


def _verify_finite(key: str, types: Mapping[str, tuple[Field, ...]], outer: tuple[str, ...]) -> None:
    if key in outer or len(outer) > 8:
        raise RecordingError(f"The definition of {key} contains itself.")
    for field in types[key]:
        if field.type in types:
            _verify_finite(field.type, types, (*outer, key))
