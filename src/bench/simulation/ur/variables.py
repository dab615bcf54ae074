"""The variables a controller has, with their RTDE types and what they read when nothing moves.

Names and types: RTDE guide of Universal Robots, e-Series 5.x, and the tables of its client library.
"""

from __future__ import annotations

from bench.drivers.robot.ur.recipe import DATA_TYPES, Value

__all__ = ["INPUT_TYPES", "OUTPUT_TYPES", "initial_values"]

N_REGISTERS = 48
N_BITS = 128

_BY_TYPE: dict[str, tuple[str, ...]] = {
    "DOUBLE": (
        "timestamp",
        "actual_execution_time",
        "speed_scaling",
        "target_speed_fraction",
        "actual_momentum",
        "actual_main_voltage",
        "actual_robot_voltage",
        "actual_robot_current",
        "standard_analog_input0",
        "standard_analog_input1",
        "standard_analog_output0",
        "standard_analog_output1",
        "io_current",
        "euromap67_24V_voltage",
        "euromap67_24V_current",
        "tool_analog_input0",
        "tool_analog_input1",
        "tool_output_current",
        "tool_temperature",
        "tcp_force_scalar",
        "payload",
        "joint_position_deviation_ratio",
        "collision_detection_ratio",
    ),
    "VECTOR6D": (
        "target_q",
        "target_qd",
        "target_qdd",
        "target_current",
        "target_moment",
        "actual_q",
        "actual_qd",
        "actual_current",
        "actual_current_window",
        "actual_current_as_torque",
        "joint_control_output",
        "actual_TCP_pose",
        "actual_TCP_speed",
        "actual_TCP_force",
        "target_TCP_pose",
        "target_TCP_speed",
        "joint_temperatures",
        "actual_joint_voltage",
        "payload_inertia",
        "ft_raw_wrench",
        "tcp_offset",
    ),
    "VECTOR3D": ("actual_tool_accelerometer", "elbow_position", "elbow_velocity", "payload_cog"),
    "VECTOR6INT32": ("joint_mode",),
    "UINT64": ("actual_digital_input_bits", "actual_digital_output_bits", "control_step"),
    "INT32": ("robot_mode", "safety_mode", "safety_status", "tool_output_voltage", "time_scale_source"),
    "UINT32": (
        "runtime_state",
        "robot_status_bits",
        "safety_status_bits",
        "analog_io_types",
        "euromap67_input_bits",
        "euromap67_output_bits",
        "tool_mode",
        "tool_analog_input_types",
        "output_bit_registers0_to_31",
        "output_bit_registers32_to_63",
        "script_control_line",
    ),
    "UINT8": ("tool_output_mode", "tool_digital_output0_mode", "tool_digital_output1_mode"),
}
_INPUTS_BY_TYPE: dict[str, tuple[str, ...]] = {
    "UINT32": ("speed_slider_mask", "input_bit_registers0_to_31", "input_bit_registers32_to_63"),
    "DOUBLE": ("speed_slider_fraction", "standard_analog_output_0", "standard_analog_output_1"),
    "UINT8": (
        "standard_digital_output_mask",
        "standard_digital_output",
        "configurable_digital_output_mask",
        "configurable_digital_output",
        "tool_digital_output_mask",
        "tool_digital_output",
        "standard_analog_output_mask",
        "standard_analog_output_type",
    ),
    "VECTOR6D": ("external_force_torque",),
}
# An arm of the UR5e's size at room temperature, powered, with the fingers off the tool.
_AT_REST: dict[str, Value] = {
    "actual_execution_time": 0.0004,
    "speed_scaling": 1.0,
    "target_speed_fraction": 1.0,
    "actual_main_voltage": 48.0,
    "actual_robot_voltage": 48.0,
    "actual_robot_current": 0.6,
    "payload": 0.4,
    "payload_cog": (0.0, 0.0, 0.03),
    "io_current": 0.03,
    "tool_temperature": 27.5,
    "joint_temperatures": (29.1, 30.4, 30.0, 32.6, 33.2, 33.9),
    "actual_joint_voltage": (48.1, 48.0, 48.0, 47.9, 47.9, 47.8),
    "actual_current_window": (2.0, 2.0, 2.0, 1.0, 1.0, 1.0),
    "actual_tool_accelerometer": (0.0, 0.0, 9.82),
    "joint_mode": (253,) * 6,  # JOINT_RUNNING_MODE
    "robot_mode": 7,  # RUNNING
    "safety_mode": 1,  # NORMAL
    "safety_status": 1,
    "safety_status_bits": 1,
    "runtime_state": 1,  # stopped
    "robot_status_bits": 1,  # power on
    "tool_mode": 253,
}


def _registers(direction: str) -> dict[str, str]:
    types = {f"{direction}_bit_register_{n}": "BOOL" for n in range(N_BITS)}
    types |= {f"{direction}_int_register_{n}": "INT32" for n in range(N_REGISTERS)}
    return types | {f"{direction}_double_register_{n}": "DOUBLE" for n in range(N_REGISTERS)}


def _by_name(by_type: dict[str, tuple[str, ...]]) -> dict[str, str]:
    return {name: kind for kind, names in by_type.items() for name in names}


INPUT_TYPES: dict[str, str] = _by_name(_INPUTS_BY_TYPE) | _registers("input")
"""What a client may write, and its type."""
OUTPUT_TYPES: dict[str, str] = _by_name(_BY_TYPE) | _registers("output") | _registers("input")
"""What a client may read, and its type; input registers can be read back."""


def initial_values() -> dict[str, Value]:
    """Return a value for each variable, as after start-up with the brakes released."""
    return {name: _zero(kind) for name, kind in (INPUT_TYPES | OUTPUT_TYPES).items()} | _AT_REST


def _zero(kind: str) -> Value:
    code, count = DATA_TYPES[kind]
    zero: float | int | bool = {"d": 0.0, "?": False}.get(code, 0)
    return zero if count == 1 else (zero,) * count
