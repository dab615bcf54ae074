"""A folder in which the documentation's examples run, page by page, as a reader would run them."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import tomli_w
import typer
from markdown_pages import CONFIGS, ROOT, Block, find_commands

from bench.cli.app import app
from bench.config import Config, parse_config

PATIENCE_S = 120.0
FIRST_RUN = "bench run --cycles 3 --speed 5 --output"
"""A run of the packaged simulated bench, the same on several pages; the name of its file follows."""


class Workshop:
    """One page's folder.

    Parameters
    ----------
    folder : Path
        Where the commands run.
    loopback : str
        First three numbers of the loopback addresses that the page's configurations get, so that two pages, or a
        bench that somebody else runs here, are not in each other's way.
    first_run : Path
        What `FIRST_RUN` recorded: it is not driven once more for every page.
    """

    def __init__(self, folder: Path, loopback: str, first_run: Path) -> None:
        self._folder = folder
        self._loopback = loopback
        self._first_run = first_run
        self._names: dict[str, Any] = {"__name__": "documentation"}

    def follow(self, block: Block) -> None:
        """Do what a block says, and check that it works."""
        if block.language == "toml":
            self._take_toml(block)
        elif block.language == "python":
            code = compile(block.text, block.place, "exec")
            if all(find_spec(library) for library in block.notes.get("needs", "").split()):
                exec(code, self._names)
        elif block.language == "console":
            for command in find_commands(block):
                self._run(command, block)

    def _take_toml(self, block: Block) -> None:
        data = tomllib.loads(block.text)
        if is_whole(data):
            parse_config(block.text, block.place)
        else:
            parse_config(tomli_w.dumps(merge(_example_for(data), data)), block.place)
        if "file" in block.notes:
            self._folder.joinpath(block.notes["file"]).write_text(block.text, encoding="utf-8")
        if "edit" in block.notes:
            path = self._folder / block.notes["edit"]
            path.write_text(tomli_w.dumps(merge(tomllib.loads(path.read_text("utf-8")), data)), encoding="utf-8")

    def _run(self, command: str, block: Block) -> None:
        if not command.startswith("bench "):
            return
        if "lab only" in block.notes:
            for one in re.split(r"&&|\|", command):
                verify_options(shlex.split(one)[1:])
        elif "tried in" in block.notes:
            words = shlex.split(command)[1:]
            verify_options(words)
            assert f'bench("{words[0]}"' in (ROOT / block.notes["tried in"]).read_text(encoding="utf-8"), block.place
        elif not self._is_copied(command):
            self._run_really(command, block)

    def _is_copied(self, command: str) -> bool:
        output = self._folder / command.rpartition(" ")[2]
        if command != f"{FIRST_RUN} {output.name}" or output.exists():
            return False
        shutil.copy(self._first_run, output)
        return True

    def _run_really(self, command: str, block: Block) -> None:
        self._move_addresses()
        expected = [int(code) for code in block.notes.get("exit code", "0").split(" or ")]
        process = subprocess.run(
            ["bash", "-c", command], cwd=self._folder, env=_environment(self._folder), capture_output=True, text=True,
            timeout=PATIENCE_S, check=False,
        )  # fmt: skip
        assert process.returncode in expected, f"{block.place}: {command}\n{process.stdout}{process.stderr}"
        assert "Traceback" not in process.stderr

    def _move_addresses(self) -> None:
        for path in self._folder.glob("*.toml"):
            text = path.read_text(encoding="utf-8")
            path.write_text(text.replace("127.0.0.", f"{self._loopback}."), encoding="utf-8")


def is_whole(data: dict[str, Any]) -> bool:
    """Whether a TOML block is a whole configuration and not a part of one."""
    return "length_m" in data.get("cable", {})


def merge(base: dict[str, Any], change: dict[str, Any]) -> dict[str, Any]:
    """Return `base` with the keys of `change` put in, table by table."""
    merged = dict(base)
    for key, value in change.items():
        merged[key] = merge(base.get(key, {}), value) if isinstance(value, dict) else value
    return merged


def verify_options(arguments: list[str]) -> None:
    """Check that a command of ``bench`` exists and takes these arguments, without running it."""
    command: Any = typer.main.get_command(app)
    while hasattr(command, "commands"):
        command, arguments = command.commands[arguments[0]], arguments[1:]
    command.make_context(command.name, list(arguments))


def _example_for(part: dict[str, Any]) -> dict[str, Any]:
    """Return the whole configuration that a part of one belongs to."""
    name = "modbus_generic_plc" if part.get("robot", {}).get("kind") == "modbus" else "lab_example"
    data = tomllib.loads((CONFIGS / f"{name}.toml").read_text(encoding="utf-8"))
    assert Config.model_validate(data).robot is not None
    return data


def _environment(folder: Path) -> dict[str, str]:
    """Let ``bench`` be this very interpreter's, whatever else is installed."""
    shim = folder / ".bin" / "bench"
    if not shim.exists():
        shim.parent.mkdir()
        shim.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m bench "$@"\n', encoding="utf-8")
        shim.chmod(0o755)
    return {**os.environ, "PATH": f"{shim.parent}{os.pathsep}{os.environ.get('PATH', '')}"}
