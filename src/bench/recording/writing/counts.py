"""How many messages came, were taken, written, dropped, were never received: the recorder's bookkeeping.

Only the writer thread counts what is written, so that needs no lock; drops and misses come from any thread.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterable

from bench.model import Record, RecorderStats
from bench.recording.messages.topics import count_messages

__all__ = ["Counts"]


class Counts:
    """Totals by topic: what is received is written, dropped or waiting; what is not turned away is enqueued."""

    def __init__(self, topics: Iterable[str]) -> None:
        self._written = dict.fromkeys(topics, 0)
        self._confirmed = dict(self._written)
        self._dropped = dict(self._written)
        self._turned_away = dict(self._written)
        self._missed = dict(self._written)
        self._lock = threading.Lock()
        self.queue_high_water = 0
        """Most records that ever waited."""
        self.longest_sync_ms = 0.0
        """Longest flush and sync, milliseconds of the machine's own time."""

    def write(self, topic: str) -> int:
        """Count one message given to the file and return how many were given before it."""
        before = self._written[topic]
        self._written[topic] = before + 1
        return before

    @property
    def n_written(self) -> int:
        """Messages given to the file so far, of all topics."""
        return sum(self._written.values())

    def turn_away(self, record: Record) -> None:
        """Count the messages of a record that the queue does not take."""
        with self._lock:
            for topic, n in count_messages(record):
                self._turned_away[topic] += n
                self._dropped[topic] += n

    def drop(self, record: Record) -> None:
        """Count the messages of a record that was in the queue and is not written."""
        with self._lock:
            for topic, n in count_messages(record):
                self._dropped[topic] += n

    def miss(self, topic: str, n: int) -> None:
        """Count messages that a device sent and nobody received."""
        with self._lock:
            self._missed[topic] += n

    def see_queue(self, length: int) -> None:
        self.queue_high_water = max(self.queue_high_water, length)

    def confirm(self, sync_ms: float) -> None:
        """Note that everything written so far is on the disk."""
        self._confirmed = dict(self._written)
        self.longest_sync_ms = max(self.longest_sync_ms, sync_ms)

    def revoke_unconfirmed(self) -> None:
        """Count as dropped what was given to a file that then failed before it was on the disk."""
        with self._lock:
            for topic, confirmed in self._confirmed.items():
                self._dropped[topic] += self._written[topic] - confirmed
                self._written[topic] = confirmed

    def snapshot(self, host_ns: int, waiting: Iterable[Record] = ()) -> dict[str, RecorderStats]:
        """Return the totals by topic while the records `waiting` are in the queue."""
        n_waiting: Counter[str] = Counter()
        for record in waiting:
            n_waiting.update(dict(count_messages(record)))
        with self._lock:
            return {
                topic: RecorderStats(
                    host_ns=host_ns,
                    topic=topic,
                    received=written + self._dropped[topic] + n_waiting[topic],
                    enqueued=written + self._dropped[topic] + n_waiting[topic] - self._turned_away[topic],
                    written=written,
                    dropped=self._dropped[topic],
                    missed=self._missed[topic],
                    queue_high_water=self.queue_high_water,
                    sync_ms=self.longest_sync_ms,
                )
                for topic, written in self._written.items()
            }
