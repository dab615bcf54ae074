"""Importing a large text file: how fast, and in how much memory, beside Python's own csv module."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np

from bench.drivers.takes import read_take
from benchmarks.table import Row, ratio_row

MEGABYTES, FULL_MEGABYTES = 100, 1000
LIMIT_MB_PER_S = 50.0
LIMIT_BYTES = 500e6
N_MARKERS = 50
RATE_HZ = 360
HIDDEN = 0.05
N_POSES = 2000
"""Rows of different positions; then they begin again, for writing numbers takes longer than reading them."""
CONFIG = """
[cable]
length_m = 2.2
diameter_mm = 8.0
marker_count = 50
marker_spacing_m = 0.04
minimum_bend_radius_mm = 60.0
[cable.anchor]
kind = "none"
"""


class Finished(Protocol):
    """A command that has ended."""

    wall_s: float
    peak_bytes: int


def measure_take_import(folder: Path, full: bool, bench: Callable[..., Finished]) -> list[Row]:
    """Read a Motive CSV into frames, against the csv module; and import it on one core, startup and all."""
    path, config = folder / "take.csv", folder / "take.toml"
    size = FULL_MEGABYTES if full else MEGABYTES
    write_take(path, size)
    config.write_text(CONFIG)
    megabytes = path.stat().st_size / 1e6
    ours, peer = (megabytes / seconds(work, path) for work in (read_frames, read_cells))
    imported = bench("import", path, "--config", config, "--output", folder / "take.mcap", cores={0})
    what = f"import of a CSV, {megabytes:.0f} MB, {N_MARKERS} markers: "
    rows = [
        ratio_row(what + "both readings, MB/s", ours, peer, "csv module, one reading"),
        ratio_row(what + "bench import on one core, MB/s", megabytes / imported.wall_s, LIMIT_MB_PER_S, "limit"),
        ratio_row(what + "peak memory, MB", imported.peak_bytes / 1e6, LIMIT_BYTES / 1e6, "limit"),
    ]
    path.unlink()
    return rows


def write_take(path: Path, megabytes: int) -> None:
    """Write a Motive CSV export of unlabeled markers in millimetres."""
    rng = np.random.default_rng(1)
    columns = [f"Unlabeled {1000 + i}" for i in range(N_MARKERS) for _ in "XYZ"]
    keys = f"Format Version,1.23,Export Frame Rate,{RATE_HZ:.6f},Length Units,Millimeters,Coordinate Space,Global"
    header = [keys, "", ",Type" + ",Marker" * len(columns), ",Name," + ",".join(columns), ",ID" + ",0" * len(columns)]
    header += [",," + ",".join(["Position"] * len(columns)), "Frame,Time (Seconds)" + ",X,Y,Z" * N_MARKERS]
    poses = [_pose(rng) for _ in range(N_POSES)]
    with path.open("w") as file:
        file.writelines(line + "\n" for line in header)
        number = 0
        while file.tell() < megabytes * 1e6:
            numbers = range(number, number + N_POSES)
            file.writelines(f"{i},{i / RATE_HZ:.3f}000,{pose}\n" for i, pose in zip(numbers, poses, strict=True))
            number += N_POSES


def _pose(rng: np.random.Generator) -> str:
    points = rng.normal(0, 1000, (N_MARKERS, 3)).tolist()
    hidden = (rng.random(N_MARKERS) < HIDDEN).tolist()
    return ",".join(",," if h else f"{x:.6f},{y:.6f},{z:.6f}" for (x, y, z), h in zip(points, hidden, strict=True))


def read_frames(path: Path) -> int:
    return sum(1 for _ in read_take(path).frames)


def read_cells(path: Path) -> int:
    """Make a number of every cell, as a script would."""
    with path.open(newline="") as file:
        rows = csv.reader(file)
        next(row for row in rows if row and row[0] == "Frame")
        return sum(1 for row in rows if [float(cell) if cell else np.nan for cell in row])


def seconds(work: Callable[[Path], int], path: Path) -> float:
    begin = time.perf_counter()
    work(path)
    return time.perf_counter() - begin
