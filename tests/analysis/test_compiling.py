"""Compiled code is kept for exactly the sources that it was compiled from, and where it can be written."""

import shutil
from pathlib import Path

import numba
import pytest

from bench.analysis.kernels import compiling
from bench.analysis.kernels.compiling import compiled, find_cache


def add_one(value: float) -> float:
    return value + 1.0


def test_a_compiled_loop_is_the_plain_one_and_other_users_of_numba_keep_their_cache() -> None:
    before = numba.config.CACHE_DIR
    loop = compiled(add_one)
    assert loop(2.0) == add_one(2.0) == loop.py_func(2.0)
    assert before == numba.config.CACHE_DIR


def test_another_source_has_another_folder_and_the_old_one_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "analysis"
    shutil.copytree(Path(compiling.__file__).parent, package / "kernels", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(compiling, "__file__", str(package / "kernels" / "compiling.py"))
    find_cache.cache_clear()
    first = find_cache()
    find_cache.cache_clear()
    assert find_cache() == first
    (package / "constants.py").write_text("LIMIT = 3\n")
    find_cache.cache_clear()
    second = find_cache()
    find_cache.cache_clear()
    assert second != first
    assert second.is_dir()
    assert not first.exists()


def test_without_a_folder_to_write_in_loops_are_compiled_for_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: Path, name: str) -> Path:
        raise PermissionError(name)

    monkeypatch.setattr(compiling, "_make", refuse)
    find_cache.cache_clear()
    assert compiled(add_one)(3.0) == 4.0
    find_cache.cache_clear()
