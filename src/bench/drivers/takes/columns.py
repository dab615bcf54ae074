"""Tables with one row a frame: all of a block's numbers at once, and only what is odd line by line.

A block is read by Arrow's CSV reader where every cell of it is plain. Where one is not, the same block is read cell by
cell: it may still be whole (blank lines, spaces, a spreadsheet's additions), and if it is not, the cell is named.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from pyarrow import csv

from bench.drivers.takes.grid import MAX_FRAME_NUMBER, MAX_TIME_S
from bench.drivers.takes.rows import Floats, Mask, Rows, Stamps
from bench.drivers.takes.take import MAX_POSITION_M, Words
from bench.drivers.takes.text import LINE_FEED, Block, Progress, TextFile, float_cell, int_cell, split_cells

__all__ = ["ColumnTable", "NumberBlock", "make_rows"]

NAN = float("nan")
HEAD_BYTES = 64
"""Of a line: frame number and time are within them, or the line is read whole."""
FRAME = 0
"""The frame number's column; 32 bits, as `MAX_FRAME_NUMBER` has."""


@dataclass(frozen=True, slots=True, eq=False)
class NumberBlock:
    """n rows of a table."""

    stamps: Stamps
    values: Floats
    """(n, m): the columns that were asked for; NaN where the cell is blank."""


@dataclass(frozen=True, slots=True)
class ColumnTable:
    """Where in a text file the table is, and what its columns are."""

    file: TextFile
    delimiter: str
    first_row: int
    """Line number of the first row of data."""
    labels: tuple[str, ...]
    """For messages: what each column is."""
    time_column: int | None

    def read(
        self, columns: Sequence[int] = (), cut: list[int] | None = None, progress: Progress | None = None
    ) -> Iterator[NumberBlock]:
        """Yield the rows' frame numbers, times and the cells of `columns`, block by block.

        Raises
        ------
        RecordingError
            A row has not as many cells as the header, or one of those cells is no number.
        """
        for whole in self.file.blocks(cut, progress):
            block = whole.after(self.first_row) if whole.first_line < self.first_row else whole
            if block.data:
                yield self._read_plain(block, columns) or self._read_line_by_line(block, columns)

    def _read_plain(self, block: Block, columns: Sequence[int]) -> NumberBlock | None:
        """Read the block if all of it is plain numbers, one row in every line; None if not."""
        data, n_columns = self._shorten(block.data, columns)
        has_hex = b"x" in data or b"X" in data  # Arrow takes 0x1F for a whole number
        if has_hex or (data is block.data and n_columns < len(self.labels)):
            return None
        table = _parse(data, self.delimiter, n_columns, self._kinds(columns, n_columns))
        if table is None or table.num_rows != block.n_lines or table.column(0).null_count:
            return None
        number = table.column(0).to_numpy().astype(np.int64)
        time_s = np.full(len(number), NAN) if self.time_column is None else table.column(1).to_numpy()
        values = _as_matrix(table.select([str(column) for column in columns]))
        stamps = Stamps(block.first_line + np.arange(len(number)), number, time_s)
        in_time = self.time_column is None or ((time_s >= 0) & (time_s < MAX_TIME_S)).all()
        return NumberBlock(stamps, values) if in_time and not np.isinf(values).any() else None

    def _shorten(self, data: bytes, columns: Sequence[int]) -> tuple[bytes, int]:
        """Return the lines and their number of cells; where no columns are asked for, only the head of each line."""
        sign = self.delimiter.encode()
        n = 1 + max(FRAME, self.time_column or FRAME)
        if not columns and b'"' not in data:
            ends = np.flatnonzero(np.frombuffer(data, np.uint8) == LINE_FEED).tolist()
            heads = [data[start : start + HEAD_BYTES].split(sign, n) for start in (0, *(end + 1 for end in ends[:-1]))]
            if min(map(len, heads)) > n:
                return b"".join([sign.join(head[:n]) + b"\n" for head in heads]), n
        return data, data.count(sign, 0, data.index(b"\n")) + 1

    def _kinds(self, columns: Sequence[int], n_columns: int) -> dict[str, pa.DataType]:
        """Return what is expected in which column: frame, time, those asked for, and nothing beyond the header's."""
        kinds = {FRAME: pa.uint32()}
        if self.time_column is not None:
            kinds[self.time_column] = pa.float64()
        kinds |= dict.fromkeys(columns, pa.float64())
        kinds |= dict.fromkeys(range(len(self.labels), n_columns), pa.null())
        return {str(column): kind for column, kind in kinds.items()}

    def _read_line_by_line(self, block: Block, columns: Sequence[int]) -> NumberBlock:
        """Read what is plain to a reader, if not to Arrow. `RecordingError` names the first cell that is not."""
        blank = f" {self.delimiter}"
        rows = [(line, self.cells(line, text)) for line, text in block.lines() if text.strip(blank)]
        stamps = Stamps(
            np.array([line for line, _ in rows], np.int64),
            np.array([self._number(line, cells) for line, cells in rows], np.int64),
            np.array([self._time_s(line, cells) for line, cells in rows], np.float64),
        )
        values = [[self.value(line, cells, column) for column in columns] for line, cells in rows]
        return NumberBlock(stamps, np.array(values, np.float64).reshape(len(rows), len(columns)))

    def cells(self, line: int, text: str) -> list[str]:
        """Split a row and check that it has as many cells as the header."""
        cells, width = split_cells(text, self.delimiter), len(self.labels)
        if len(cells) < width or (len(cells) > width and any(cell.strip() for cell in cells[width:])):
            raise self.file.at(line, f"it has {len(cells)} cells where the header has {width}")
        return cells

    def value(self, line: int, cells: Sequence[str], column: int) -> float:
        """Return the number in a cell, NaN where it is blank."""
        return float_cell(self.file, line, cells[column], f"'{self.labels[column]}'")

    def _number(self, line: int, cells: Sequence[str]) -> int:
        return int_cell(self.file, line, cells, FRAME, "Frame", most=MAX_FRAME_NUMBER)

    def _time_s(self, line: int, cells: Sequence[str]) -> float:
        if self.time_column is None:
            return NAN
        time_s = float_cell(self.file, line, cells[self.time_column], "Time")
        if not 0 <= time_s < MAX_TIME_S:
            raise self.file.at(line, f"'{cells[self.time_column]}' in column Time is no time of a take")
        return time_s


