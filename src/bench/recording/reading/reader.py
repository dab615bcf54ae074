"""A run as numpy columns. Finished, unfinished and damaged files are read alike; the status says which it is.

Opening reads the record headers only. A topic is read when it is first asked for, and kept; as every chunk holds
every topic, asking for several topics at once with `Run.load` unpacks the file only once for all of them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from functools import cached_property
from pathlib import Path, PurePath

from bench.config import Config, parse_config
from bench.errors import RecordingError, RecordingUnfinishedError
from bench.model import DeviceInfo, RecorderStats
from bench.recording.container.contents import Container, DamagedError
from bench.recording.container.notes import find_attachment
from bench.recording.container.scanning import scan_container
from bench.recording.files.part_names import FIRST_NUMBER, PART, read_number
from bench.recording.files.run_files import RunFiles, opened
from bench.recording.messages.topics import BODIES, FRAME, POINTS, STATS, Message
from bench.recording.reading.columns import Columns
from bench.recording.reading.joining import find_parts, join_parts
from bench.recording.reading.loading import Span, read_messages, read_topics, split_spans
from bench.recording.reading.status import PartFacts, RunStatus, count_by_topic, describe_status, list_facts

__all__ = ["Run", "open_run"]

LAST_NS = Span().end_ns
PART_BYTES = 64 << 20
"""Some minutes of an ordinary run: enough that the work is not in the parts' edges, little beside any memory."""
_DEVICE = "bench.device."
_NOT_TOLD = -1
"""Of what an older file does not say."""


def open_run(path: str | Path) -> Run:
    """Open a run file: ``x.mcap``, or the ``x.mcap.active`` of a recording that was not closed.

    A run that was split by size is opened by its first part, and read with all parts that are beside it. A later part
    opened by its own name is read alone.

    Raises
    ------
    RecordingError
        There is no such file, or it is no recording of bench.
    RecordingUnfinishedError
        It ends before anything could be read from it.
    """
    path = Path(path)
    with opened(path) as file:
        container = _scan(file, path)
    if "bench.run" not in container.metadata:
        if container.finished:
            raise RecordingError(
                f"{path} is an MCAP file, but not a recording of bench (it has no metadata 'bench.run').",
                hint="Another program wrote it: open it there. Takes come in by `bench import`, as CSV, C3D or TRC.",
            )
        raise RecordingUnfinishedError(f"{path} holds nothing that can be read: {container.problem}.")
    if read_number(container.metadata) != FIRST_NUMBER:
        _drop_broken_notes(container)
        return Run([path], container)
    found = find_parts(path, container)
    for part in found.parts:
        _drop_broken_notes(part.container)
    return Run(found.paths, join_parts(found))


def _scan(file: RunFiles, path: Path) -> Container:
    if file.size() == 0:
        raise RecordingUnfinishedError(f"{path} is empty.", hint="The recording ended before it began.")
    try:
        return scan_container(file)
    except DamagedError as error:
        raise RecordingError(f"{path} {error}.", hint="`bench import` takes CSV, C3D and TRC files.") from error


