"""What the controller tells of the program it has loaded, held against the copy of it and against an earlier run's."""

from __future__ import annotations

from bench.config import ProgramFile
from bench.drivers.base import ProgramControl, ProgramTeller
from bench.errors import DeviceError
from bench.run.resume import Origin

__all__ = ["ask_loaded", "doubt_loaded"]

EXPORTED = ".urpx"
"""Suffix of the files that are saved from what a controller gives out, so that both can be compared byte by byte."""


def ask_loaded(
    control: ProgramControl, copy: ProgramFile | None, origin: Origin | None
) -> tuple[dict[str, str], list[str]]:
    """Ask the controller; a run does not fail over what it does not tell.

    Returns
    -------
    told : dict
        For metadata ``bench.program``; empty where the controller tells nothing.
    doubts : list of str
        Sentences for the operator and the log.
    """
    try:
        told = control.tell_loaded() if isinstance(control, ProgramTeller) else {}
    except DeviceError as error:
        return {}, [f"Of the loaded program only the name is known: {error}"]
    return told, doubt_loaded(told, copy, origin)


def doubt_loaded(told: dict[str, str], copy: ProgramFile | None, origin: Origin | None) -> list[str]:
    """Return a sentence for each other program that should be the loaded one, and is not byte for byte."""
    name, digest = told.get("loaded", ""), told.get("loaded_sha256", "")
    before = origin.program_facts.get("loaded_sha256", "") if origin else ""
    found = []
    if digest and copy is not None and copy.name.endswith(EXPORTED) and copy.sha256 != digest:
        found.append(
            f"The copy {copy.name} is not what the controller gives out as '{name}': one of them was changed, or saved "
            "again, since it was taken."
        )
    if digest and origin is not None and before and before != digest:
        found.append(
            f"The controller's program '{name}' is not the one that {origin.path.name} was driven with: it was "
            "changed, or saved again."
        )
    return found