def _parse(data: bytes, delimiter: str, n_columns: int, kinds: dict[str, pa.DataType]) -> pa.Table | None:
    """Let Arrow read the columns of `kinds`, in their order; None where a row or a cell is not as it is told."""
    names = [str(column) for column in range(n_columns)]
    try:
        return csv.read_csv(
            pa.BufferReader(data),
            read_options=csv.ReadOptions(use_threads=False, block_size=len(data) + 1, column_names=names),
            parse_options=csv.ParseOptions(delimiter=delimiter),
            convert_options=csv.ConvertOptions(column_types=kinds, include_columns=list(kinds), null_values=[""]),
        )
    except pa.ArrowInvalid:
        return None


def _as_matrix(table: pa.Table) -> Floats:
    """Return a table of floats with a row for each of its rows, NaN where a cell is blank."""
    if table.num_columns == 0:
        return np.empty((table.num_rows, 0))
    (batch,) = table.combine_chunks().to_batches()
    matrix: Floats = batch.to_tensor(null_to_nan=True).to_numpy()
    return matrix


def make_rows(
    table: ColumnTable, block: NumberBlock, names: Sequence[str], flags: Words, metres_per_unit: float
) -> Rows:
    """Return the points of a block whose first values are X, Y, Z of each marker of `names`.

    A point's id is its marker's place in `names`.

    Raises
    ------
    RecordingError
        A marker has only some of its coordinates, or is nowhere in this world.
    """
    n_markers = len(names)
    points_m = block.values[:, : 3 * n_markers].reshape(-1, n_markers, 3) * metres_per_unit
    no_x, no_y, no_z = np.isnan(points_m).transpose(2, 0, 1)
    seen: Mask = ~(no_x | no_y | no_z)
    _refuse(table, block, names, (no_x != no_y) | (no_y != no_z), "has not all of X, Y and Z")
    is_far = np.abs(points_m) >= MAX_POSITION_M
    if is_far.any():
        _refuse(table, block, names, np.asarray(is_far.any(axis=2)), f"is more than {MAX_POSITION_M:g} m away")
    ids = np.nonzero(seen)[1]
    return Rows(
        block.stamps,
        seen.sum(axis=1),
        points_m[seen].astype(np.float32),
        ids.astype(np.uint32),
        flags[ids],
        np.full(len(ids), np.nan, np.float32),
    )


def _refuse(table: ColumnTable, block: NumberBlock, names: Sequence[str], wrong: Mask, what: str) -> None:
    if wrong.any():
        row, marker = (int(index[0]) for index in np.nonzero(wrong))
        raise table.file.at(int(block.stamps.line[row]), f"the marker '{names[marker]}' {what}")
