"""How a loop is compiled: once for a machine where a cache can be written, else once for a process."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

__all__ = ["compiled"]

Loop = TypeVar("Loop", bound=Callable[..., object])
PREFIX = "compiled-"


def compiled(loop: Loop) -> Loop:
    """Compile a function of arrays and numbers at its first call; its plain Python stays callable as ``py_func``."""
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
