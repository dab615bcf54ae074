"""Scores sorted markers against the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow.parquet as pq

Indices = npt.NDArray[np.int16]


@dataclass(frozen=True)
class SortingScore:
    """How well the sorting did, each a fraction."""

    exact: float
    """Frames in which every visible marker has its point and nothing else is labelled."""
    wrong: float
    """Frames with at least one wrong label."""
    recall: float
    """Visible markers that were found."""


def read_source(markers: Path) -> Indices:
    """Return the column `source` (F, k) of a ``markers.parquet``."""
    column = pq.read_table(markers, columns=["source"])["source"].combine_chunks()
    return column.flatten().to_numpy().reshape(len(column), column.type.list_size)


def score_source(found: Indices, true: Indices) -> SortingScore:
    """Score `found` (F, k) against `true` (F, k)."""
    wrong = (found >= 0) & (found != true)
    return SortingScore(
        exact=float((found == true).all(axis=1).mean()),
        wrong=float(wrong.any(axis=1).mean()),
        recall=float((found == true)[true >= 0].mean()),
    )
