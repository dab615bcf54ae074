"""What holds for every test: nothing is left behind, and shared recordings are found or the test says why not."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from hypothesis import settings

# The same examples in every run, so that a red suite means a change; HYPOTHESIS_PROFILE=search looks for new ones.
settings.register_profile("repeatable", derandomize=True)
settings.register_profile("search", derandomize=False)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

LEAK_PATIENCE_S = 5.0
"""A thread that was told to end may need a moment on a busy machine; one that was not never ends."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Name the real devices of a lab, for the tests that `-m hardware` selects."""
    lab = parser.getgroup("lab", "real devices; the robot MOVES")
    lab.addoption("--robot", metavar="HOST", help="address of a real robot controller")
    lab.addoption("--program", metavar="NAME", help="its program, with the bench's snippet")
    lab.addoption("--tracker", metavar="HOST", help="address of a real tracker")


@pytest.fixture(autouse=True)
def no_leaks() -> Iterator[None]:
    """Fail a test that leaves a thread or a child process behind. (Sockets and files: ResourceWarning is an error.)"""
    threads = set(threading.enumerate())
    children = set(psutil.Process().children())
    yield
    deadline = time.monotonic() + LEAK_PATIENCE_S
    while (left := _left_behind(threads, children)) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not left, f"left behind: {left}"


def _left_behind(threads: set[threading.Thread], children: set[psutil.Process]) -> list[str]:
    extra_threads = [t.name for t in set(threading.enumerate()) - threads if t.is_alive()]
    extra_children = [str(p) for p in set(psutil.Process().children()) - children if p.status() != "zombie"]
    return extra_threads + extra_children


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of real recordings that may be evaluated but not copied; skip where it is absent."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("BENCH_SHARED_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no shared recordings at {folder} (set BENCH_SHARED_DATA)")
    return folder
