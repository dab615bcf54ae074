"""Runs the command ``bench`` as a user does, and returns what a user sees."""

from __future__ import annotations

import io
import itertools
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from unittest.mock import patch

from bench.cli import main
from bench.config import simulated_config_text

OWN_PROCESS = {"run", "check", "live", "simulate"}
"""Commands that keep pace, take signals or start children. The pages of the documentation start the others so, too."""

_hosts = itertools.count(1)
_WORKER = 1 + int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
"""Test processes that run side by side have addresses of their own."""


def bench(*arguments: str | Path, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    """Run a command to its end: in a process of its own, or in this one, which has loaded most libraries already."""
    words = [str(argument) for argument in arguments]
    if words[0] not in OWN_PROCESS:
        return _run_here(words)
    command = [sys.executable, "-m", "bench", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)


def _run_here(words: list[str]) -> subprocess.CompletedProcess[str]:
    code, out, err = 0, io.StringIO(), io.StringIO()
    with patch.object(sys, "argv", ["bench", *words]), redirect_stdout(out), redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
    return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())


def start_bench(*arguments: str | Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "bench", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def run_and_report(folder: Path, config: Path, n_cycles: int, speed: float) -> str:
    """Leave `a.mcap`, `truth.parquet` and the report's folder `a`; return what the run said."""
    files = ("--output", folder / "a.mcap", "--truth", folder / "truth.parquet")
    run = bench("run", config, "--cycles", str(n_cycles), "--speed", f"{speed:g}", *files)
    assert run.returncode == 0, run.stderr + run.stdout
    report = bench("report", folder / "a.mcap", "--output", folder / "a")
    assert report.returncode == 0, report.stderr + report.stdout
    return run.stdout


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
