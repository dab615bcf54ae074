"""What goes into a run besides its configuration, and what comes out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bench.config import ProgramFile
from bench.model import RecorderStats
from bench.run.live_process import LiveAddress
from bench.run.progress import Ending
from bench.run.resume import Origin

__all__ = ["RunOptions", "RunSummary"]


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What the command line adds to the configuration."""

    n_cycles: int
    output: Path | None = None
    speed: float = 1.0
    truth: Path | None = None
    origin: Origin | None = None
    """The run that is gone on with; `n_cycles` is the total of both."""
    program: ProgramFile | None = None
    """Copy of the robot's program that travels in the run file."""
    live: LiveAddress | None = None
    """Where the live view is served; None: it is not."""

    @property
    def n_before(self) -> int:
        """Cycles that are done already."""
        return self.origin.n_completed if self.origin else 0


@dataclass(frozen=True, slots=True)
class RunSummary:
    """How a run ended and what it left."""

    path: Path | None
    """The run file, or its first part; None when nothing was driven, so that none was kept."""
    ending: Ending
    n_completed: int
    n_cycles: int
    stats: dict[str, RecorderStats]
    bytes_written: int
    cycles_s: float
    """Sum of the cycles' durations, in the run's own time."""
    warnings: list[str]
    n_parts: int = 1
    """Files that the recording was split into."""
