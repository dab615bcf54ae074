"""Records to a run file: one bounded queue, one thread that writes, at most one second at risk.

``put`` never waits: the drivers' reader threads take the time stamps, and a disk that stalls must not move them. What
does not fit the queue is dropped and counted. Twice a second of the machine's own time the chunk in progress is
finished, flushed and synced to the disk, so that a killed process, a crashed system or a power cut costs at most
one second (measured: without the sync, a power cut costs everything since the start).
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from bench.errors import BenchError, RecordingError
from bench.model import DeviceInfo, LogEntry, Record, RecorderStats, Severity
from bench.recording.files.output import explain_os_error
from bench.recording.messages.topics import TOPICS, Message, encode_record
from bench.recording.writing.counts import Counts
from bench.recording.writing.descriptions import describe_counts, describe_device, describe_end, describe_run
from bench.recording.writing.part_sequence import PartSequence
from bench.recording.writing.part_writing import FORMAT_VERSION, Attachment
from bench.timing import Clock, patience_ns

__all__ = ["RunWriter"]

DRAIN_S = 0.02
"""How often the queue is emptied: 17 records at 860 a second, and no measurable effect on the reader threads."""
SYNC_S = 0.5
"""A crash may cost this and one sync: within the second that is promised also where a sync takes 0.4 s (1 to 6 ms on
a good disk)."""
BATCH = 1000
"""Records between two looks at the clock (10 to 30 ms of writing): a long queue must not put off the sync."""
CHUNK_BYTES = 1 << 20
"""Chunks end here if the second does not end them first: LZ4 gains nothing from more."""
_LAST_NS = (1 << 64) - 1

_log = logging.getLogger(__name__)


class RunWriter:
    """Writes one run: one file, or parts of it that follow each other.

    Parameters
    ----------
    path : Path
        The run file, ``x.mcap``; until `close` it is called ``x.mcap.active``. Further parts are ``x.2.mcap``, ….
    clock : Clock
        Host time of the run.
    config_toml : str
        The resolved configuration; it travels in the file.
    versions : mapping of str to str
        Versions of what takes part: ``bench``, ``python``, …
    run_id : str
        Unique name of the run.
    extra : mapping, optional
        Further metadata records by name.
    attachments : mapping, optional
        What travels in the file as attachments besides ``config.toml``, by name: texts are TOML, bytes are any file's.
    on_failure : callable, optional
        Called once, from the writer thread, when the file cannot be written any more.
    queue_limit : int, optional
        Records that may wait: 200 000 is minutes at 860 records a second, and about 300 MB.
    split_bytes : int, optional
        Size from which on the run goes on in the next part; 0: never.

    Raises
    ------
    RecordingExistsError
        `path` or its active name exists, or that of a later part where it is split.
    RecordingError
        The folder or the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        clock: Clock,
        *,
        config_toml: str,
        versions: Mapping[str, str],
        run_id: str,
        extra: Mapping[str, Mapping[str, str]] | None = None,
        attachments: Mapping[str, str | bytes] | None = None,
        on_failure: Callable[[BenchError], None] | None = None,
        queue_limit: int = 200_000,
        split_bytes: int = 0,
    ) -> None:
        self.failure: BenchError | None = None
        """Why the file cannot be written any more, or None."""
        self.warnings: list[str] = []
        """What did not go as it should, and cost no record."""
        self._clock = clock
        self._on_failure = on_failure
        self._queue: deque[Record] = deque()
        self._queue_limit = queue_limit
        self._notes: deque[tuple[str, dict[str, str]]] = deque()
        self._counts = Counts(TOPICS)
        self._refused: set[type] = set()
        self._chunk_bytes = 0
        self._accepting = True
        self._published = False
        self._stopping = threading.Event()
        self._closing = threading.Lock()
        run = describe_run(run_id, FORMAT_VERSION, clock, versions)
        notes = {"bench.run": run, "bench.config": {"toml": config_toml}} | dict(extra or {})
        texts = {"config.toml": config_toml} | dict(attachments or {})
        now = _clamp_ns(clock.now_ns())
        attached = [Attachment(now, name, text) for name, text in texts.items()]
        self._parts = PartSequence(Path(path), split_bytes, notes, attached)
        self._next_sync_ns = clock.now_ns() + patience_ns(clock, SYNC_S)
        self._thread = threading.Thread(target=self._write_until_stopped, name="recorder", daemon=True)
        self._thread.start()

    def put(self, record: Record) -> None:
        """Hand over a record, from any thread. Never waits and never raises; what cannot be taken is counted."""
        if self._accepting and len(self._queue) < self._queue_limit:
            self._queue.append(record)
        else:
            self._counts.turn_away(record)

    def put_all(self, records: Iterable[Record]) -> None:
        """Hand over records that can wait, from a file: where the queue is full, wait for the disk.

        Raises
        ------
        RecordingError, DiskFullError
            The file cannot be written any more.
        """
        for record in records:
            if len(self._queue) >= self._queue_limit or self.failure is not None:
                self._wait_for_room()
            self.put(record)

    def _wait_for_room(self) -> None:
        while len(self._queue) >= self._queue_limit and self.failure is None:
            self._stopping.wait(DRAIN_S)
        if self.failure is not None:
            raise self.failure

    def note_missed(self, topic: str, n: int) -> None:
        """Count `n` messages of `topic` that the device sent and nobody received."""
        self._counts.miss(topic, n)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record, from any thread. After a failure there is no place for it."""
        self._notes.append((name, dict(values)))

    def add_device(self, info: DeviceInfo) -> None:
        """Add what a device says of itself as metadata ``bench.device.<device>``."""
        self.add_metadata(f"bench.device.{info.device}", describe_device(info))

    @property
    def stats(self) -> dict[str, RecorderStats]:
        """What became of the records by topic."""
        return self._counts.snapshot(self._clock.now_ns(), self._queue.copy())

    @property
    def queue_length(self) -> int:
        """Records that wait to be written."""
        return len(self._queue)

    @property
    def bytes_written(self) -> int:
        """Size of the file so far, of all its parts together."""
        return self._parts.size

    @property
    def paths(self) -> list[Path]:
        """The final names of the files so far, in order."""
        return self._parts.paths

    @property
    def free_bytes(self) -> int:
        """Bytes that the file's disk can still take; `RecordingError` if the disk is gone."""
        return self._parts.free_bytes()

    def close(self, *, exit_status: str, reason: str) -> Path:
        """Write what waits and the totals, make the file durable and give it its final name.

        May be called again: it returns, or raises, the same.

        Returns
        -------
        Path
            The finished run file, or its first part.

        Raises
        ------
        RecordingError, DiskFullError
            The file could not be written to its end; what is readable stays under the active name.
        RecordingExistsError
            The final name was taken meanwhile; the complete file keeps its active name.
        """
        with self._closing:
            self._accepting = False
            self._stopping.set()
            self._thread.join()
            if self.failure is None and not self._published:
                self._guard(lambda: self._finish(exit_status, reason))
            self._drop_queue()
            self._parts.close()
            if self.failure is not None:
                raise self.failure
            return self._parts.paths[0]

    def discard(self) -> None:
        """End without a run file: nothing was driven, so there is nothing to keep. Instead of `close`."""
        with self._closing:
            self._accepting = False
            self._stopping.set()
            self._thread.join()
            self._drop_queue()
            self._parts.discard()

    # the writer thread, and after it has ended the thread that closes

    def _write_until_stopped(self) -> None:
        while not self._stopping.wait(DRAIN_S):
            self._guard(self._write_pending)
            if self.failure is not None:
                self._tell_failure(self.failure)
                return

    def _write_pending(self) -> None:
        self._drain()
        self._sync_if_due()
        self._parts.verify_ending()

    def _finish(self, exit_status: str, reason: str) -> None:
        self._drain()
        self._parts.split_no_more()
        self._sync()
        self._parts.finish(describe_end(exit_status, reason, self._clock.now_ns(), self._counts))
        self._published = True

    def _drain(self) -> None:
        self._write_notes()
        while waiting := len(self._queue):
            self._counts.see_queue(waiting)
            for _ in range(min(waiting, BATCH)):
                self._write(self._queue.popleft())
                if self._parts.is_full:
                    self._sync()
            self._sync_if_due()
        self._write_notes()

    def _write_notes(self) -> None:
        while self._notes:
            self._parts.add_metadata(*self._notes.popleft())

    def _write(self, record: Record) -> None:
        try:
            messages = encode_record(record)
        except Exception as error:
            self._counts.drop(record)
            self._report_refused(record, error)
            return
        for message in messages:
            self._write_message(message)
        if self._chunk_bytes >= CHUNK_BYTES:
            self._end_chunk()

    def _write_message(self, message: Message) -> None:
        topic, log_time_ns, publish_time_ns, sequence, payload = message
        count = self._counts.write(topic)
        number = (count if sequence is None else sequence) & 0xFFFFFFFF
        self._parts.add_message(topic, _clamp_ns(log_time_ns), payload, _clamp_ns(publish_time_ns), number)
        self._chunk_bytes += len(payload) + 31  # an MCAP message's own header

    def _report_refused(self, record: Record, error: Exception) -> None:
        if type(record) not in self._refused:
            self._refused.add(type(record))
            _log.error("a %s cannot be recorded and is dropped: %r", type(record).__name__, error)

    def _end_chunk(self) -> None:
        self._parts.end_chunk()
        self._chunk_bytes = 0

    def _sync_if_due(self) -> None:
        if self._clock.now_ns() >= self._next_sync_ns:
            self._sync()

    def _sync(self) -> None:
        now = self._clock.now_ns()
        for stats in self._counts.snapshot(now, self._queue.copy()).values():
            if stats.received or stats.missed:
                self._write(stats)
        begin = self._clock.now_ns()
        self._end_chunk()
        self._parts.sync()
        end = self._clock.now_ns()
        self._counts.confirm((end - begin) * 1e-6 / self._clock.speed)
        self._next_sync_ns = now + patience_ns(self._clock, SYNC_S)
        if self._parts.is_full:
            self._go_on_in_next_part()

    def _go_on_in_next_part(self) -> None:
        totals = describe_counts(self._clock.now_ns(), self._counts)
        if trouble := self._parts.go_on(totals, self._counts.n_written):
            self._warn(trouble)

    def _warn(self, text: str) -> None:
        """Tell what somebody should see to, in the log and in the recording."""
        _log.warning("%s", text)
        self.warnings.append(text)
        self._write(LogEntry(self._clock.now_ns(), Severity.WARN, "recorder", text))

    def _guard(self, step: Callable[[], None]) -> None:
        """Run one step of writing; whatever goes wrong is the end of the recording, once, and is told."""
        try:
            step()
        except OSError as error:
            self._fail(explain_os_error(error, self._parts.active))
        except BenchError as error:
            self._fail(error)
        except Exception as error:  # a fault of ours must not end the thread in silence
            _log.exception("the recorder failed")
            self._fail(RecordingError(f"{self._parts.active} cannot be written: {error!r}."))

    def _fail(self, failure: BenchError) -> None:
        self._accepting = False
        self.failure = failure
        self._counts.revoke_unconfirmed()
        self._drop_queue()
        _log.error("%s", failure)

    def _tell_failure(self, failure: BenchError) -> None:
        if self._on_failure is not None:
            try:
                self._on_failure(failure)
            except Exception:
                _log.exception("the recorder's failure could not be told")

    def _drop_queue(self) -> None:
        with suppress(IndexError):
            while True:
                self._counts.drop(self._queue.popleft())


def _clamp_ns(unix_ns: int) -> int:
    """MCAP's own times are unsigned; the message keeps the time as it was given."""
    return unix_ns if 0 <= unix_ns <= _LAST_NS else min(max(unix_ns, 0), _LAST_NS)
