"""What was run, in words: devices, program, times, sample; and the versions of what took part."""

from __future__ import annotations

import hashlib
import platform
from datetime import UTC, datetime
from importlib.metadata import version

import numpy as np

from bench.analysis import describe_source
from bench.config import Calibration, Config, describe_loaded_program, describe_program_file, to_toml
from bench.model import RunState
from bench.recording import STATE, Run
from bench.report.host_clock import describe_host_clock
from bench.report.outcome import IMPORT, UNFINISHED, RunEnd
from bench.report.results import CycleColumns
from bench.report.source import TrackerFrames
from bench.report.wording import RECORDED, say_count

__all__ = ["count_driven", "find_versions", "hash_config", "read_run_end", "state_facts"]


def hash_config(config: Config) -> str:
    """Return the SHA-256 of the resolved configuration, defaults included."""
    return hashlib.sha256(to_toml(config).encode()).hexdigest()


def find_versions(run: Run) -> dict[str, str]:
    """Return the versions that recorded and those that analyse."""
    versions = {f"{RECORDED}{name}": text for name, text in run.versions.items()}
    versions["bench"] = version("cable-bench")
    versions["python"] = platform.python_version()
    versions["numpy"] = np.__version__
    return versions


def read_run_end(run: Run) -> RunEnd:
    """Return how the run ended; a file without an end is unfinished."""
    reason = run.exit_reason if run.exit_status != UNFINISHED else run.status.text
    return RunEnd(run.exit_status, reason)


def count_driven(run: Run, config: Config) -> int | None:
    """Return the cycles of a run whose program waits for no grant, and so begins another before it is stopped.

    None where no cycle can be too many, and where the run did not end in good order: then all that was recorded counts.
    """
    if config.robot is None or config.robot.cycle.is_granted or RunState.STOPPING not in run[STATE].state:
        return None
    completed = run.metadata.get("bench.cycles", {}).get("completed", "")
    return int(completed) if completed.isdecimal() else None


def state_facts(run: Run, frames: TrackerFrames, cycles: CycleColumns, config: Config) -> dict[str, str]:
    """Return what was run, in the order shown; what is not known is left out."""
    recorded = run.metadata.get("bench.run", {})
    facts = {
        "Run": config.run.name,
        "Sample": config.run.sample_id,
        "Operator": config.run.operator,
        "Started": _start(recorded.get("started_utc", "")),
        "Duration": _duration(frames),
        "Cycles": say_count(len(cycles.cycle_index)),
        "Frames": say_count(len(frames)),
        "Cable": _cable(config),
        "Program": config.robot.program if config.robot else "",
        "Loaded program": describe_loaded_program(run.metadata.get("bench.program", {})),
        "Program file": describe_program_file(run.metadata.get("bench.program", {})),
        "Cycle source": _cycle_source(run, config),
        "Clock speed": _speed(recorded.get("clock_speed", "1.0")),
        "Host clock": describe_host_clock(run),
        **_calibration(config.calibration.measured),
        "Imported on" if run.exit_status == IMPORT else "Recorded on": recorded.get("host_name", ""),
        "Run id": recorded.get("run_id", ""),
    }
    for device in run.devices:
        facts[device.device.capitalize()] = " ".join(
            word for word in (device.kind, device.version, f"at {device.address}" if device.address else "") if word
        )
    return {name: text for name, text in facts.items() if text}


def _calibration(calibration: Calibration | None) -> dict[str, str]:
    if calibration is None:
        return {}
    time = calibration.time
    offset = f"{time.offset_ms:+.3f} ms (sd {time.offset_sd_ms:.3f} ms) added to the tracker's times"
    return {"Time offset": offset, "Calibration": f"{calibration.run_file}, calculated {calibration.created_utc}"}


def _cycle_source(run: Run, config: Config) -> str:
    if config.robot is None:
        return ""
    name, accuracy = describe_source(config.robot.cycle)
    recorded = run.metadata.get("bench.cycle_source", {})
    name, accuracy = recorded.get("source", name), recorded.get("accuracy", accuracy)
    granted = "" if config.robot.cycle.is_granted else "; not granted one by one"
    return f"{name}: {accuracy}{granted}"


def _start(utc: str) -> str:
    """Return when the run began, as all other times on the page; a take does not always say it."""
    try:
        begun = datetime.fromisoformat(utc).astimezone(UTC)
    except ValueError:
        return utc
    return "" if begun.year == 1970 else f"{begun:%Y-%m-%d %H:%M:%S} UTC"


def _duration(frames: TrackerFrames) -> str:
    if len(frames) < 2:
        return ""
    first, last = int(frames.time_ns.min()), int(frames.time_ns.max())
    seconds = (last - first) * 1e-9
    if first < 86_400 * 10**9:  # a take that does not say when it began
        return f"{seconds:.1f} s"
    begun = datetime.fromtimestamp(first * 1e-9, tz=UTC)
    return f"{seconds:.1f} s of frames from {begun:%Y-%m-%d %H:%M:%S} UTC"


def _cable(config: Config) -> str:
    cable = config.cable
    return (
        f"{cable.length_m * 1e3:g} mm long, {cable.diameter_mm:g} mm thick, {len(cable.arc_length_m)} markers, "
        f"bend radius at least {cable.minimum_bend_radius_mm:g} mm"
    )


def _speed(text: str) -> str:
    return "" if float(text) == 1.0 else f"{float(text):g} times real time (simulated bench)"
