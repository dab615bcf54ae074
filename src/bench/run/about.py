"""What a run file says of where it comes from: metadata ``bench.facts`` and the versions of what made it."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version

from bench.analysis import describe_source
from bench.config import Config, ProgramFile, to_toml

__all__ = ["attach_calibration", "attach_program", "describe_cycle_source", "describe_origin", "find_versions"]


def describe_origin(config: Config) -> dict[str, str]:
    """Return who ran what, and on which machine."""
    return {
        "name": config.run.name,
        "sample_id": config.run.sample_id,
        "operator": config.run.operator,
        "platform": platform.platform(),
        "python": platform.python_version(),
    }


def describe_cycle_source(config: Config, rate_hz: float) -> dict[str, str]:
    """Return what tells the cycles and how well, for a robot that gives `rate_hz` samples a second."""
    if config.robot is None:
        return {}
    name, accuracy = describe_source(config.robot.cycle)
    return {"source": name, "accuracy": f"{accuracy}; a sample comes every {1e3 / rate_hz:.3g} ms"}


def attach_calibration(config: Config) -> dict[str, str]:
    """Return the calibration that a configuration uses as a text by its file name; nothing without one."""
    measured = config.calibration.measured
    return {} if measured is None else {"calibration.toml": to_toml(measured)}


def attach_program(program: ProgramFile | None) -> dict[str, bytes]:
    """Return the copy of the robot's program by the name of its attachment; nothing without one."""
    return {} if program is None else {program.attachment: program.content}


def find_versions(libraries: Iterable[str]) -> dict[str, str]:
    """Return the version of each distribution; what is not installed took no part."""
    versions = {}
    for name in libraries:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return versions
