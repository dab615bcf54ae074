"""The copy of the robot's program that travels in a run file, as ``[robot] program_file`` names it."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from bench.config.models import Config
from bench.errors import ConfigError

__all__ = [
    "LARGEST_PROGRAM",
    "ProgramFile",
    "describe_loaded_program",
    "describe_program_file",
    "read_program_file",
]

LARGEST_PROGRAM = 16_000_000
"""Bytes. A program is kilobytes, packed with its installation some hundred; what is larger is a backup or a mistake,
and it would be held in memory and stand in every run file."""
HINT = "[robot] program_file is a copy of the program, as saved from the controller; its folder is the configuration's."


@dataclass(frozen=True)
class ProgramFile:
    """A program's file as it was when the run began."""

    name: str
    """What the file is called, without its folder."""
    content: bytes

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the content, as ``sha256sum`` prints it."""
        return hashlib.sha256(self.content).hexdigest()

    @property
    def attachment(self) -> str:
        """Name in the run file: ``program`` with the file's suffix, so that no file name leads anywhere."""
        suffix = re.search(r"\.[A-Za-z0-9]{1,16}$", self.name)
        return "program" + (suffix.group() if suffix else "")

    def to_metadata(self) -> dict[str, str]:
        """Return what the run file says of it, under ``bench.program``."""
        return {
            "file": self.name,
            "sha256": self.sha256,
            "bytes": str(len(self.content)),
            "attachment": self.attachment,
        }


def describe_program_file(facts: dict[str, str]) -> str:
    """Return what metadata ``bench.program`` says of the copy, in one line; empty if there is none."""
    if not facts.get("sha256"):
        return ""
    return f"{facts.get('file', '')}, {facts.get('bytes', '')} bytes, SHA-256 {facts['sha256']}"


def describe_loaded_program(facts: dict[str, str]) -> str:
    """Return what metadata ``bench.program`` says of the program that the controller had loaded, in one line."""
    if not facts.get("loaded_sha256"):
        return facts.get("loaded", "")
    return f"{facts.get('loaded', '')}, {facts.get('loaded_bytes', '')} bytes, SHA-256 {facts['loaded_sha256']}"


def read_program_file(config: Config, folder: Path) -> ProgramFile | None:
    """Read the copy of the program that a configuration names; None where it names none.

    Parameters
    ----------
    config : Config
    folder : Path
        Where the configuration file is.

    Raises
    ------
    ConfigError
        The file cannot be read, is empty, or is larger than `LARGEST_PROGRAM`.
    """
    if config.robot is None or not config.robot.program_file:
        return None
    path = folder / config.robot.program_file
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_PROGRAM + 1)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"The program file {path} cannot be read: {reason}.", hint=HINT) from error
    if not content:
        raise ConfigError(f"The program file {path} is empty.", hint=HINT)
    if len(content) > LARGEST_PROGRAM:
        raise ConfigError(
            f"The program file {path} has more than the {LARGEST_PROGRAM / 1e6:g} MB that may travel in a run file.",
            hint=HINT,
        )
    return ProgramFile(path.name, content)