class Run:
    """One run. Made by `open_run`; safe to keep, as no file stays open.

    Examples
    --------
    >>> run = open_run("run.mcap")  # doctest: +SKIP
    >>> run["/robot/state"].q_rad.shape  # doctest: +SKIP
    (250000, 6)
    """

    def __init__(self, paths: Sequence[Path], container: Container) -> None:
        self.path = paths[0]
        """Where the file is, or the first of its parts."""
        self._paths = tuple(paths)
        self.metadata: dict[str, dict[str, str]] = container.metadata
        """Metadata records by name; of two with one name, the later one's values count."""
        self._container = container
        self._loaded: dict[str, Columns] = {}

    @property
    def status(self) -> RunStatus:
        """How much of the run is in its file. Damage inside a chunk is found when a topic is read."""
        return describe_status(self._container, self.exit_status)

    @property
    def parts(self) -> list[PartFacts]:
        """The files it is in, in order, and how much is in each: several where it was split by size."""
        return list_facts(self._paths, self._container)

    @property
    def topics(self) -> dict[str, int]:
        """Messages by topic, of the chunks that can be read."""
        return count_by_topic(self._container)

    @cached_property
    def config(self) -> Config:
        """The configuration the run was made with; `ConfigError` if this version cannot read it."""
        return parse_config(self.config_toml, f"the configuration in {self.path}")

    @property
    def config_toml(self) -> str:
        """The configuration as it stands in the file."""
        return self.metadata.get("bench.config", {}).get("toml", "")

    @property
    def run_id(self) -> str:
        """Unique name of the run."""
        return self.metadata["bench.run"].get("run_id", "")

    @property
    def part_number(self) -> int:
        """Which part of its run this file is: 1, unless a later part of a run that was split was opened by its name."""
        return read_number(self.metadata)

    @property
    def first_part(self) -> str:
        """Name of the file in which the run begins, as it was recorded."""
        return PurePath(self.metadata.get(PART, {}).get("first", self.path.name)).name

    @property
    def versions(self) -> dict[str, str]:
        """Versions of what took part in the recording."""
        run = self.metadata["bench.run"]
        return {key.removeprefix("version."): text for key, text in run.items() if key.startswith("version.")}

    @property
    def exit_status(self) -> str:
        """How the run ended: success, abort, fail; ``unfinished`` if its recorder never closed the file."""
        return self.metadata.get("bench.end", {}).get("exit_status", "unfinished")

    @property
    def exit_reason(self) -> str:
        """Why it ended so."""
        return self.metadata.get("bench.end", {}).get("reason", "")

    @cached_property
    def devices(self) -> list[DeviceInfo]:
        """What each device said of itself."""
        return [_read_device(values) for name, values in sorted(self.metadata.items()) if name.startswith(_DEVICE)]

    @cached_property
    def totals(self) -> dict[str, RecorderStats]:
        """What became of the records by topic: as written at the end, or in an unfinished run as last known."""
        end = self.metadata.get("bench.end", {})
        return _read_totals(end) if end else _last_stats(self._read_by_chunk(STATS, backwards=True))

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last arrival in the chunks that can be read, Unix ns; (0, 0) where there is none."""
        chunks = [chunk for chunk in self._container.chunks if chunk.counts]
        times = [(chunk.start_ns, chunk.end_ns) for chunk in chunks] or [(0, 0)]
        return min(start for start, _ in times), max(end for _, end in times)

    def read_edge(self, topic: str, *, last: bool) -> Columns:
        """Return a topic's columns from the last, or first, chunk that holds it: a glance that costs one chunk.

        Raises
        ------
        RecordingError
            As `load`.
        """
        empty = replace(self._container, chunks=[])
        edge = next(self._read_by_chunk(topic, backwards=last), None)
        return edge if edge is not None else read_topics(self._paths, empty, [topic])[topic]

    def _read_by_chunk(self, topic: str, *, backwards: bool) -> Iterator[Columns]:
        ids = {key for key, channel in self._container.channels.items() if channel.topic == topic}
        chunks = [chunk for chunk in self._container.chunks if not ids.isdisjoint(chunk.counts)]
        for chunk in reversed(chunks) if backwards else chunks:
            part = replace(self._container, chunks=[chunk])
            columns = read_topics(self._paths, part, [topic])[topic]
            if part.chunks:  # undamaged
                yield columns

    def __getitem__(self, topic: str) -> Columns:
        """Return a topic's columns; a topic without messages has columns of length 0."""
        if topic not in self._loaded:
            self.load([topic])
        return self._loaded[topic]

    def load(self, topics: Iterable[str]) -> None:
        """Read several topics in one pass over the file.

        Raises
        ------
        RecordingError
            A topic is none of bench's, or its messages are not what this version can read.
        """
        missing = [topic for topic in dict.fromkeys(topics) if topic not in self._loaded]
        if FRAME not in self._loaded and not {POINTS, BODIES}.isdisjoint(missing):
            missing = list(dict.fromkeys([FRAME, *missing]))
        if missing:
            frames = self._loaded.get(FRAME)
            self._loaded |= read_topics(self._paths, self._container, missing, frames)

    def read(self, topics: Iterable[str], start_ns: int = 0, end_ns: int = LAST_NS) -> dict[str, Columns]:
        """Read what arrived from `start_ns` on and before `end_ns`, by topic, and keep nothing of it here.

        Only the chunks of that time are read. Points come with their frames, and both need no other time.

        Parameters
        ----------
        topics : iterable of str
        start_ns, end_ns : int, optional
            Host Unix time, as in ``log_time_ns``.

        Raises
        ------
        RecordingError
            As for `load`.
        """
        wanted = list(dict.fromkeys(topics))
        added = [] if {POINTS, BODIES}.isdisjoint(wanted) else [FRAME]
        found = read_topics(self._paths, self._container, dict.fromkeys([*added, *wanted]), span=Span(start_ns, end_ns))
        return {topic: found[topic] for topic in wanted}

    def stream(self, topics: Iterable[str], part_bytes: int = PART_BYTES) -> Iterator[dict[str, Columns]]:
        """Read a file of any size part by part, in order of arrival: `read` of one time after the other.

        Parameters
        ----------
        topics : iterable of str
        part_bytes : int, optional
            How much of the unpacked file is in a part, all topics counted. A part is at least a chunk of the file.

        Raises
        ------
        RecordingError
            As for `load`.
        """
        wanted = list(topics)
        for start_ns, end_ns in split_spans(self._container, part_bytes):
            yield self.read(wanted, start_ns, end_ns)

    def read_attachment(self, name: str) -> bytes:
        """Return the content of an attachment, such as ``config.toml``.

        Raises
        ------
        RecordingError
            There is none of this name, or it is damaged.
        """
        with opened(*self._paths) as files:
            content = find_attachment(files, self._container, name)
        if content is None:
            raise RecordingError(f"{self.path} has no attachment '{name}' that is undamaged.")
        return content

    def messages(self, topics: Iterable[str]) -> list[Message]:
        """Return the messages of several topics as they stand in the file, undecoded and in its order.

        Meant for parts of a file: all of them are in memory at once. Damaged chunks are left out.
        """
        return read_messages(self._paths, self._container, topics)


