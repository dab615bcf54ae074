"""How much of a run is in its files, in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from bench.recording.container.contents import Container
from bench.recording.files.part_names import CONTINUES, FIRST_NUMBER, PART, read_number

__all__ = ["LAST_SECOND", "SALVAGE", "PartFacts", "RunStatus", "count_by_topic", "describe_status", "list_facts"]

SALVAGE = "bench.salvage"
"""Metadata of a file that was salvaged: what was lost."""
LAST_SECOND = "what was received in about the last second before the recording broke off"


@dataclass(frozen=True, slots=True)
class RunStatus:
    """How much of a run is in its file, or in the parts it was split into."""

    complete: bool
    """The file was closed by its recorder, every part of it that was read is undamaged, and no file is missing."""
    text: str
    """One sentence for people."""
    lost: str
    """What is missing, in words; empty if nothing is. (What was dropped while recording is in `Run.totals`.)"""
    bytes_read: int
    """Bytes that could be understood, from the start."""
    bytes_total: int
    """Size of the file, or of all that are there."""

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True, slots=True)
class PartFacts:
    """One file of a run."""

    path: Path
    bytes_total: int
    n_messages: int
    """Those that can be read."""


def list_facts(paths: Sequence[Path], container: Container) -> list[PartFacts]:
    """Return the facts of each file, in order."""
    counts = [0] * len(paths)
    for chunk in container.chunks:
        counts[chunk.part] += sum(chunk.counts.values())
    return [PartFacts(*facts) for facts in zip(paths, container.sizes or (container.size,), counts, strict=True)]


def describe_status(container: Container, exit_status: str) -> RunStatus:
    """Return how much of a run is in its files."""
    salvaged = container.metadata.get(SALVAGE, {}).get("lost", "")
    lost = [
        *filter(None, [salvaged]),
        *container.missing,
        *container.damage,
        *_describe_missing_end(container.last or container),
    ]
    n_messages = sum(count_by_topic(container).values())
    files = f" in {len(container.names)} parts" if container.names else ""
    read = f"{n_messages} messages{files}{_describe_end(container)}"
    if container.finished and container.damage:
        text = f"damaged: {read} could be read"
    elif container.finished and container.missing:
        text = f"incomplete: {read} could be read"
    elif container.finished:
        text = f"{'salvaged' if salvaged else 'complete'}: {read}, {_describe_exit(container, exit_status)}"
    else:
        text = f"unfinished: {read} were read, then {container.problem}"
    if (number := read_number(container.metadata)) != FIRST_NUMBER:
        first = container.metadata[PART].get("first", "")
        text = f"part {number} alone of the run that begins in {first}; {text}"
        lost.insert(0, f"all of the run that is in its other parts: open {first} to read them with this one")
    return RunStatus(not lost, text, "; ".join(lost), container.end, container.size)


def _describe_exit(container: Container, exit_status: str) -> str:
    if "bench.end" not in container.metadata and CONTINUES in container.metadata:
        return f"the run goes on in {container.metadata[CONTINUES].get('file', 'another part')}"
    return f"exit status {exit_status}"


def count_by_topic(container: Container) -> dict[str, int]:
    """Return the messages by topic, of the chunks that can be read."""
    counts: dict[str, int] = {}
    for chunk in container.chunks:
        for channel_id, n in chunk.counts.items():
            if channel_id in container.channels:
                topic = container.channels[channel_id].topic
                counts[topic] = counts.get(topic, 0) + n
    return counts


def _describe_missing_end(container: Container) -> list[str]:
    if container.finished:
        return []
    if "bench.end" in container.metadata or CONTINUES in container.metadata:  # written after the last chunk
        return ["only the file's summary, every record is there"]
    unread = container.size - container.end
    rest = f"{unread} bytes from byte {container.end} on and " if unread else ""
    return [rest + LAST_SECOND]


def _describe_end(container: Container) -> str:
    if not container.chunks:
        return ""
    last = max(chunk.end_ns for chunk in container.chunks)
    try:
        return f" up to {datetime.fromtimestamp(last * 1e-9, tz=UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError, OSError):  # a damaged time
        return ""
