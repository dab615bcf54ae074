"""``bench info``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.errors import BenchError

if TYPE_CHECKING:
    from bench.recording import Columns, Run

__all__ = ["info"]


def info(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN.mcap…", help="Run files; .mcap.active too.")],
) -> None:
    """Say what is in a run file: how it ended, cycles, devices, clocks, rates, losses. Nothing is analysed.

    Only what this takes is read. `bench salvage` is what holds every part of a file against its checksum.
    """
    from bench.recording import open_run

    for path in runs:
        run = open_run(path)
        # what is read first may find damage, which belongs in the status above it
        facts, streams = list(_state_facts(run)), list(_state_streams(run))
        print(f"{path}: {run.status}")
        for text in filter(None, [run.status.lost]):
            print(f"  {'lost':<14} {text}")
        for name, text in facts:
            if text:
                print(f"  {name:<14} {text}")
        for line in streams:
            print(f"  {line}")


def _state_facts(run: Run) -> Iterator[tuple[str, str]]:
    from bench.config import describe_loaded_program, describe_program_file

    about, facts = run.metadata["bench.run"], run.metadata.get("bench.facts", {})
    begin_ns, end_ns = run.span_ns
    words = (facts.get("name", ""), facts.get("sample_id", ""), facts.get("operator", ""))
    yield "run", ", ".join(word for word in words if word)
    yield "run id", run.run_id
    yield "started", f"{about.get('started_utc', '')} on {about.get('host_name', '')}"
    yield "duration", f"{(end_ns - begin_ns) * 1e-9:.1f} s from the first record to the last"
    yield "size", f"{run.status.bytes_total / 1e6:.1f} MB"
    for part in run.parts if len(run.parts) > 1 else []:
        yield "part", f"{part.path.name}: {part.bytes_total / 1e6:.1f} MB, {part.n_messages} messages"
    yield "exit status", run.exit_status + (f": {run.exit_reason}" if run.exit_reason else "")
    yield "cycles", _count_cycles(run)
    yield "cycle source", run.metadata.get("bench.cycle_source", {}).get("source", "")
    yield "goes on with", _describe_origin(run.metadata.get("bench.resumed_from", {}))
    yield "imported from", run.metadata.get("bench.import", {}).get("file", "")
    for device in run.devices:
        words = (device.kind, device.version, f"at {device.address}" if device.address else "")
        rate = f", {device.rate_hz:g} Hz" if device.rate_hz > 0 else ""
        yield device.device, " ".join(word for word in words if word) + rate
    yield "program", describe_loaded_program(run.metadata.get("bench.program", {}))
    yield "program file", describe_program_file(run.metadata.get("bench.program", {}))
    yield "calibration", _describe_calibration(run)
    yield from _state_clocks(run)
    yield "recorded with", ", ".join(f"{name} {text}" for name, text in run.versions.items())


def _count_cycles(run: Run) -> str:
    from bench.model import CycleEventKind
    from bench.recording import CYCLE

    noted = run.metadata.get("bench.cycles", {}).get("completed")
    if noted is not None:
        return f"{noted} completed"
    events = run[CYCLE]
    completed = events.cycle_index[events.kind == CycleEventKind.COMPLETED].tolist()
    return f"{len(set(completed))} completed in this file" if len(events.kind) else ""


def _describe_origin(origin: dict[str, str]) -> str:
    if not origin:
        return ""
    return (
        f"{origin.get('file', '')} (run id {origin.get('run_id', '')}), which had {origin.get('completed', '')} cycles"
    )


def _describe_calibration(run: Run) -> str:
    try:
        measured = run.config.calibration.measured
    except BenchError:
        return "cannot be told: the configuration is one of another version"
    if measured is None:
        return "none: robot and tracker stand in spaces and times of their own"
    return f"{measured.run_file}, calculated {measured.created_utc}; tracker's times {measured.time.offset_ms:+.3f} ms"


def _state_clocks(run: Run) -> Iterator[tuple[str, str]]:
    """Yield how each clock that was asked answered at the beginning, and how far it had gone by the end."""
    from bench.model import ClockSource
    from bench.recording import CLOCK

    first, last = run.read_edge(CLOCK, last=False), run.read_edge(CLOCK, last=True)
    for source in ClockSource:
        begin, end = _find_fastest(first, source), _find_fastest(last, source)
        if begin is None or end is None:
            continue
        span_ns = end[0] - begin[0]
        text = f"answered in {begin[1] * 1e-6:.2f} ms"
        if begin[3] == end[3] and span_ns > 0:
            drift_ns = (end[2] - begin[2]) * 1e9 - span_ns
            text += f"; {drift_ns * 1e-6:+.2f} ms in {span_ns * 1e-9:.0f} s against host time"
        yield f"{source.name.lower()} clock", text


def _find_fastest(samples: Columns, source: int) -> tuple[int, int, float, int] | None:
    """Return middle and length of the shortest exchange in host ns, the device's answer in s, and the segment."""
    if not samples.keys() >= {"source", "send_ns", "receive_ns", "device_ticks", "ticks_per_s", "segment"}:
        return None  # an older definition
    rows = ((samples.source == source) & (samples.ticks_per_s > 0)).nonzero()[0]
    if not len(rows):
        return None
    took_ns = samples.receive_ns - samples.send_ns
    row = rows[took_ns[rows].argmin()]
    middle_ns = int(samples.send_ns[row]) + int(took_ns[row]) // 2
    answer_s = int(samples.device_ticks[row]) / float(samples.ticks_per_s[row])
    return middle_ns, int(took_ns[row]), answer_s, int(samples.segment[row])


def _state_streams(run: Run) -> Iterator[str]:
    """Yield a table: of each topic what is in the file, how often it came, and what the recorder knows was lost."""
    totals = run.totals
    yield f"{'topic':<20} {'messages':>10} {'per s':>8} {'dropped':>8} {'missed':>8}"
    for topic, n in sorted(run.topics.items()):
        total = totals.get(topic)
        dropped, missed = (total.dropped, total.missed) if total else ("-", "-")
        yield f"{topic:<20} {n:>10} {_describe_rate(run, topic, n):>8} {dropped:>8} {missed:>8}"


def _describe_rate(run: Run, topic: str, n_messages: int) -> str:
    try:
        first, last = (run.read_edge(topic, last=which).log_time_ns for which in (False, True))
    except BenchError:  # a topic of another program, or of another version
        return "-"
    span_s = (int(last.max()) - int(first.min())) * 1e-9 if len(first) and len(last) else 0.0
    return f"{(n_messages - 1) / span_s:.1f}" if span_s > 0 else "-"