def _drop_broken_notes(container: Container) -> None:
    """Take out what cannot be understood: a metadata record has no checksum of its own."""
    for name, values in list(container.metadata.items()):
        try:
            if name == "bench.end":
                _read_totals(values)
            elif name.startswith(_DEVICE):
                _read_device(values)
        except (ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
            del container.metadata[name]
            container.damage.append(f"the metadata '{name}' cannot be understood: {error}")


def _read_device(values: Mapping[str, str]) -> DeviceInfo:
    return DeviceInfo(
        device=values.get("device", ""),
        kind=values.get("kind", ""),
        address=values.get("address", ""),
        version=values.get("version", ""),
        rate_hz=float(values.get("rate_hz", "nan")),
        bodies={int(key): name for key, name in json.loads(values.get("bodies", "{}")).items()},
        detail=json.loads(values.get("detail", "{}")),
    )


def _read_totals(end: Mapping[str, str]) -> dict[str, RecorderStats]:
    return {
        topic: RecorderStats(
            host_ns=int(end.get("ended_ns", "0")),
            topic=topic,
            received=int(total["received"]),
            enqueued=int(total.get("enqueued", _NOT_TOLD)),
            written=int(total["written"]),
            dropped=int(total["dropped"]),
            missed=int(total["missed"]),
            queue_high_water=int(end.get("queue_high_water", "0")),
            sync_ms=float(end.get("longest_sync_ms", "nan")),
        )
        for topic, total in json.loads(end.get("totals", "{}")).items()
    }


def _last_stats(parts: Iterable[Columns]) -> dict[str, RecorderStats]:
    """Return the last statistics of each topic: `parts` come backwards, and the totals of one moment may be in two."""
    names = [field.name for field in fields(RecorderStats)]
    found: dict[str, RecorderStats] = {}
    for columns in parts:
        known = [name for name in names if name in columns]
        if known not in (names, [name for name in names if name != "enqueued"]):
            return {}
        for row in reversed(list(zip(*(columns[name].tolist() for name in known), strict=True))):
            stats = RecorderStats(**{"enqueued": _NOT_TOLD, **dict(zip(known, row, strict=True))})
            if any(stats.host_ns < one.host_ns for one in found.values()):
                return found
            found.setdefault(stats.topic, stats)
    return found
