"""Scores a report's tables against what the simulated tracker knew. The only readers of truth files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow.parquet as pq


@dataclass(frozen=True)
class Score:
    """How well the sorting did."""

    n_frames: int
    exact: float
    """Fraction of frames with every visible marker right and nothing else labelled."""
    wrong: float
    """Fraction of frames with at least one wrong label."""
    recall: float
    """Fraction of visible markers found."""


def read_columns(path: Path) -> dict[str, npt.NDArray[np.generic]]:
    columns = {}
    for name, column in zip((table := pq.read_table(path)).column_names, table.columns, strict=True):
        merged = column.combine_chunks()
        if hasattr(merged.type, "list_size"):
            columns[name] = merged.flatten().to_numpy(zero_copy_only=False).reshape(len(merged), merged.type.list_size)
        else:
            columns[name] = merged.to_numpy(zero_copy_only=False)
    return columns


def join_truth(markers: Path, truth: Path) -> dict[str, npt.NDArray[np.generic]]:
    """Return the frames both know, by frame number; the truth's columns end in ``_true``."""
    ours, theirs = read_columns(markers), read_columns(truth)
    _, i, j = np.intersect1d(ours["frame_number"], theirs["frame_number"], return_indices=True)
    return {name: column[i] for name, column in ours.items()} | {f"{n}_true": c[j] for n, c in theirs.items()}


def score_sorting(markers: Path, truth: Path) -> Score:
    joined = join_truth(markers, truth)
    found, true = joined["source"], joined["source_true"]
    wrong = (found >= 0) & (found != true)
    visible = true >= 0
    return Score(
        n_frames=len(found),
        exact=float(np.mean(np.all(found == true, axis=1))),
        wrong=float(np.mean(np.any(wrong, axis=1))),
        recall=float(np.mean((found == true)[visible])),
    )
