"""How a loop is compiled: once for a machine where a cache can be written, else once for a process."""

from __future__ import annotations

import gc
import hashlib
import logging
import os
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event

__all__ = ["compiled"]

Loop = TypeVar("Loop", bound=Callable[..., object])
PREFIX = "compiled-"
_log = logging.getLogger(__name__)


def compiled(loop: Loop) -> Loop:
    """Compile a function of arrays and numbers at its first call; its plain Python stays callable as ``py_func``.

    A row is filled number by number: from ``row[:] = other`` numba makes code for the words of an error about unequal
    lengths, which takes 1.5 s, as long as ten loops.
    """
    config: Any = numba.config
    before = config.CACHE_DIR
    try:
        config.CACHE_DIR = str(find_cache())  # read by njit here and now; other users of numba keep theirs
        return cast(Loop, numba.njit(cache=True, nogil=True)(loop))
    except (OSError, RuntimeError):  # neither the package's folder nor the user's cache can be written
        return cast(Loop, numba.njit(nogil=True)(loop))
    finally:
        config.CACHE_DIR = before


@cache
def find_cache() -> Path:
    """Return the folder for compiled code of exactly these sources.

    numba by itself asks only for the date of the file that a loop stands in: what that file imports could change, and
    the old code would go on running. So the folder's name is a hash of all of the analysis; other folders are removed.

    Raises
    ------
    OSError
        It cannot be made, here or in the user's cache.
    """
    name = PREFIX + _hash_sources(Path(__file__).parents[1])
    beside = Path(__file__).parent / "__pycache__"
    try:
        return _make(beside, name)
    except OSError:
        return _make(Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cable-bench", name)


def _hash_sources(folder: Path) -> str:
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _make(parent: Path, name: str) -> Path:
    folder = parent / name
    if not folder.is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        for stale in parent.glob(f"{PREFIX}*"):
            if stale != folder:
                shutil.rmtree(stale, ignore_errors=True)
    if not os.access(folder, os.W_OK):
        raise PermissionError(f"{folder} cannot be written")
    return folder


class Wait(event.Listener):
    """What is done while a loop of the analysis is compiled: the wait is explained, once, and kept short.

    Compiling makes millions of objects that refer to each other; looking for garbage among them takes a fifth of the
    time, so it waits until the loop is compiled.
    """

    def __init__(self) -> None:
        self.is_explained = False
        self._depth = 0
        """Loops being compiled: one, and those that it calls."""
        self._collects = False

    def on_start(self, started: Any) -> None:
        if self._depth == 0:
            if not started.data["dispatcher"].py_func.__module__.startswith(__package__):
                return
            self._collects = gc.isenabled()
            gc.disable()
            self._explain()
        self._depth += 1

    def on_end(self, _: Any) -> None:
        if self._depth == 0:
            return
        self._depth -= 1
        if self._depth == 0 and self._collects:
            gc.enable()

    def _explain(self) -> None:
        if not self.is_explained:
            self.is_explained = True
            _log.warning("Compiling the loops of the analysis, %s: up to 15 s.", _say_how_often())


def _say_how_often() -> str:
    try:
        find_cache()
    except OSError:
        return "in each process, for neither the package's folder nor the user's cache can be written"
    return "once on this machine"


wait = Wait()
event.register("numba:compile", wait)  # type: ignore[no-untyped-call]
