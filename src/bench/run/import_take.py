"""A take becomes the same recording as a run: its frames through the same writer, its own clock as the run's."""

from __future__ import annotations

import hashlib
import json
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from bench.config import Config
from bench.drivers.takes import TICKS_PER_S, Take, TakeInfo, read_take
from bench.model import DeviceInfo, LogEntry, Severity, TrackerFrame
from bench.recording import POINTS, RunWriter
from bench.run.about import attach_calibration, describe_origin, find_versions
from bench.timing import Clock

__all__ = ["ImportSummary", "import_take"]

Progress = Callable[[str, float], None]
"""Told, now and then, what is being done and which share of that is done, 0…1."""

MAX_WAITING = 5_000
"""Frames in the recorder's queue before reading pauses: a take of any length needs memory for so many."""
FRAMES_PER_STEP = 1000
"""Frames between two words about the progress."""
LIBRARIES = ("cable-bench", "numpy", "mcap", "ezc3d", "pyarrow")


@dataclass(frozen=True, slots=True)
class ImportSummary:
    """What an import did."""

    path: Path
    """The run file."""
    info: TakeInfo
    warnings: tuple[str, ...]
    """Those of the take, and those of the take together with the configuration."""
    n_frames: int
    """Frames written."""
    points_min: int
    """Fewest points in a frame."""
    points_max: int
    """Most points in a frame."""
    bytes_written: int


class TakeClock:
    """The run's clock of an import: the take's own, which passes like the machine's until it is told the end."""

    speed = 1.0

    def __init__(self, clock: Clock, start_ns: int) -> None:
        self._clock = clock
        self._offset_ns = start_ns - clock.now_ns()
        self._reached_ns = start_ns

    def now_ns(self) -> int:
        return max(self._clock.now_ns() + self._offset_ns, self._reached_ns)

    def reach(self, now_ns: int) -> None:
        """Advance to `now_ns`, if that is later."""
        self._reached_ns = max(self._reached_ns, now_ns)

    def sleep_until_ns(self, deadline_ns: int) -> None:
        self._clock.sleep_until_ns(deadline_ns - self._offset_ns)


@dataclass(slots=True)
class FrameCount:
    """What has passed to the recorder."""

    n_frames: int = 0
    points_min: int = 0
    points_max: int = 0
    end_ns: int = 0

    def count(self, frame: TrackerFrame) -> None:
        n = len(frame.points_m)
        self.points_min = min(self.points_min, n) if self.n_frames else n
        self.points_max = max(self.points_max, n)
        self.n_frames += 1
        self.end_ns = frame.capture_ns


def import_take(
    take: Path,
    config: Config,
    config_toml: str,
    output: Path,
    clock: Clock,
    progress: Progress = lambda _step, _share: None,
) -> ImportSummary:
    """Write a take into a run file.

    Times are the take's own: device time from its frame 0, placed at its start where the file says when that was,
    else at 1970-01-01. Nothing is known about its clock, so no clock samples are written; the exit status is
    ``import``. When anything fails, no output is left behind.

    Parameters
    ----------
    take : Path
        A file that `bench.drivers.takes.read_take` reads.
    config : Config
        The configuration to analyse it with.
    config_toml : str
        The same, as it is to travel in the run file.
    output : Path
        The run file; it must not exist.
    clock : Clock
        The machine's time.
    progress : callable, optional
        Told what is being done and which share of it is done; a large take needs minutes.

    Returns
    -------
    ImportSummary

    Raises
    ------
    RecordingError
        The take cannot be read, or the run file cannot be written.
    RecordingExistsError
        `output` exists; it is not touched.
    """
    content = read_take(take, lambda share: progress("checking", share))
    warnings = (*content.info.warnings, *_config_warnings(content.info, config))
    take_clock = TakeClock(clock, content.info.start_ns)
    imported = datetime.fromtimestamp(clock.now_ns() * 1e-9, tz=UTC)
    writer = RunWriter(
        output,
        take_clock,
        config_toml=config_toml,
        versions=find_versions(LIBRARIES),
        run_id=str(uuid.uuid4()),
        queue_limit=MAX_WAITING,
        attachments=attach_calibration(config),
        extra={
            "bench.facts": describe_origin(config) | {"simulated": "false"},
            "bench.import": _describe_import(take, content.info, warnings, imported),
        },
        split_bytes=config.run.split_bytes,
    )
    try:
        passed = _write(writer, take_clock, take.name, content, warnings, progress)
        path = writer.close(exit_status="import", reason=f"imported from {take.name}")
    except BaseException:
        writer.discard()  # the take still has everything
        raise
    return ImportSummary(
        path, content.info, warnings, passed.n_frames, passed.points_min, passed.points_max, writer.bytes_written
    )


def _write(
    writer: RunWriter, take_clock: TakeClock, name: str, take: Take, warnings: tuple[str, ...], progress: Progress
) -> FrameCount:
    """Hand all of the take to the recorder, never faster than it writes; return what that was."""
    info = take.info
    writer.add_device(_device_info(name, info))
    writer.put_all(LogEntry(info.start_ns, Severity.WARN, "tracker", warning) for warning in warnings)
    passed = FrameCount(end_ns=info.start_ns)
    writer.put_all(_counted(take, passed, progress))
    if info.frames_promised is not None and info.frames_promised > passed.n_frames:
        writer.note_missed(POINTS, info.frames_promised - passed.n_frames)
    take_clock.reach(passed.end_ns)
    return passed


def _counted(take: Take, passed: FrameCount, progress: Progress) -> Iterator[TrackerFrame]:
    for frame in take.frames:
        passed.count(frame)
        if passed.n_frames % FRAMES_PER_STEP == 0:
            progress("writing", passed.n_frames / take.info.frames_found)
        yield frame


def _device_info(name: str, info: TakeInfo) -> DeviceInfo:
    detail = {
        "format": info.format,
        "units": info.units,
        "stamp": info.stamp.name.lower(),
        "ticks_per_s": str(TICKS_PER_S),
        "time_origin": info.time_origin,
        "capture_start": info.capture_start,
        "body_markers": json.dumps(info.body_markers),
        "marker_names": json.dumps({str(key): name for key, name in info.marker_names.items()}),
        **info.detail,
    }
    return DeviceInfo(
        device="tracker",
        kind="take",
        address=name,
        version=f"{info.format} {info.version}".strip(),
        rate_hz=info.rate_hz,
        bodies=info.bodies,
        detail=detail,
    )


def _describe_import(take: Path, info: TakeInfo, warnings: tuple[str, ...], imported: datetime) -> dict[str, str]:
    with take.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {
        "file": take.name,
        "sha256": digest,
        "format": f"{info.format} {info.version}".strip(),
        "frames_promised": "" if info.frames_promised is None else str(info.frames_promised),
        "frames_found": str(info.frames_found),
        "time_origin": info.time_origin,
        "warnings": json.dumps(warnings),
        "imported_utc": imported.isoformat(timespec="seconds"),
    }


def _config_warnings(info: TakeInfo, config: Config) -> list[str]:
    """Return one sentence for each rigid body that the configuration names and the take does not have."""
    held = ", ".join(f"'{name}'" for name in info.bodies.values()) or "none"
    anchors = {"cable.anchor": config.cable.anchor, "cable.end": config.cable.end}
    return [
        f"The configuration's {key} is the rigid body '{anchor.name}', which the take does not have (it has {held})."
        for key, anchor in anchors.items()
        if anchor is not None and anchor.kind == "rigid_body" and anchor.name not in info.bodies.values()
    ]
