"""Compiled code is kept for exactly the sources that it was compiled from, and where it can be written."""

import gc
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import pytest
from numba.core import event

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


class Watch(event.Listener):  # type: ignore[misc]
    """Notes whether garbage is collected while a loop is compiled."""

    def __init__(self) -> None:
        self.collecting: list[bool] = []

    def on_start(self, _: Any) -> None:
        self.collecting.append(gc.isenabled())

    def on_end(self, _: Any) -> None:
        pass


def compile_as_kernel(loop: Callable[[float], float]) -> float:
    """Compile a copy of a loop as one of the analysis, kept nowhere; return what it makes of 2."""
    kernel = type(loop)(loop.__code__, {"__name__": f"{compiling.__package__}.example"})
    return float(numba.njit(kernel)(2.0))


def test_the_wait_is_explained_once_and_no_garbage_is_collected_meanwhile(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(compiling.wait, "is_explained", False)
    watch = Watch()
    with event.install_listener("numba:compile", watch):
        assert [compile_as_kernel(add_one) for _ in range(2)] == [3.0, 3.0]
    assert watch.collecting == [False, False]
    assert gc.isenabled()
    assert caplog.messages == ["Compiling the loops of the analysis, once on this machine: up to 15 s."]


def test_other_users_of_numba_are_left_alone(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(compiling.wait, "is_explained", False)
    watch = Watch()
    with event.install_listener("numba:compile", watch):
        assert numba.njit(add_one)(2.0) == 3.0
    assert watch.collecting == [True]
    assert caplog.messages == []


def test_a_wait_in_every_process_is_said_with_its_cause(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(_: Path, name: str) -> Path:
        raise PermissionError(name)

    monkeypatch.setattr(compiling, "_make", refuse)
    monkeypatch.setattr(compiling.wait, "is_explained", False)
    find_cache.cache_clear()
    compile_as_kernel(add_one)
    find_cache.cache_clear()
    assert "in each process, for neither the package's folder nor the user's cache can be written" in caplog.messages[0]
