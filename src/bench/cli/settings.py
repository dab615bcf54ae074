"""Configuration files as the commands take them; what reads them loads with the first one, not with `bench --help`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.errors import ConfigError

if TYPE_CHECKING:
    from bench.config import Config, ProgramFile

__all__ = [
    "ConfigArgument",
    "config_or_simulated",
    "program_or_none",
    "settings_or_none",
    "verify_run_name",
    "with_limits",
]

ConfigArgument = Annotated[
    Path | None, typer.Argument(metavar="[CONFIG]", help="Configuration file. Left out: the simulated bench.")
]
GATES = ("minimum_bend_radius_mm", "stretch", "axial_stiffness_n", "max_tension_n", "shorten")
"""Keys of [cable] that are limits of the analysis and not facts about the cable that was recorded."""


def config_or_simulated(path: Path | None) -> Config:
    """Load `path`, or the simulated bench on addresses that are free."""
    from bench.config import load_config, simulated_config

    if path is not None:
        return load_config(path)
    from bench.run import with_free_addresses

    return with_free_addresses(simulated_config())


def program_or_none(settings: Config, path: Path | None) -> ProgramFile | None:
    """Read the copy of the program that the configuration in the file `path` names, if it names one."""
    from bench.config import read_program_file

    return read_program_file(settings, path.parent) if path is not None else None


def settings_or_none(path: Path | None) -> Config | None:
    """Load the file of ``--config``; None when the recording's own configuration is to be used."""
    from bench.config import load_config

    return load_config(path) if path is not None else None


def verify_run_name(path: Path | None) -> None:
    """Check that a run file to be written is called like one, so that it is found as one; `ConfigError` otherwise."""
    if path is not None and path.suffix != ".mcap":
        raise ConfigError(
            f"{path} is to be a run file, whose name ends in .mcap.", hint=f"--output {path.with_suffix('.mcap')}"
        )


def with_limits(recorded: Config, settings: Config, path: Path) -> Config:
    """Return the recording's configuration with analysis, calibration and the cable's limits of `settings`."""
    if settings.cable.arc_length_m != recorded.cable.arc_length_m:
        print(
            f"warning: {path} was recorded with other marker places than --config gives; the recording's are kept.",
            file=sys.stderr,
        )
    limits = {name: getattr(settings.cable, name) for name in GATES}
    cable = recorded.cable.model_copy(update=limits)
    changes = {"analysis": settings.analysis, "cable": cable}
    if settings.calibration.measured is not None:
        changes["calibration"] = settings.calibration
    return recorded.model_copy(update=changes)
