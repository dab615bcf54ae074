"""Which RTDE output fills which field of `RobotState`, and how a data package becomes one."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from typing import Any

from bench.config import CycleConfig
from bench.drivers.robot.ur.recipe import Recipe, Scalar
from bench.model import NAN6, NO_BITS

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
LATER_OUTPUTS: dict[str, tuple[str, ...]] = {
    "target_qd_rad_s": ("target_qd",),
    "safety_status_bits": ("safety_status_bits",),
    "robot_status_bits": ("robot_status_bits",),
    "tcp_offset": ("tcp_offset",),
    "payload_kg": ("payload",),
    "payload_cog_m": ("payload_cog",),
    "script_control_line": ("script_control_line",),
    "time_scale_source": ("time_scale_source",),
    "collision_detection_ratio": ("collision_detection_ratio",),
    "joint_position_deviation_ratio": ("joint_position_deviation_ratio",),
    "main_voltage_v": ("actual_main_voltage",),
    "robot_current_a": ("actual_robot_current",),
    "control_step": ("control_step",),
}
STATE_FIELDS = (*OUTPUTS, "cycle_count", "cycle_running", "cycle_phase", *LATER_OUTPUTS)
"""Fields of `RobotState` that a package fills, in the order of its constructor."""

SHOW_CYCLES = {
    "counter": ("cycle_count", "cycle_running"),
    "digital_output": ("digital_outputs",),
    "joint_return": ("q_rad", "qd_rad_s"),
}
"""Fields that tell the cycles, by `[robot.cycle] source`."""
WIDTHS = {
    **dict.fromkeys(("q_rad", "qd_rad_s", "target_q_rad", "target_qd_rad_s", "current_a", "joint_temperature_c"), 6),
    **dict.fromkeys(("tcp_pose", "tcp_speed", "tcp_force", "tcp_offset"), 6),
    "payload_cog_m": 3,
}
"""Numbers in a field that is no single one."""
REALS = frozenset(
    {"controller_time_s", "speed_scaling", "speed_fraction", "cycle_phase", "payload_kg", "main_voltage_v"}
    | {"collision_detection_ratio", "joint_position_deviation_ratio", "robot_current_a"}
)
BITS = frozenset({"digital_inputs", "digital_outputs"})
# What stands for a field the controller does not have, appended to each package.
ABSENT = (*NAN6, -1, NO_BITS)


def _outputs(cycle: CycleConfig) -> dict[str, tuple[str, ...]]:
    registers: dict[str, tuple[str, ...]] = {}
    if cycle.source == "counter":  # else another program's numbers may stand there
        registers["cycle_count"] = (f"output_int_register_{cycle.counter_register}",)
        registers["cycle_running"] = (f"output_int_register_{cycle.running_register}",)
    if cycle.phase_register is not None:
        registers["cycle_phase"] = (f"output_double_register_{cycle.phase_register}",)
    return OUTPUTS | registers | LATER_OUTPUTS


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
        The controller gives one of the fields as a number where six are due, or the other way round, or as a real
        number where a whole one is due.
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
    due = WIDTHS.get(field, 1)
    if width != due:
        raise ValueError(f"gives '{name}' as {width} numbers where {due} are due")
    if field not in REALS and due == 1 and recipe.types[recipe.names.index(name)] == "DOUBLE":
        raise ValueError(f"gives '{name}' as a real number where a whole one is due")
    return key


def _absent_key(field: str, width: int) -> int | slice:
    """Point into `ABSENT`, which follows the package's `width` numbers."""
    if field in WIDTHS:
        return slice(width, width + WIDTHS[field])
    if field in REALS:
        return width
    return width + ABSENT.index(NO_BITS if field in BITS else -1)
