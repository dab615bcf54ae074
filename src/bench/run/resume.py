"""What an interrupted run left, and whether this run can go on from there: ``bench run --resume``."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.config import Config, ProgramFile, describe_program_file
from bench.errors import ConfigError, RecordingError, RunError
from bench.model import CycleEventKind
from bench.recording import CYCLE, Run, open_run
from bench.run.journal import is_held, read_completed

__all__ = ["PROGRAM", "RESUMED", "Origin", "hash_test", "read_origin", "verify_origin"]

RESUMED = "bench.resumed_from"
PROGRAM = "bench.program"
"""Metadata of the copy of the robot's program, if the file carries one."""
TEST_KEYS = ("run.sample_id", "robot.kind", "robot.program", "tracker.kind", "simulation.cycle_s")
TEST_TABLES = ("robot.cycle.", "cable.")
"""What makes it the same test: sample, path, and where the markers are. Addresses, limits and policies may change."""
FREE_KEYS = ("robot.cycle.timeout_s", "cable.max_speed_m_s")


@dataclass(frozen=True, slots=True)
class Origin:
    """The run that is gone on with."""

    path: Path
    run_id: str
    config: Config
    n_completed: int
    """Cycles completed, each counted once, those of the runs before it included."""
    n_recorded: int
    """Cycles whose end is in the file; fewer where the last second of a killed bench is not."""
    program_facts: dict[str, str] = field(default_factory=dict)
    """What the file says of the robot's program."""

    @property
    def has_program(self) -> bool:
        """Whether it says that it has a copy of it."""
        return bool(self.program_facts.get("sha256"))

    def read_program(self) -> ProgramFile | None:
        """Read the copy of the program out of the file; `RecordingError` if it is not there undamaged."""
        if not self.has_program:
            return None
        facts = self.program_facts
        program = ProgramFile(facts.get("file", ""), open_run(self.path).read_attachment(facts.get("attachment", "")))
        if program.sha256 != facts.get("sha256"):
            raise RecordingError(
                f"The copy of the program in {self.path} is not what its SHA-256 says.",
                hint="Give CONFIG, whose [robot] program_file names the copy.",
            )
        return program

    def to_metadata(self) -> dict[str, str]:
        """Return what the new file says of this one."""
        return {
            "run_id": self.run_id,
            "file": self.path.name,
            "completed": str(self.n_completed),
            "recorded": str(self.n_recorded),
        }

    def doubt_program(self, program: ProgramFile | None) -> str:
        """Return a sentence where one of the two runs has a copy of its program and the other has none; else empty."""
        if self.has_program == (program is not None):
            return ""
        without = "this run" if program is None else self.path.name
        return f"Whether the program is the one of {self.path.name} cannot be told: {without} has no copy of it."

    def describe(self) -> str:
        """Return one sentence for the log."""
        lost = self.n_completed - self.n_recorded
        return (
            f"Goes on with {self.path.name} after {self.n_completed} completed cycles; the cycle that was under way is "
            "driven again." + (f" Of {lost} of them the end was not recorded." if lost else "")
        )


def read_origin(path: Path) -> Origin:
    """Read what an interrupted run left.

    Parameters
    ----------
    path : Path
        Its ``x.mcap``, or the ``x.mcap.active`` of a bench that was killed; of a run in parts, the first.

    Raises
    ------
    RecordingError
        It cannot be read, or a bench is still writing it.
    RunError
        It is no run of cycles, or a later part of one.
    """
    if is_held(path):
        raise RecordingError(f"{path} is being written by a bench that still runs.", hint="Stop that one first.")
    run = open_run(path)
    if run.part_number > 1:
        raise RunError(
            f"{path} is part {run.part_number} of the run that begins in {run.first_part}.",
            hint=f"Go on with that: --resume {path.with_name(run.first_part)}.",
        )
    if "bench.import" in run.metadata or run.config.robot is None:
        raise RunError(f"{path} is an imported take: there is no run to go on with.")
    n_recorded = _count_recorded(run)
    n_completed = max(n_recorded, read_completed(path))
    return Origin(path, run.run_id, run.config, n_completed, n_recorded, run.metadata.get(PROGRAM, {}))


def _count_recorded(run: Run) -> int:
    before = run.metadata.get(RESUMED, {}).get("completed", "0")
    n_before = int(before) if before.isdecimal() else 0
    events = run[CYCLE]
    completed = np.unique(events.cycle_index[events.kind == CycleEventKind.COMPLETED])
    return n_before + len(completed)


def verify_origin(origin: Origin, config: Config, n_cycles: int, program: ProgramFile | None = None) -> None:
    """Check that a run of `n_cycles` in all with `config` and this copy of its program goes on with `origin`.

    Raises
    ------
    ConfigError
        It was another test: the keys that differ are named, or the program is another.
    RunError
        All cycles are done.
    """
    old, new = dict(_test_values(origin.config)), dict(_test_values(config))
    differing = sorted(key for key in old.keys() | new.keys() if old.get(key) != new.get(key))
    if differing:
        raise ConfigError(
            f"{origin.path} was another test: different are {', '.join(differing)}.",
            hint="Leave CONFIG out to go on with the file's own, or start a new run without --resume.",
        )
    _verify_program(origin, program)
    if origin.n_completed >= n_cycles:
        raise RunError(
            f"{origin.path} has {origin.n_completed} completed cycles; with --cycles {n_cycles} nothing is left to do.",
            hint="--cycles is the total, those of the interrupted run included.",
        )


def _verify_program(origin: Origin, program: ProgramFile | None) -> None:
    if origin.has_program and program is not None and program.sha256 != origin.program_facts["sha256"]:
        before, now = (describe_program_file(facts) for facts in (origin.program_facts, program.to_metadata()))
        raise ConfigError(
            f"{origin.path} was another test, with another program: {before}; now {now}.",
            hint="Go on with the program as it was, or start a new run without --resume.",
        )


def hash_test(config: Config) -> str:
    """Return the SHA-256 of what makes it the same test."""
    return hashlib.sha256(json.dumps(dict(_test_values(config)), sort_keys=True).encode()).hexdigest()


def _test_values(config: Config) -> Iterator[tuple[str, object]]:
    for key, value in _flatten(config.model_dump(mode="json", by_alias=True), ""):
        if (key in TEST_KEYS or key.startswith(TEST_TABLES)) and key not in FREE_KEYS:
            yield key, value


def _flatten(value: object, prefix: str) -> Iterator[tuple[str, object]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _flatten(inner, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, value
