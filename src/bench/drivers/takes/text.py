"""Text files as numbered lines and cells; a cell that is no number is an error with its line and column."""

from __future__ import annotations

import codecs
import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.drivers.takes.take import unreadable
from bench.errors import RecordingError

__all__ = ["TextFile", "float_cell", "int_cell", "split_cells"]

BLOCK_BYTES = 1 << 20
BOMS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
NAN = float("nan")


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

    def lines(self, cut: list[int] | None = None) -> Iterator[tuple[int, str]]:
        """Yield (line number from 1, line without its end), but not a last line that has no end.

        Such a line may have been cut inside a number that still looks whole, so its number goes into `cut`.
        """
        try:
            with self.path.open(encoding=self.encoding, errors="replace") as file:
                for number, line in enumerate(file, start=1):
                    if line.endswith("\n"):
                        yield number, line[:-1]
                    elif cut is not None:
                        cut.append(number)
        except OSError as error:
            raise unreadable(self.name, error.strerror or str(error)) from error

    def at(self, line: int, what: str) -> RecordingError:
        """Return the error that `line` is wrong."""
        return unreadable(self.name, f"line {line}: {what}", hint="Export the take again, or correct the line.")


def _find_encoding(path: Path) -> str:
    decoder = codecs.getincrementaldecoder("utf-8")()
    with path.open("rb") as file:
        start = file.read(BLOCK_BYTES)
        for bom, encoding in BOMS.items():
            if start.startswith(bom):
                return encoding
        block = start
        while block:
            try:
                decoder.decode(block)
            except UnicodeDecodeError:
                return "latin-1"
            block = file.read(BLOCK_BYTES)
    return "utf-8"


def split_cells(line: str) -> list[str]:
    """Split one line of comma-separated values; quotes are rare, so they alone pay for the full parser."""
    if '"' not in line:
        return line.split(",")
    return next(csv.reader([line]), [])


def float_cell(file: TextFile, line: int, cell: str, column: str) -> float:
    """Read a number; blank is NaN. `RecordingError` naming line and column if it is neither."""
    text = cell.strip()
    if not text:
        return NAN
    try:
        value = float(text)
    except ValueError:
        raise file.at(line, f"'{_short(text)}' in column {column} is no number") from None
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


def _short(text: str) -> str:
    return text if len(text) <= 30 else text[:30] + "…"
