"""Which RTDE output fills which field of `RobotState`, and how a data package becomes one."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from typing import Any

from bench.config import CycleConfig
from bench.drivers.robot.ur.recipe import Recipe, Scalar
from bench.model import NAN6

__all__ = ["STATE_FIELDS", "essential_outputs", "make_picker", "wanted_outputs"]

Picker = Callable[[tuple[Scalar, ...]], tuple[Any, ...]]

# Order of the fields of `RobotState` after `controller_time_s`; several names for one field: the first that exists.
# safety_status is newer than safety_mode and tells more; CB3 and early e-Series have only the latter.
OUTPUTS: dict[str, tuple[str, ...]] = {
    "controller_time_s": ("timestamp",),
    "q_rad": ("actual_q",),
    "qd_rad_s": ("actual_qd",),
    "target_q_rad": ("target_q",),
    "current_a": ("actual_current",),
    "joint_temperature_c": ("joint_temperatures",),
    "tcp_pose": ("actual_TCP_pose",),
    "tcp_speed": ("actual_TCP_speed",),
    "tcp_force": ("actual_TCP_force",),
    "speed_scaling": ("speed_scaling",),
    "speed_fraction": ("target_speed_fraction",),
    "runtime_state": ("runtime_state",),
    "robot_mode": ("robot_mode",),
    "safety_status": ("safety_status", "safety_mode"),
    "digital_inputs": ("actual_digital_input_bits",),
    "digital_outputs": ("actual_digital_output_bits",),
}
STATE_FIELDS = (*OUTPUTS, "cycle_count", "cycle_running", "cycle_phase")
"""Fields of `RobotState` that a package fills, in the order of its constructor."""

SHOW_CYCLES = {
    "counter": ("cycle_count", "cycle_running"),
    "digital_output": ("digital_outputs",),
    "joint_return": ("q_rad", "qd_rad_s"),
}
"""Fields that tell the cycles, by `[robot.cycle] source`."""
VECTORS = frozenset(
    {"q_rad", "qd_rad_s", "target_q_rad", "current_a", "joint_temperature_c", "tcp_pose", "tcp_speed", "tcp_force"}
)
REALS = frozenset({"controller_time_s", "speed_scaling", "speed_fraction", "cycle_phase"})
UNSIGNED = frozenset({"digital_inputs", "digital_outputs"})
# What stands for a field the controller does not have, appended to each package: NaN six times, -1, 0.
ABSENT = (*NAN6, -1, 0)


def _outputs(cycle: CycleConfig) -> dict[str, tuple[str, ...]]:
    registers: dict[str, tuple[str, ...]] = {}
    if cycle.source == "counter":  # else another program's numbers may stand there
        registers["cycle_count"] = (f"output_int_register_{cycle.counter_register}",)
        registers["cycle_running"] = (f"output_int_register_{cycle.running_register}",)
    if cycle.phase_register is not None:
        registers["cycle_phase"] = (f"output_double_register_{cycle.phase_register}",)
    return OUTPUTS | registers


def essential_outputs(cycle: CycleConfig) -> frozenset[str]:
    """Return the outputs without which a run cannot be told into cycles."""
    outputs = _outputs(cycle)
    return frozenset(outputs[field][0] for field in ("controller_time_s", *SHOW_CYCLES[cycle.source]))


def wanted_outputs(cycle: CycleConfig, unknown: frozenset[str]) -> list[str]:
    """Return the outputs to ask for: one for each field, none that the controller does not know."""
    chosen = [next((name for name in names if name not in unknown), None) for names in _outputs(cycle).values()]
    return [name for name in chosen if name is not None]


def make_picker(recipe: Recipe, cycle: CycleConfig) -> Picker:
    """Return a function from a package (`Recipe.unpack`) to the values of `STATE_FIELDS`, in one call of C code.

    Raises
    ------
    ValueError
        The controller gives one of the fields as a number where six are due, or the other way round.
    """
    outputs = _outputs(cycle)
    keys: list[int | slice] = []
    for field in STATE_FIELDS:
        name = next((name for name in outputs.get(field, ()) if name in recipe.names), None)
        keys.append(_absent_key(field, recipe.width) if name is None else _present_key(recipe, field, name))
    pick = itemgetter(*keys)
    return lambda flat: pick(flat + ABSENT)


def _present_key(recipe: Recipe, field: str, name: str) -> int | slice:
    key = recipe.key(name)
    width = key.stop - key.start if isinstance(key, slice) else 1
    due = 6 if field in VECTORS else 1
    if width != due:
        raise ValueError(f"gives '{name}' as {width} numbers where {due} are due")
    return key


def _absent_key(field: str, width: int) -> int | slice:
    """Point into `ABSENT`, which follows the package's `width` numbers."""
    if field in VECTORS:
        return slice(width, width + 6)
    if field in REALS:
        return width
    return width + (7 if field in UNSIGNED else 6)
