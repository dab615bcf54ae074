"""Runs the command ``bench`` as a user does: in a process of its own."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from pathlib import Path

from bench.config import simulated_config_text

_hosts = itertools.count(1)
_WORKER = 1 + int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
"""Test processes that run side by side have addresses of their own."""


def bench(*arguments: str | Path, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "bench", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)


def start_bench(*arguments: str | Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "bench", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def simulated_text(*changes: tuple[str, str]) -> str:
    """Return the simulated bench's configuration on addresses of its own, with replacements made."""
    number = next(_hosts)
    text = simulated_config_text()
    for old, new in [
        ("127.0.0.21", f"127.{_WORKER}.41.{number}"),
        ("127.0.0.22", f"127.{_WORKER}.42.{number}"),
        *changes,
    ]:
        assert old in text, f"{old!r} is not in the simulated configuration"
        text = text.replace(old, new)
    return text


def simulated_file(folder: Path, *changes: tuple[str, str]) -> Path:
    path = folder / "simulated.toml"
    path.write_text(simulated_text(*changes), encoding="utf-8")
    return path


def one_sentence(process: subprocess.CompletedProcess[str], code: int) -> str:
    """Check that a command failed as it should: exit code, one error on stderr, no traceback; return it."""
    assert process.returncode == code, process.stderr + process.stdout
    assert "Traceback" not in process.stderr
    assert process.stderr.startswith("error: ")
    return process.stderr
