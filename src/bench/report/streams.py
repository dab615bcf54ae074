"""What became of every topic: received, written, dropped, missed."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from bench.report.results import StreamFinding
from bench.report.source import RecordedRun

__all__ = ["find_streams"]

DEVICE_TOPICS = ("/robot/state", "/tracker/points", "/tracker/frame", "/tracker/bodies")
COUNTS = ("received", "written", "dropped", "missed")


def find_streams(run: RecordedRun, gaps: Mapping[str, int]) -> list[StreamFinding]:
    """Return one finding for each topic that holds anything, the devices' first.

    The recorder's totals stand at the end of a finished file; in an unfinished one its last statistics are used. A
    count of what never came is also made from the recorded sequence itself, and the larger of the two is reported.

    Parameters
    ----------
    run : RecordedRun
        The run file.
    gaps : mapping
        Records missing in the recorded sequence, by topic; those that the recorder dropped are among them.
    """
    totals = _final_totals(run) or _last_statistics(run)
    findings = []
    for topic in sorted(run.topics, key=lambda name: (name not in DEVICE_TOPICS, name)):
        times = run[topic].get("log_time_ns", np.zeros(0, dtype=np.int64))
        counted = {"received": len(times), "written": len(times), "dropped": 0, "missed": 0} | totals.get(topic, {})
        missing = gaps.get(topic, 0) - counted["dropped"]
        counted["missed"] = max(counted["missed"], missing)
        if any(counted.values()):
            findings.append(StreamFinding(topic=topic, rate_hz=_rate(times), **counted))
    return findings


def _rate(times: np.ndarray[tuple[int], np.dtype[np.int64]]) -> float:
    span = (int(times.max()) - int(times.min())) * 1e-9 if len(times) > 1 else 0.0
    return (len(times) - 1) / span if span > 0 else float("nan")


def _final_totals(run: RecordedRun) -> dict[str, dict[str, int]]:
    text = run.metadata.get("bench.end", {}).get("totals", "")
    return {topic: {name: int(values[name]) for name in COUNTS} for topic, values in json.loads(text or "{}").items()}


def _last_statistics(run: RecordedRun) -> dict[str, dict[str, int]]:
    if "/bench/stats" not in run.topics:
        return {}
    stats = run["/bench/stats"]
    last = {str(topic): row for row, topic in enumerate(stats.get("topic", ()))}
    return {topic: {name: int(stats[name][row]) for name in COUNTS[2:]} for topic, row in last.items()}
