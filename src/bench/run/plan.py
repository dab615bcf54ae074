"""What a run would do, without doing it: ``bench run --dry-run``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from bench.config import AnyRobotConfig, Config, describe_program_file
from bench.run.bench_links import require_devices
from bench.run.preflight import predict_bytes_per_s

if TYPE_CHECKING:
    from bench.run.options import RunOptions

__all__ = ["describe_plan"]

USUAL_TRACKER_HZ = 120.0
"""A real tracker's rate is known only once it answers; 120 Hz is what a Flex 13 gives."""


def describe_plan(config: Config, options: RunOptions) -> list[str]:
    """Return the plan in sentences: devices, cycles, duration where it is known, size of the file."""
    robot, tracker = require_devices(config)
    simulated = config.simulation
    rate_hz = simulated.tracker_rate_hz if simulated else USUAL_TRACKER_HZ
    n_points = len(config.cable.arc_length_m) + 1
    per_s = predict_bytes_per_s(config, rate_hz, n_points)
    lines = [
        f"robot    {robot.kind} at {robot.host}, program {robot.program}, {robot.rate_hz:g} Hz",
        f"tracker  {tracker.kind} at {tracker.host}, {n_points} points at {rate_hz:g} Hz"
        + ("" if simulated else " (assumed: the tracker tells its rate when it is connected)"),
        f"cycles   {options.n_cycles}, {_how_begun(robot)}{_how_first(config.run.first_cycle_speed)}",
    ]
    if options.program is not None:
        lines.append(f"copy     {describe_program_file(options.program.to_metadata())}")
    if simulated:
        run_s = (options.n_cycles - 1 + 1 / config.run.first_cycle_speed) * simulated.cycle_s
        lines.append(
            f"duration {run_s:.0f} s of simulated time, {run_s / options.speed:.0f} s at --speed {options.speed:g}"
        )
        lines.append(f"file     about {run_s * per_s / 1e6:.1f} MB ({per_s / 1e3:.0f} kB/s)")
        lines += _how_split(config.run.split_bytes, run_s * per_s)
    else:
        lines.append("duration known after the first cycle: the path is the robot program's own")
        lines.append(f"file     about {per_s * 3600 / 1e6:.0f} MB for each hour ({per_s / 1e3:.0f} kB/s)")
        lines += _how_split(config.run.split_bytes, per_s * 3600, " for each hour")
    lines.append(f"output   {options.output or config.run.output_dir + '/' + config.run.name + '-TIME.mcap'}")
    lines.append("Nothing was connected and nothing was written.")
    return lines


def _how_split(split_bytes: int, expected_bytes: float, unit: str = "") -> list[str]:
    if not split_bytes:
        return []
    n_parts = max(math.ceil(expected_bytes / split_bytes), 1)
    return [f"parts    about {n_parts}{unit}, each of {split_bytes / 1e6:g} MB: [run] split_mb"]


def _how_first(first_cycle_speed: float) -> str:
    if first_cycle_speed == 1.0:
        return ""
    return f"; the first with the speed slider at {100 * first_cycle_speed:g}%, the others with it where it is now"


def _how_begun(robot: AnyRobotConfig) -> str:
    if robot.cycle.is_granted:
        return "each granted when the one before has ended"
    return "which the program begins by itself; it is stopped after the last"
