"""What stands in a run file's metadata about the run, its devices, its parts and its end."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from bench.model import DeviceInfo
from bench.recording.writing.counts import Counts
from bench.timing import Clock

__all__ = ["describe_counts", "describe_device", "describe_end", "describe_part", "describe_run"]


def describe_run(run_id: str, format_version: str, clock: Clock, versions: Mapping[str, str]) -> dict[str, str]:
    """Return ``bench.run``: which run this is, when and with what it began."""
    now = clock.now_ns()
    started = datetime.fromtimestamp(now * 1e-9, tz=UTC).isoformat(timespec="milliseconds")
    about = {
        "run_id": run_id,
        "format_version": format_version,
        "started_utc": started,
        "started_ns": str(now),
        "clock_speed": repr(clock.speed),
        "host_name": platform.node(),
    }
    return about | {f"version.{name}": text for name, text in versions.items()}


def describe_device(info: DeviceInfo) -> dict[str, str]:
    """Return ``bench.device.<device>``: a device's own words."""
    return {
        "device": info.device,
        "kind": info.kind,
        "address": info.address,
        "version": info.version,
        "rate_hz": repr(float(info.rate_hz)),
        "bodies": json.dumps({str(key): name for key, name in info.bodies.items()}),
        "detail": json.dumps(info.detail),
    }


def describe_end(exit_status: str, reason: str, now_ns: int, counts: Counts) -> dict[str, str]:
    """Return ``bench.end``: how the run ended, and what became of its records."""
    return {"exit_status": exit_status, "reason": reason} | describe_counts(now_ns, counts)


def describe_part(first: Path, number: int, written_before: int) -> dict[str, str]:
    """Return ``bench.part``: which part of its run a file is, and how many messages are in those before it."""
    return {"number": str(number), "first": first.name, "written_before": str(written_before)}


def describe_counts(now_ns: int, counts: Counts) -> dict[str, str]:
    """Return what became of the records so far."""
    totals = {
        topic: {
            "received": s.received,
            "enqueued": s.enqueued,
            "written": s.written,
            "dropped": s.dropped,
            "missed": s.missed,
        }
        for topic, s in counts.snapshot(now_ns).items()
    }
    return {
        "ended_ns": str(now_ns),
        "totals": json.dumps(totals),
        "queue_high_water": str(counts.queue_high_water),
        "longest_sync_ms": f"{counts.longest_sync_ms:.3f}",
    }
