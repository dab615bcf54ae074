"""Writes what the simulated tracker knew into a file beside the recording, never into it.

Only the simulation and the tests read such a file.
"""

from __future__ import annotations

import json
import logging
import queue
import threading
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from bench.errors import RecordingError, RecordingExistsError
from bench.simulation.program import Motion
from bench.simulation.wear import WearTable

__all__ = ["TruthWriter"]

logger = logging.getLogger(__name__)

ROWS_PER_GROUP = 2_000
"""Rows are handed over in lots of this size, so that the writer's thread wakes rarely while ticks are due."""

Row = tuple[int, int, int, float, float, float, npt.NDArray[np.int16]]


class TruthWriter:
    """A Parquet file with one row for each frame the simulated tracker emitted.

    Columns: ``frame_number``, ``time_ns`` (mid-exposure, Unix), ``cycle_index`` (-1 outside a cycle), ``cycle_phase``
    (NaN outside), ``source`` (index in the frame's point list of each of the cable's markers, -1 where hidden) and
    ``curvature_per_m`` (magnitude) at the arc lengths in the file's metadata key ``arc_length_m``.

    Parameters
    ----------
    path : Path
        Is written as ``path.active`` until it is closed.
    curvature : WearTable
        Signed curvature (G,) by place of the path and cycles driven.
    arc_length_m : (G,) float
        Where it is given.
    n_markers : int
        Markers on the cable.
    facts : mapping
        What is the same in all frames, as JSON has it: goes into the file's metadata key ``scene``.

    Raises
    ------
    RecordingExistsError
        The file, or its unfinished form, exists.
    RecordingError
        It cannot be created.
    """

    def __init__(
        self,
        path: Path,
        curvature: WearTable,
        arc_length_m: npt.NDArray[np.float64],
        n_markers: int,
        facts: Mapping[str, object],
    ) -> None:
        self._path = path
        self._active = path.with_name(path.name + ".active")
        self._curvature = curvature
        self._schema = _make_schema(n_markers, arc_length_m, facts)
        self._rows: list[Row] = []
        self._lots: queue.SimpleQueue[list[Row] | None] = queue.SimpleQueue()
        self._failure: Exception | None = None
        self._verify_absent()
        try:
            self._writer = pq.ParquetWriter(self._active, self._schema, compression="zstd")
        except OSError as error:
            raise RecordingError(f"The truth file {path} cannot be created: {error.strerror or error}.") from error
        self._thread: threading.Thread | None = threading.Thread(target=self._run, name="truth", daemon=True)
        self._thread.start()

    def put(self, frame_number: int, host_ns: int, motion: Motion, source: npt.NDArray[np.int16]) -> None:
        """Take the row of one frame: a `bench.simulation.scene.TruthSink`."""
        inside = motion.cycle_running == 1
        cycle_index, phase = (motion.cycle_count, motion.phase) if inside else (-1, float("nan"))
        self._rows.append((frame_number, host_ns, cycle_index, phase, motion.place, motion.cycles_driven, source))
        if len(self._rows) >= ROWS_PER_GROUP:
            self._hand_over()

    def close(self) -> None:
        """Write what is left and give the file its name. May be called twice.

        Raises
        ------
        RecordingError
            Something could not be written; what could is in the ``.active`` file.
        """
        if not self._end_thread():
            return
        if self._failure is not None:
            raise RecordingError(f"The truth file {self._active} is incomplete: {self._failure}.") from self._failure
        if self._path.exists():
            raise RecordingExistsError(f"{self._path} has appeared in the meantime; the truth is in {self._active}.")
        self._active.rename(self._path)

    def discard(self) -> None:
        """Leave no file behind: nothing was simulated."""
        self._end_thread()
        self._active.unlink(missing_ok=True)

    def _verify_absent(self) -> None:
        for path in (self._path, self._active):
            if path.exists():
                raise RecordingExistsError(
                    f"The truth file {path} exists already and is not overwritten.",
                    hint="Choose another name for --truth, or move the old file away.",
                )

    def _end_thread(self) -> bool:
        thread, self._thread = self._thread, None
        if thread is None:
            return False
        self._hand_over()
        self._lots.put(None)
        thread.join()
        return True

    def _hand_over(self) -> None:
        rows, self._rows = self._rows, []
        self._lots.put(rows)

    def _run(self) -> None:
        try:
            while (rows := self._lots.get()) is not None:
                if rows and self._failure is None:
                    self._write(rows)
            self._writer.close()
        except Exception as error:  # the simulation goes on; close() says that the truth does not
            logger.error("the truth file %s cannot be written: %s", self._active, error)  # noqa: TRY400 - no traceback
            self._failure = error
            while self._lots.get() is not None:
                pass

    def _write(self, rows: list[Row]) -> None:
        frame_number, time_ns, cycle_index, phase, place, driven, source = zip(*rows, strict=True)
        curvature = np.abs(self._curvature.at_many(np.array(place), np.array(driven))).astype(np.float32)
        columns = [
            pa.array(frame_number, pa.int64()),
            pa.array(time_ns, pa.int64()),
            pa.array(cycle_index, pa.int64()),
            pa.array(phase, pa.float64(), from_pandas=False),
            _fixed_lists(np.stack(source)),
            _fixed_lists(curvature),
        ]
        self._writer.write_table(pa.Table.from_arrays(columns, schema=self._schema))


def _make_schema(n_markers: int, arc_length_m: npt.NDArray[np.float64], facts: Mapping[str, object]) -> pa.Schema:
    return pa.schema(
        [
            ("frame_number", pa.int64()),
            ("time_ns", pa.int64()),
            ("cycle_index", pa.int64()),
            ("cycle_phase", pa.float64()),
            ("source", pa.list_(pa.int16(), n_markers)),
            ("curvature_per_m", pa.list_(pa.float32(), len(arc_length_m))),
        ],
        metadata={"arc_length_m": json.dumps(arc_length_m.tolist()), "scene": json.dumps(facts)},
    )


def _fixed_lists(values: npt.NDArray[np.int16] | npt.NDArray[np.float32]) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
