"""How far a calibration run is from the simulated bench's truth, in real time and with cameras that stamp late."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from scipy.spatial.transform import Rotation

from bench.config import Calibration, load_calibration, simulated_config_text
from benchmarks.table import Row, ratio_row

CYCLE_S = 20
WANTED_MM, WANTED_DEG, WANTED_MS = 0.3, 0.1, 0.3
TAPED_MM = 2.0


def measure_calibration(folder: Path, bench: Callable[..., object]) -> list[Row]:
    """Record one pass of the calibration program with 0.2 mm of noise, calibrate it, and judge it."""
    config, run, truth, file = (folder / f"calibration{end}" for end in (".in.toml", ".mcap", ".parquet", ".toml"))
    config.write_text(_configure(), encoding="utf-8")
    bench("run", config, "--cycles", 1, "--output", run, "--truth", truth)
    bench("calibrate", run, "--output", file)
    return _judge(load_calibration(file), json.loads(pq.read_schema(truth).metadata[b"scene"]))


def _configure() -> str:
    text = simulated_config_text().replace("127.0.0.2", "127.0.52.2").replace("bend_test.urp", "calibrate.urp")
    text = text.replace("cycle_s = 2.0", f"cycle_s = {CYCLE_S}.0")
    optics = f"noise_mm = 0.2\nusb_cameras = true\nplacement_sd_mm = {TAPED_MM}"
    return f'{text}\n{optics}\n\n[calibration]\nflange_body = "flange"\n'


def _judge(found: Calibration, truth: dict[str, dict[str, list[float]]]) -> list[Row]:
    space, true = found.space, truth["base_to_lab"]
    turned = Rotation.from_matrix(np.reshape(true["rotation"], (3, 3)))
    apart_deg = np.rad2deg((Rotation.from_rotvec(space.lab_from_base_rotation_rad).inv() * turned).magnitude())
    apart_mm = 1e3 * float(np.linalg.norm(np.subtract(space.lab_from_base_shift_m, true["shift_m"])))
    late_ms = abs(found.time.offset_ms + 1e3 * float(np.asarray(truth["tracker_stamp_delay_s"])))
    rows = [
        ratio_row(f"calibration, {CYCLE_S} s, 0.2 mm noise: base in lab frame, mm off", apart_mm, WANTED_MM, "limit"),
        ratio_row("calibration: base in lab frame, degrees off", float(apart_deg), WANTED_DEG, "limit"),
        ratio_row("calibration: time offset of late stamps, ms off", late_ms, WANTED_MS, "limit"),
    ]
    if found.spacing is not None:
        off_m = np.subtract(found.spacing.marker_arc_length_m, truth["marker_arc_length_m"])
        worst_mm = 1e3 * float(np.abs(off_m).max())
        rows.append(ratio_row("calibration: worst place of 10 markers, mm off", worst_mm, TAPED_MM, "taped to"))
    return rows
