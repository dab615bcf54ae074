"""What a robot says of its cycles: counter, running mark and phase on its time grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.analysis import CounterColumns

T0_NS = 1_700_000_000_000_000_000
PERIOD_NS = 8_000_000


def make_robot(n_cycles: int, on_samples: int = 50, wait_samples: int = 10, first_wait: int = 20) -> CounterColumns:
    """Return a program that drives `n_cycles`, waiting before each, and rests after the last."""
    count, running, phase = [0] * first_wait, [0] * first_wait, [0.0] * first_wait
    for cycle in range(n_cycles):
        count += [cycle] * on_samples + [cycle + 1] * wait_samples
        running += [1] * on_samples + [0] * wait_samples
        phase += [i / on_samples for i in range(on_samples)] + [1.0] * wait_samples
    return from_lists(count, running, phase)


def from_lists(count: list[int], running: list[int], phase: list[float] | None = None) -> CounterColumns:
    n = len(count)
    return CounterColumns(
        host_ns=T0_NS + PERIOD_NS * np.arange(n),
        count=np.array(count, dtype=np.int64),
        running=np.array(running, dtype=np.int64),
        phase=np.full(n, np.nan) if phase is None else np.array(phase),
        runtime_state=np.full(n, 2),
    )


def keep(robot: CounterColumns, kept: np.ndarray) -> CounterColumns:
    """Return the robot's samples without those that were never received."""
    return replace(robot, **{name: getattr(robot, name)[kept] for name in robot.__dataclass_fields__})
