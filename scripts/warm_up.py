"""Compiles the loops of the analysis once, so that not every process of a test run does it for itself."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from bench.analysis import PointFrames, SortSettings, find_folds, get_estimator, get_sorter
from bench.cli.accuracy import accuracy
from bench.simulation.made_motions import DEVELOPMENT
from bench.simulation.made_takes import USUAL, make_take


def main() -> None:
    """Sort a cable that repeats its motion and one that does not, draw their curves, and do the error study."""
    for kind, sorting in (("loop", "phase"), ("not repeating", "track"), ("loop", "chain")):
        take = make_take(DEVELOPMENT[kind][0], 6, USUAL)
        usable = np.ones(len(take.points_m), dtype=bool)
        ends = take.anchor_m, take.time_ns, take.end_m, take.end_sigma_m
        frames = PointFrames(take.points_m, take.offsets, usable, *ends, take.cycle, take.phase)
        known = SortSettings(take.arc_length_m, tolerance_m=0.004, length_m=take.length_m, noise_m=5e-4)
        markers = get_sorter(sorting)(frames, known)
        find_folds(markers.position_m)
        s = np.array(take.arc_length_m)
        curve = get_estimator("menger_gp")(markers.position_m, s, np.linspace(s[0], s[-1], 50), 5e-4, with_vector=True)
        assert curve.vector_per_m is not None
    with tempfile.TemporaryDirectory() as folder:
        accuracy(output=Path(folder) / "study")


if __name__ == "__main__":
    main()
