"""The names of a run's parts, where it is split by size: ``x.mcap``, ``x.2.mcap``, ``x.3.mcap`` and so on."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path

from bench.recording.files.output import active_path, final_path

__all__ = ["CONTINUES", "FIRST_NUMBER", "PART", "find_first", "list_parts", "part_path", "read_number"]

PART = "bench.part"
"""Metadata at the beginning of each part: its number, the first part's name, the messages written before it."""
CONTINUES = "bench.continues"
"""Metadata at the end of each part but the last: the file in which the run goes on, and the counts so far."""
FIRST_NUMBER = 1
_NUMBER = r"([2-9]|[1-9][0-9]{1,8})"


def part_path(first: Path, number: int) -> Path:
    """Return the final name of a part of the run whose first part is `first`."""
    return first if number == FIRST_NUMBER else first.with_name(f"{first.stem}.{number}{first.suffix}")


def find_first(path: Path) -> Path | None:
    """Return the name of the first part if `path` is called like a later one, ``x.3.mcap`` or ``x.3.mcap.active``."""
    name = re.fullmatch(rf"(.+)\.{_NUMBER}(\.[^.]+)", final_path(path).name)
    return path.with_name(name[1] + name[3]) if name else None


def list_parts(first: Path) -> dict[int, list[Path]]:
    """Return what is beside `first` and called like its later parts, by number; a finished one comes first."""
    pattern = re.compile(rf"{re.escape(first.stem)}\.{_NUMBER}{re.escape(first.suffix)}(\.active)?")
    try:
        names = [name for name in map(pattern.fullmatch, (path.name for path in first.parent.iterdir())) if name]
    except OSError:  # a folder whose files may be read, but not listed
        return {}
    numbers = sorted({int(name[1]) for name in names})
    found = {number: (part_path(first, number), active_path(part_path(first, number))) for number in numbers}
    return {number: [path for path in paths if os.path.lexists(path)] for number, paths in found.items()}


def read_number(metadata: Mapping[str, Mapping[str, str]]) -> int:
    """Return which part a file says it is; 1 if it does not say."""
    text = metadata.get(PART, {}).get("number", "")
    return int(text) if re.fullmatch(_NUMBER, text) else FIRST_NUMBER
