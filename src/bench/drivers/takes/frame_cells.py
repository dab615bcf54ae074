"""Lines of different lengths, split into cells all at once: what no reader of tables does.

Of a block of text all commas and line ends are found in one pass; what stands between them becomes one long column of
cells, and the numbers of a whole block are then made in a few steps, whatever the length of each line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from pyarrow import compute

from bench.drivers.takes.rows import Floats, Ints

__all__ = ["FrameCells"]

COMMA, LINE_END = b",\n"


@dataclass(frozen=True, slots=True, eq=False)
class FrameCells:
    """The cells of n lines, one after the other."""

    text: pa.StringArray
    first: Ints
    """(n,): index of each line's first cell."""
    count: Ints
    """(n,): number of cells in each line."""

    @classmethod
    def of(cls, data: bytes) -> FrameCells:
        """Split lines that hold no quotes; each ends in a line feed."""
        letters = np.frombuffer(data, np.uint8)
        is_end = letters == LINE_END
        is_gap = is_end | (letters == COMMA)
        gaps = np.flatnonzero(is_gap)
        ends = np.zeros(len(gaps) + 1, np.int32)
        ends[1:] = gaps - np.arange(len(gaps))
        text = pa.StringArray.from_buffers(len(gaps), pa.py_buffer(ends), pa.py_buffer(letters[~is_gap]))
        last = np.flatnonzero(is_end[gaps])
        first = np.concatenate([[0], last[:-1] + 1])
        return cls(text, first, last - first + 1)

    def floats(self, index: Ints) -> Floats:
        """Return the numbers in the cells at `index`. `ValueError` if one is no number."""
        numbers: Floats = compute.cast(self._take(index), pa.float64()).to_numpy()  # Arrow's error is a ValueError
        return numbers.reshape(index.shape)

    def ints(self, index: Ints) -> Ints:
        """Return the whole numbers in the cells at `index`, from 0. `ValueError` if one is none."""
        text = self._take(index)
        if compute.any(compute.match_substring(text, "x", ignore_case=True)).as_py():
            raise ValueError("Arrow takes 0x1F for a whole number")
        numbers: Ints = compute.cast(text, pa.uint32()).to_numpy().astype(np.int64)
        return numbers.reshape(index.shape)

    def _take(self, index: Ints) -> pa.StringArray:
        return self.text.take(pa.array(index.ravel()))
