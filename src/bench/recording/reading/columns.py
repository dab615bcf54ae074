"""One topic of a run as numpy arrays, and the memory they are in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["HEAD_COLUMNS", "Array", "Columns", "allocate_columns"]

Array = npt.NDArray[Any]

HEAD_COLUMNS: Mapping[str, npt.DTypeLike] = {
    "log_time_ns": np.int64,
    "publish_time_ns": np.int64,
    "sequence": np.int64,
}
"""What every topic has besides its fields."""
BLOCK_BYTES = 16 << 20
"""Columns share blocks of memory of this size: numpy asks for large pages from 4 MiB on, and filling columns of 2 MiB
each in small pages took five times as long (Linux, measured 2026-11). Who keeps one column keeps its block."""
LARGE_PAGE = 2 << 20
_CACHE_LINE = 64


class Columns(Mapping[str, Array]):
    """One topic as numpy arrays of the same length, by ``columns["name"]`` or ``columns.name``.

    Names are those of the record's fields in `bench.model`; besides them ``log_time_ns`` (arrival),
    ``publish_time_ns`` (capture) and ``sequence``. Vectors have shape (n, 3), (n, 4) or (n, 6). Texts are arrays of
    `str` (dtype object). ``offsets``, where a topic has it, is one longer than the number of frames.
    """

    def __init__(self, arrays: Mapping[str, Array]) -> None:
        self._arrays = dict(arrays)

    def __getitem__(self, name: str) -> Array:
        return self._arrays[name]

    def __getattr__(self, name: str) -> Array:
        try:
            return self.__dict__["_arrays"][name]  # type: ignore[no-any-return]
        except KeyError:
            raise AttributeError(f"no column '{name}'; there are: {', '.join(sorted(self))}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._arrays]

    def __repr__(self) -> str:
        shapes = ", ".join(f"{name} {array.dtype}{list(array.shape)}" for name, array in self._arrays.items())
        return f"Columns({shapes})"


def allocate_columns(kinds: Mapping[str, npt.DTypeLike], n_rows: int) -> dict[str, Array]:
    """Return columns of `n_rows` that are not filled yet; a vector's kind, ``("<f8", (6,))``, makes one of (n, 6)."""
    columns: dict[str, Array] = {}
    block: dict[str, tuple[np.dtype[Any], int]] = {}
    size = 0
    for name, kind in kinds.items():
        dtype = np.dtype(kind)
        block[name] = dtype, size
        size += -(-dtype.itemsize * n_rows // _CACHE_LINE) * _CACHE_LINE
        if size >= BLOCK_BYTES:
            columns |= _cut_block(block, size, n_rows)
            block, size = {}, 0
    return columns | _cut_block(block, size, n_rows)


def _cut_block(block: Mapping[str, tuple[np.dtype[Any], int]], size: int, n_rows: int) -> dict[str, Array]:
    memory = np.empty(size + 2 * LARGE_PAGE, np.uint8)  # what is never filled takes no memory
    start = -memory.ctypes.data % LARGE_PAGE
    return {name: np.ndarray((n_rows,), dtype, memory, start + place) for name, (dtype, place) in block.items()}
