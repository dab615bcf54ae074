"""Find out by its content what kind of file a take is, and read it."""

from __future__ import annotations

from pathlib import Path

from bench.config import RECORDING_START
from bench.drivers.takes.c3d import is_c3d, read_c3d
from bench.drivers.takes.motive_csv import read_motive
from bench.drivers.takes.parquet import is_parquet, read_parquet
from bench.drivers.takes.take import Take, unreadable
from bench.drivers.takes.text import Progress, TextFile, split_cells
from bench.drivers.takes.tracking_tools import KEYWORDS, read_tracking_tools
from bench.drivers.takes.trc import FILE_TYPE, read_trc

__all__ = ["read_take"]

SNIFF_BYTES = 1024
SEPARATORS = {";": "semicolons", "\t": "tabs"}
KNOWN = (
    "Readable are CSV exports of Motive (1.2 to 1.25) and of Tracking Tools (1.0, 1.1), C3D, TRC and bench's Parquet."
)


def read_take(path: Path, progress: Progress | None = None) -> Take:
    """Read a take: a Motive or Tracking Tools CSV export, a C3D, TRC or bench's own Parquet file.

    They are told apart by what is in them.

    A text file is looked through once for the number and time of every frame, which is what the grid of its times,
    its gaps and its warnings need; its cells are read while the frames are taken, in bounded memory.

    Parameters
    ----------
    path : Path
    progress : callable, optional
        Told which share of the file has been looked through, 0…1; not of a C3D file.

    Returns
    -------
    Take
        Positions in metres, in the tracker's lab frame. Points of formats without labels have flags 0 and
        `NO_ID`; a Motive export's points have the flags that NatNet gives them, a C3D file's are all unlabeled.
        Names of points are found by their ids in `TakeInfo.marker_names`.

    Raises
    ------
    RecordingError
        The file is missing, empty, no take, of an unknown version, or without markers or frames. While the frames
        are taken: a cell is no number, or no frame has a marker.
    """
    start = _start_of(path)
    if is_c3d(start):
        return read_c3d(path)
    if is_parquet(start):
        return read_parquet(path, progress)
    if start.startswith(RECORDING_START):
        raise unreadable(path.name, "it is a recording already, an MCAP file", "`bench report` takes it as it is.")
    file = TextFile.of(path)
    line = next((line for _, line in file.lines() if line.strip(" ,")), "") if _is_text(start) else ""
    first = next((cell.strip() for cell in split_cells(line)), "")
    if first == "Format Version":
        return read_motive(file, progress)
    if first.lower() in KEYWORDS:
        return read_tracking_tools(file, progress)
    if first.split(maxsplit=1)[:1] == [FILE_TYPE]:
        return read_trc(file, progress)
    if first.startswith("Format Version"):
        found = next((name for sign, name in SEPARATORS.items() if sign in line), "something else")
        what = f"its cells are separated by {found} and not by commas"
        raise unreadable(path.name, what, "Export it again from Motive, or save it with commas and decimal points.")
    raise unreadable(path.name, "it is no take that bench knows", KNOWN)


def _start_of(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            start = file.read(SNIFF_BYTES)
    except OSError as error:
        raise unreadable(path.name, (error.strerror or str(error)).lower()) from error
    if not start.strip():
        raise unreadable(path.name, "it is empty", KNOWN)
    return start


def _is_text(start: bytes) -> bool:
    """Whether the file may be text: binary files have NUL bytes, and so has UTF-16, but after its mark."""
    return b"\0" not in start or start[:2] in (b"\xff\xfe", b"\xfe\xff")
