"""Text files in blocks of whole lines, as lines and as cells; what cannot be read is named with its line and column."""

from __future__ import annotations

import codecs
import csv
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from io import IncrementalNewlineDecoder
from pathlib import Path

import numpy as np

from bench.drivers.takes.take import unreadable
from bench.errors import RecordingError

__all__ = ["Block", "Progress", "TextFile", "float_cell", "int_cell", "split_cells"]

BLOCK_BYTES = 1 << 20
"""Read at once: larger blocks are parsed no faster, and leave the cache of the processor."""
MAX_LINE_BYTES = 1 << 24
"""16 MB: a line of any take is shorter than a thousandth of it, and memory stays bounded on a file without lines."""
BOMS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
LINE_FEED = 0x0A
NAN = float("nan")

Progress = Callable[[float], None]
"""Told, now and then, which share of the work is done, 0…1."""


@dataclass(frozen=True, slots=True)
class Block:
    """Some lines of a file, whole ones."""

    first_line: int
    """Number of the first of them, from 1."""
    data: bytes
    """UTF-8, lines ending in a line feed."""
    n_lines: int

    @classmethod
    def of(cls, first_line: int, data: bytes) -> Block:
        letters = np.frombuffer(data, np.uint8)
        return cls(first_line, data, int(np.count_nonzero(letters == LINE_FEED)))  # five times faster than bytes.count

    def lines(self) -> Iterator[tuple[int, str]]:
        """Yield (line number, line without its end)."""
        lines = self.data.decode().split("\n")[:-1]
        return enumerate(lines, start=self.first_line)

    def after(self, line: int) -> Block:
        """Return what is left from `line` on."""
        kept = self.data.split(b"\n", line - self.first_line)
        return Block.of(line, kept[-1] if len(kept) > line - self.first_line else b"")


@dataclass(frozen=True, slots=True)
class TextFile:
    """A text file whose encoding is known.

    Parameters
    ----------
    path : Path
    encoding : str
        UTF-8 with or without a byte-order mark, UTF-16 (spreadsheets save it as "Unicode text"), or Latin-1 where
        the bytes are neither.
    """

    path: Path
    encoding: str

    @classmethod
    def of(cls, path: Path) -> TextFile:
        """Find out how `path` is encoded. `RecordingError` if it cannot be read."""
        try:
            return cls(path, _find_encoding(path))
        except OSError as error:
            raise unreadable(path.name, error.strerror or str(error)) from error

    @property
    def name(self) -> str:
        return self.path.name

    def blocks(self, cut: list[int] | None = None, progress: Progress | None = None) -> Iterator[Block]:
        """Yield the file in blocks of whole lines, but not a last line that has no end.

        Such a line may have been cut inside a number that still looks whole, so its number goes into `cut`. Lines
        may end in a line feed, in a carriage return, or in both. `RecordingError` if the file cannot be read.
        """
        line, rest = 1, b""
        for data in self._chunks(progress):
            end = data.rfind(b"\n") + 1
            if end:
                block = Block.of(line, b"".join((rest, memoryview(data)[:end])))
                line, rest = line + block.n_lines, data[end:]
                yield block
            else:
                rest += data
            if len(rest) > MAX_LINE_BYTES:
                raise self.at(line, f"it is longer than {MAX_LINE_BYTES >> 20} MB, so this is no table")
        if rest and cut is not None:
            cut.append(line)

    def lines(self) -> Iterator[tuple[int, str]]:
        """Yield (line number from 1, line without its end), but not a last line that has no end."""
        for block in self.blocks():
            yield from block.lines()

    def at(self, line: int, what: str) -> RecordingError:
        """Return the error that `line` is wrong."""
        return unreadable(self.name, f"line {line}: {what}", hint="Export the take again, or correct the line.")

    def _chunks(self, progress: Progress | None) -> Iterator[bytes]:
        """Yield the file's bytes as UTF-8 without a mark, lines ending in a line feed."""
        decode = _Decoder(self.encoding)
        try:
            size = max(self.path.stat().st_size, 1)
            with self.path.open("rb") as file:
                while data := file.read(BLOCK_BYTES):
                    yield decode(data)
                    if progress is not None:
                        progress(min(file.tell() / size, 1.0))
        except OSError as error:
            raise unreadable(self.name, error.strerror or str(error)) from error
        yield decode(b"", final=True)


class _Decoder:
    """Turns a file's bytes, block by block, into UTF-8 without a mark, lines ending in a line feed."""

    def __init__(self, encoding: str) -> None:
        inner = codecs.getincrementaldecoder(encoding)("replace")
        self._decoder = IncrementalNewlineDecoder(inner, translate=True)
        self._clean = self._decoder.getstate()
        self._is_ascii = encoding.startswith("utf-8") or encoding == "latin-1"

    def __call__(self, data: bytes, final: bool = False) -> bytes:
        if self._is_ascii and data.isascii() and b"\r" not in data and self._decoder.getstate() == self._clean:
            return data  # as it is, almost always
        return self._decoder.decode(data, final=final).encode()


def _find_encoding(path: Path) -> str:
    """Tell the encoding by the first block: letters beyond ASCII stand in names, and names in every header or row."""
    with path.open("rb") as file:
        start = file.read(BLOCK_BYTES)
    for bom, encoding in BOMS.items():
        if start.startswith(bom):
            return encoding
    try:
        codecs.getincrementaldecoder("utf-8")().decode(start)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


def split_cells(line: str, delimiter: str = ",") -> list[str]:
    """Split one line of a table; quotes are rare, so they alone pay for the full parser."""
    if '"' not in line:
        return line.split(delimiter)
    return next(csv.reader([line], delimiter=delimiter), [])


def float_cell(file: TextFile, line: int, cell: str, column: str) -> float:
    """Read a number; blank is NaN. `RecordingError` naming line and column if it is neither."""
    text = cell.strip()
    if not text:
        return NAN
    try:
        value = float(text.replace("_", "?"))  # Python reads 1_000 as a number; no tracker writes it
    except ValueError:
        raise file.at(line, f"'{_short(text)}' in column {column} is no number{_comma_in(text)}") from None
    if math.isinf(value):
        raise file.at(line, f"'{_short(text)}' in column {column} is no finite number")
    return value


def int_cell(file: TextFile, line: int, cells: Sequence[str], index: int, column: str, *, most: int) -> int:
    """Read a whole number from 0 to `most`. `RecordingError` naming line and column if there is none."""
    if index >= len(cells):
        raise file.at(line, f"it ends after {len(cells)} cells, before its {column}")
    text = cells[index].strip()
    if not (text.isascii() and text.isdigit() and len(text) < 19 and int(text) <= most):
        raise file.at(line, f"'{_short(text)}' in column {column} is no whole number from 0 to {most}")
    return int(text)


def _comma_in(text: str) -> str:
    whole, comma, decimals = text.partition(",")
    is_number = comma and whole.lstrip("+-").isdigit() and decimals.isdigit()
    return ": it has a decimal comma where the export has a point" if is_number else ""


def _short(text: str) -> str:
    return text if len(text) <= 30 else text[:30] + "…"
