"""What holds for every test: nothing is left behind, and shared recordings are found or the test says why not."""

from __future__ import annotations

import os
import re
import threading
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import psutil
import pytest
from hypothesis import settings
from xdist.scheduler import LoadScopeScheduling

# The same examples in every run, so that a red suite means a change; HYPOTHESIS_PROFILE=search looks for new ones.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("search", derandomize=False, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

LOOPBACK = re.compile(r"\b127\.(?!0\.0\.)\d+\.\d+\.\d+\b")
"""Addresses of tests. Those of packaged configurations, 127.0.0.N, are replaced by them, or served in docs alone."""
HELPERS = {path.stem: path for path in Path(__file__).parent.rglob("*.py") if not path.stem.startswith("test_")}
IMPORTED = re.compile(r"^(?:from|import) (\w+)", re.MULTILINE)
LEAK_PATIENCE_S = 5.0
"""A thread that was told to end may need a moment on a busy machine; one that was not never ends."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Name the real devices of a lab, for the tests that `-m hardware` selects."""
    lab = parser.getgroup("lab", "real devices; the robot MOVES")
    lab.addoption("--robot", metavar="HOST", help="address of a real robot controller")
    lab.addoption("--program", metavar="NAME", help="its program, with the bench's snippet")
    lab.addoption("--tracker", metavar="HOST", help="address of a real tracker")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadScopeScheduling:
    """Let test files that serve the same loopback addresses run one after the other, in the same process."""
    groups = _group_files()

    class Scheduler(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            path = nodeid.partition("::")[0]
            return groups[str(config.rootpath / path)]

    return Scheduler(config, log)


def _group_files() -> dict[str, str]:
    """Return the name of each test file's group."""
    groups: dict[str, str] = {}
    for path in sorted(Path(__file__).parent.rglob("test_*.py")):
        local = path.with_name("conftest.py")  # what it makes once for a session is not to be made twice
        places = {str(path), *_addresses(path)} | ({str(local)} if local.exists() else set())
        joined = {groups[place] for place in places if place in groups}
        name = min(joined, default=path.stem)
        groups |= {place: name for place, group in groups.items() if group in joined} | dict.fromkeys(places, name)
    return groups


@cache
def _addresses(test_file: Path) -> set[str]:
    """Return the loopback addresses a test file names, or its conftest, or a helper they import from the tests."""
    found: set[str] = set()
    known, waiting = {test_file}, [test_file, test_file.with_name("conftest.py")]
    while waiting:
        path = waiting.pop()
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        found.update(LOOPBACK.findall(text))
        helpers = {HELPERS[name] for name in IMPORTED.findall(text) if name in HELPERS} - known
        known |= helpers
        waiting.extend(helpers)
    return found


@pytest.fixture(autouse=True)
def no_leaks() -> Iterator[None]:
    """Fail a test that leaves a thread or a child process behind. (Sockets and files: ResourceWarning is an error.)"""
    threads = set(threading.enumerate())
    children = _children()
    yield
    deadline = time.monotonic() + LEAK_PATIENCE_S
    while (left := _left_behind(threads, children)) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not left, f"left behind: {left}"


def _left_behind(threads: set[threading.Thread], children: set[psutil.Process]) -> list[str]:
    extra_threads = [t.name for t in set(threading.enumerate()) - threads if t.is_alive()]
    extra_children = [str(p) for p in _children() - children if p.status() != "zombie"]
    return extra_threads + extra_children


def _children() -> set[psutil.Process]:
    try:  # one call of the system says that there are none; psutil reads every process of the machine
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return set()
    return set(psutil.Process().children())


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of real recordings that may be evaluated but not copied; skip where it is absent."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("BENCH_SHARED_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no shared recordings at {folder} (set BENCH_SHARED_DATA)")
    return folder
