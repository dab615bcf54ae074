"""The parts of a run that was split, found beside its first one and read as if it never had been.

A part belongs to the run if it is called like one and has the run's id. What is missing, or cannot be read, costs what
is in it: the others are read all the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from bench.errors import RecordingError
from bench.recording.container.contents import Container, DamagedError
from bench.recording.container.scanning import scan_container
from bench.recording.files.output import final_path
from bench.recording.files.part_names import CONTINUES, PART, list_parts, part_path, read_number
from bench.recording.files.run_files import opened
from bench.recording.reading.status import SALVAGE, count_by_topic

__all__ = ["FoundPart", "FoundParts", "find_parts", "join_parts"]

MOST_NAMED = 5
"""Missing parts that are named one by one."""


@dataclass(frozen=True, slots=True)
class FoundPart:
    """A part that is there."""

    number: int
    path: Path
    container: Container

    @property
    def n_messages(self) -> int:
        return sum(count_by_topic(self.container).values())

    @property
    def n_before(self) -> int | None:
        """Messages written into the parts before it, as it says itself."""
        text = self.container.metadata.get(PART, {}).get("written_before", "0")
        return int(text) if text.isascii() and text.isdigit() else None


@dataclass(frozen=True, slots=True)
class FoundParts:
    """All parts of a run that are there, and what is known of the others."""

    first: Path
    """Its final name."""
    parts: list[FoundPart]
    """In order; the first one is always there."""
    refused: dict[int, str]
    """Of files that are called like a part, why they are not taken for one."""

    @classmethod
    def alone(cls, path: Path, container: Container) -> FoundParts:
        """Return a file without looking for others."""
        return cls(final_path(path), [FoundPart(read_number(container.metadata), path, container)], {})

    @property
    def paths(self) -> list[Path]:
        return [part.path for part in self.parts]

    def is_followed(self, part: FoundPart) -> bool:
        """Tell whether a later part is there: the recorder had written all of this one before it began that."""
        return part is not self.parts[-1]

    def describe_missing(self) -> list[str]:
        """Return one sentence for each stretch of parts that is not there."""
        texts = []
        for before, after in zip(self.parts, self.parts[1:], strict=False):
            if after.number > before.number + 1:
                n = None if after.n_before is None else _count_until_end(before)
                lost = "" if n is None or after.n_before is None else f": {max(after.n_before - n, 0)} messages"
                texts.append(self._name(range(before.number + 1, after.number)) + lost)
        last = self.parts[-1]
        if "bench.end" not in last.container.metadata and CONTINUES in last.container.metadata:
            texts.append(f"{self._name([last.number + 1])}, and so is all that followed")
        return texts

    def describe_cut(self) -> list[str]:
        """Return one sentence for each part that has lost its end, though another follows."""
        texts = []
        for part, after in zip(self.parts, self.parts[1:], strict=False):
            found = part.container
            if not found.finished and after.number == part.number + 1 and CONTINUES not in found.metadata:
                n_lost = (after.n_before or 0) - (part.n_before or 0) - part.n_messages
                if found.size > found.end or n_lost > 0:
                    texts.append(f"{part.path.name} has lost its end, {max(n_lost, 0)} messages: {found.problem}")
        return texts

    def _name(self, numbers: Sequence[int]) -> str:
        shown = list(numbers[:MOST_NAMED])
        names = [part_path(self.first, number).name + self._explain(number) for number in shown]
        rest = f" and {len(numbers) - len(shown)} more" if len(numbers) > len(shown) else ""
        return f"{', '.join(names)}{rest} {'are' if len(numbers) > 1 else 'is'} missing"

    def _explain(self, number: int) -> str:
        return f" ({self.refused[number]})" if number in self.refused else ""


def find_parts(path: Path, first: Container) -> FoundParts:
    """Find the parts of the run whose first part is `path` and holds `first`, each by itself."""
    found = FoundParts.alone(path, first)
    for number, paths in list_parts(found.first).items():
        for candidate in filter(Path.is_file, paths):
            part = _scan_part(candidate)
            reason = part if isinstance(part, str) else _refuse(part, number, first)
            if isinstance(part, Container) and not reason:
                found.parts.append(FoundPart(number, candidate, part))
                found.refused.pop(number, None)
                break
            found.refused[number] = f"there is {candidate.name}, but {reason}"
    return found


def _scan_part(path: Path) -> Container | str:
    try:
        with opened(path) as file:
            return scan_container(file)
    except (DamagedError, RecordingError) as error:
        return f"it cannot be read: {error}"


def _refuse(part: Container, number: int, first: Container) -> str:
    """Return why a file is not the part it is called like; empty if it is."""
    run_id = part.metadata.get("bench.run", {}).get("run_id")
    if run_id is None:
        return f"nothing of it can be read: {part.problem}"
    if run_id != first.metadata["bench.run"].get("run_id"):
        return "it is of another run"
    if PART in part.metadata and read_number(part.metadata) != number:
        return f"it is part {read_number(part.metadata)}"
    if any(first.channels.get(key, channel).topic != channel.topic for key, channel in part.channels.items()):
        return "its channels are others"
    return ""


def _count_until_end(part: FoundPart) -> int | None:
    return None if part.n_before is None else part.n_before + part.n_messages


def join_parts(found: FoundParts) -> Container:
    """Put the parts together: what is in them, and what is not."""
    if len(found.parts) == 1:
        container = found.parts[0].container
        container.missing = found.describe_missing()
        return container
    containers = [part.container for part in found.parts]
    last = containers[-1]
    names = tuple(part.path.name for part in found.parts)
    joined = Container(
        size=sum(container.size for container in containers),
        end=sum(container.end for container in containers),
        finished=last.finished,
        problem=f"{names[-1]}: {last.problem}",
        metadata=_join_metadata(containers),
        names=names,
        sizes=tuple(container.size for container in containers),
        last=last,
        missing=found.describe_missing(),
        damage=[*found.describe_cut(), *_join_damage(found.parts)],
    )
    for number, container in enumerate(containers):
        for chunk in container.chunks:
            chunk.part = number
        joined.chunks += container.chunks
        joined.notes += [replace(note, part=number) for note in container.notes]
        for key, channel in container.channels.items():
            if key not in joined.channels or not joined.channels[key].schema_name:
                joined.channels[key] = channel
    return joined


def _join_metadata(containers: Iterable[Container]) -> dict[str, dict[str, str]]:
    """Return what the parts say of the run: later values count, as within one file."""
    joined: dict[str, dict[str, str]] = {}
    lost = []
    for container in containers:
        for name, values in container.metadata.items():
            if name == SALVAGE:
                lost.append(values.get("lost", ""))
            elif name not in (PART, CONTINUES):
                joined.setdefault(name, {}).update(values)
    return joined | ({SALVAGE: {"lost": "; ".join(filter(None, lost))}} if lost else {})


def _join_damage(parts: Sequence[FoundPart]) -> Iterator[str]:
    return (f"{part.path.name}: {text}" for part in parts for text in part.container.damage)
