"""Where the run stands, gathered from the parts of its file."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.model import CycleEventKind, Severity
from bench.recording import CYCLE, LOG, STATE, STATS, Run

__all__ = ["LiveStatus"]


class LiveStatus:
    """State, cycles, losses and alarms, of all parts that were read."""

    def __init__(self) -> None:
        self.host_ns = 0
        """Time of the newest of them."""
        self._state = ""
        self._n_completed = 0
        self._dropped: dict[str, int] = {}
        self._missed: dict[str, int] = {}
        self._n_alarms = 0
        self._last_alarm = ""

    def read_words(self, part: Run) -> None:
        """Add a part's state and alarms."""
        if len(part[STATE].state):
            self._state = str(part[STATE].state[-1])
        alarms = np.flatnonzero(part[LOG].severity >= Severity.WARN)
        self._n_alarms += len(alarms)
        if len(alarms):
            self._last_alarm = str(part[LOG].text[alarms[-1]])
        self._see_time(part, STATE, LOG)

    def read_counts(self, part: Run) -> None:
        """Add a part's cycles and losses."""
        before = part.metadata.get("bench.resumed_from", {}).get("completed", "0")
        completed = part[CYCLE].cycle_index[part[CYCLE].kind == CycleEventKind.COMPLETED]
        self._n_completed = max(self._n_completed, int(before), int(completed.max(initial=-1)) + 1)
        for stats in part.totals.values():
            self._dropped[stats.topic], self._missed[stats.topic] = stats.dropped, stats.missed
        self._see_time(part, CYCLE, STATS)

    def _see_time(self, part: Run, *topics: str) -> None:
        self.host_ns = max(self.host_ns, *(int(part[topic].log_time_ns.max(initial=0)) for topic in topics))

    def values(self, cable_problem: str) -> dict[str, Any]:
        """Return the fields of ``bench_msgs/msg/LiveStatus``."""
        return {
            "host_ns": self.host_ns,
            "state": self._state,
            "cycles_completed": self._n_completed,
            "dropped": sum(self._dropped.values()),
            "missed": sum(self._missed.values()),
            "alarms": self._n_alarms,
            "last_alarm": self._last_alarm,
            "cable": cable_problem,
        }
