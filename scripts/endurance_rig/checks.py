"""What must hold of the run files and reports that a test with faults leaves."""

from __future__ import annotations

import html
import re
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pyarrow.parquet as pq

from bench.model import CycleEventKind
from bench.recording import CYCLE, open_run
from endurance_rig.lab import Fault

RESUMED = "bench.resumed_from"
NOTED = re.compile(r'class="time">([\d-]+ [\d:.]+)</th><td[^>]*>\w+</td><td>\w+</td><td class="why">(.*?)</td>')
SLACK_NS = 500_000_000
"""A sentence may be written this much before or after what it is about was over."""
WORDS = {
    "kill controller": ("controller", "restarted"),
    "stall controller": ("sent nothing for", "is back after"),
    "stall bench": ("bench itself stood still",),
}


def check_parts(parts: list[Path], faults: list[Fault], n_cycles: int, folder: Path) -> list[str]:
    """Report on all parts, fill in where each fault is named, and return what is not as it should be."""
    command = [sys.executable, "-m", "bench", "report", *map(str, parts), "--output", str(folder)]
    said = subprocess.run(command, capture_output=True, text=True, check=False)
    if said.returncode not in (0, 1, 6):
        return [f"bench report ended with {said.returncode}: {said.stderr}"]
    reports = sorted(folder.glob("*/report.html"), key=lambda path: part_number(path.parent.name))
    if len(reports) != len(parts):
        return [f"{len(parts)} files, {len(reports)} reports"]
    pages = [html.unescape(path.read_text(encoding="utf-8")) for path in reports]
    for fault in faults:
        fault.named = find_named(fault, pages, parts)
    unnamed = [f"'{fault.kind}' after {fault.n_completed} cycles is not named" for fault in faults if not fault.named]
    return [*check_counts(parts, pages, n_cycles), *check_tables(parts, reports), *unnamed]


def part_number(name: str) -> int:
    return int(re.findall(r"part(\d+)", name)[0])


def completed_cycles(path: Path) -> list[int]:
    events = open_run(path)[CYCLE]
    return [int(index) for index in events.cycle_index[events.kind == CycleEventKind.COMPLETED]]


def check_counts(parts: list[Path], pages: list[str], n_cycles: int) -> list[str]:
    """Every cycle once: in a file, or of the last second of a killed bench and named as such by the next report."""
    failures, n_before = [], 0
    for path, page in zip(parts, pages, strict=True):
        run = open_run(path)
        resumed = run.metadata.get(RESUMED, {})
        start, recorded = int(resumed.get("completed", 0)), int(resumed.get("recorded", 0))
        if recorded != n_before or start < recorded:
            failures.append(f"{path.name} goes on after {start} cycles, {recorded} of them recorded; {n_before} were")
        if start > recorded and "the recording was lost, for bench was killed" not in page:
            failures.append(f"{path.name} does not name {start - recorded} lost cycles")
        done = completed_cycles(path)
        if done != list(range(start, start + len(done))):
            failures.append(f"{path.name} has the cycles {done}")
        n_before = start + len(done)
    return failures if n_before == n_cycles else [*failures, f"{n_before} cycles instead of {n_cycles}"]


def check_tables(parts: list[Path], reports: list[Path]) -> list[str]:
    """No completed cycle is in two tables, and what is in a table without being completed is marked."""
    failures: list[str] = []
    seen: set[int] = set()
    for path, report in zip(parts, reports, strict=True):
        table = pq.read_table(report.with_name("cycles.parquet"), columns=["cycle_index", "verdict"]).to_pydict()
        done = set(completed_cycles(path))
        for index, verdict in zip(table["cycle_index"], table["verdict"], strict=True):
            if index in done and index in seen:
                failures.append(f"cycle {index} is in two tables")
            if index not in done and verdict != "interrupted":
                failures.append(f"cycle {index} of {path.name} was not completed and is '{verdict}'")
        seen |= done & set(table["cycle_index"])
        if missing := done - set(table["cycle_index"]):
            failures.append(f"cycles {sorted(missing)} of {path.name} are in no table")
    return failures


def find_named(fault: Fault, pages: list[str], parts: list[Path]) -> list[str]:
    """Return the words by which the reports name a fault."""
    if fault.kind == "kill bench":
        following = pages[fault.part + 1] if fault.part + 1 < len(pages) else ""
        is_named = "was never finished" in pages[fault.part] and f"goes on with {parts[fault.part].name}" in following
        return ["never finished", "the next goes on with it"] if is_named else []
    noted = [text for time_ns, text in read_noted(pages[fault.part]) if is_within(time_ns, fault)]
    return [word for word in WORDS[fault.kind] if any(word in text for text in noted)]


def read_noted(page: str) -> list[tuple[int, str]]:
    return [(parse_utc(time), text) for time, text in NOTED.findall(page)]


def parse_utc(text: str) -> int:
    return round(datetime.strptime(text, "%Y-%m-%d %H:%M:%S.%f").replace(tzinfo=UTC).timestamp() * 1e3) * 1_000_000


def is_within(time_ns: int, fault: Fault) -> bool:
    return fault.began_ns - SLACK_NS <= time_ns <= fault.ended_ns + SLACK_NS
