"""The cable's markers by name, on the tracker's own time grid: what files with one row a frame are written from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np
import numpy.typing as npt

from bench.errors import AnalysisError
from bench.recording import Run
from bench.report.results import Results

__all__ = ["SortedMarkers", "collect_markers", "place_on_grid"]

ROWS_AT_ONCE = 4096
MAX_ROWS_PER_FRAME = 100
"""More rows than this for each frame are no grid: the tracker stood still, or its numbers are damaged."""
NEW_COUNT_S = 1.0
"""A step in time that is so far from the step in frame number begins a new count: a tracker that was restarted."""
NS = 1_000_000_000

Ints = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]
Floats32 = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class SortedMarkers:
    """k markers in F frames, each frame at its place on a grid of n_rows times."""

    title: str
    """The run's name, without a suffix."""
    names: tuple[str, ...]
    """M1, M2 and so on, from the anchor along the cable."""
    rate_hz: float
    row: Ints
    """(F,): ascending, from 0. A row that is no frame's is one that the tracker did not send or nobody received."""
    position_m: Floats32
    """(F, k, 3): lab frame, NaN where the marker was not found."""
    start_ns: int
    """Host Unix time of row 0."""
    first_frame: int
    """The tracker's number of row 0."""
    up_axis: str
    """`x`, `y` or `z`; empty where the tracker does not say."""

    @property
    def n_rows(self) -> int:
        return int(self.row[-1]) + 1

    def blocks(self) -> Iterator[tuple[int, Floats32]]:
        """Yield (number of the first row, positions (n, k, 3)) of all rows, some at a time."""
        for start in range(0, self.n_rows, ROWS_AT_ONCE):
            n = min(ROWS_AT_ONCE, self.n_rows - start)
            part = slice(*np.searchsorted(self.row, [start, start + n]))
            position_m = np.full((n, *self.position_m.shape[1:]), np.nan, np.float32)
            position_m[self.row[part] - start] = self.position_m[part]
            yield start, position_m


def collect_markers(run: Run, results: Results) -> SortedMarkers:
    """Put the sorted markers of an analysed run on the tracker's grid.

    Raises
    ------
    AnalysisError
        No marker was found in any frame, or the frames are on no grid.
    """
    frames = results.frames
    if not np.isfinite(frames.position_m).any():
        raise AnalysisError(
            f"No marker of the cable was found in any of the {len(frames.frame_number)} frames of {results.run_path}.",
            hint="See its report: bench report says why.",
        )
    order = np.argsort(frames.time_ns, kind="stable")
    number, time_ns = frames.frame_number[order], frames.time_ns[order]
    rate_hz = _find_rate(run, number, time_ns)
    row = place_on_grid(number, time_ns, rate_hz)
    if row[-1] >= MAX_ROWS_PER_FRAME * len(row):
        raise AnalysisError(
            f"The {len(row)} frames of {results.run_path} are spread over {int(row[-1]) + 1} periods of the tracker: "
            "a table with a row for each would be nearly empty.",
            hint="Export it as parquet, which holds the frames alone.",
        )
    return SortedMarkers(
        title=PurePath(results.run_path).stem,
        names=tuple(f"M{i}" for i in range(1, frames.position_m.shape[1] + 1)),
        rate_hz=rate_hz,
        row=row,
        position_m=frames.position_m[order],
        start_ns=int(time_ns[0]),
        first_frame=int(number[0]),
        up_axis=next((device.detail["up_axis"] for device in run.devices if "up_axis" in device.detail), ""),
    )


def place_on_grid(frame_number: Ints, time_ns: Ints, rate_hz: float) -> Ints:
    """Return the row of each frame, ascending from 0.

    Within one count of the tracker rows follow its frame numbers, since its clock is not the host's: 42 ppm are a
    frame in a minute at 360 Hz. Where a new count begins, the host's time tells how many rows lie between.

    Parameters
    ----------
    frame_number, time_ns : array, shape (F,)
        In order of time.
    rate_hz : float
    """
    steps = np.diff(frame_number)
    is_new = (steps <= 0) | (np.abs(steps / rate_hz - np.diff(time_ns) / NS) > NEW_COUNT_S)
    row: Ints = np.subtract(frame_number, frame_number[0])
    for start in (np.flatnonzero(is_new) + 1).tolist():
        by_time = round((int(time_ns[start]) - int(time_ns[start - 1])) / NS * rate_hz)
        row[start:] += row[start - 1] + max(by_time, 1) - row[start]
    return row


def _find_rate(run: Run, number: Ints, time_ns: Ints) -> float:
    """Return the rate that the tracker states, or else the one that its frames came at."""
    stated = next((device.rate_hz for device in run.devices if device.device == "tracker"), 0.0)
    if stated > 0:
        return round(stated, 6)
    steps = np.diff(number)
    periods_s = np.diff(time_ns)[steps > 0] / steps[steps > 0] / NS
    usable = periods_s[periods_s > 0]
    if not len(usable):
        raise AnalysisError("The tracker's frame rate is not known: it states none, and there are too few frames.")
    return round(1.0 / float(np.median(usable)), 6)
