"""Makes a take as an old export would be: a cable on a pole, seen by Motive, its markers unlabeled and in no order."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

N_FRAMES = 60
RATE_HZ = 100.0
BEND_RADIUS_M = 0.5
ARC_LENGTH_M = [0.0, *(0.1 * (i + 1) for i in range(10))]
"""The anchor, and the ten markers that the documentation's configuration of a take describes."""


def write_example_take(path: Path) -> None:
    """Write a Motive CSV (1.23) of an arc of 500 mm radius that turns about the pole's static marker."""
    n_points = len(ARC_LENGTH_M)
    order = np.random.default_rng(1).permutation(n_points)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(_header())
        writer.writerow([])
        writer.writerow(["", "Type", *["Marker"] * 3 * n_points])
        writer.writerow(["", "Name", *(f"Unlabeled {1000 + i}" for i in range(n_points) for _ in "XYZ")])
        writer.writerow(["", "ID", *(f"{i:016X}" for i in range(n_points) for _ in "XYZ")])
        writer.writerow(["", "", *["Position"] * 3 * n_points])
        writer.writerow(["Frame", "Time (Seconds)", *["X", "Y", "Z"] * n_points])
        for frame in range(N_FRAMES):
            row = [f"{value:.6f}" for value in _points(frame)[order].ravel()]
            writer.writerow([frame, f"{frame / RATE_HZ:.3f}", *row])


def _header() -> list[str]:
    facts = {
        "Format Version": "1.23",
        "Take Name": "example",
        "Capture Frame Rate": f"{RATE_HZ:f}",
        "Export Frame Rate": f"{RATE_HZ:f}",
        "Capture Start Time": "2026-11-20 10.15.00.000 AM",
        "Total Frames in Take": str(N_FRAMES),
        "Total Exported Frames": str(N_FRAMES),
        "Rotation Type": "Quaternion",
        "Length Units": "Meters",
        "Coordinate Space": "Global",
    }
    return [cell for pair in facts.items() for cell in pair]


def _points(frame: int) -> npt.NDArray[np.float64]:
    angle = np.array(ARC_LENGTH_M) / BEND_RADIUS_M
    turn = 0.5 * math.sin(2 * math.pi * frame / N_FRAMES)
    across = BEND_RADIUS_M * (1 - np.cos(angle))
    down = BEND_RADIUS_M * np.sin(angle)
    return np.column_stack([0.4 + across * math.cos(turn), 1.1 - down, across * math.sin(turn)])
