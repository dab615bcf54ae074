"""The robot behind the ports: modes, program, registers and what each variable reads at a tick."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from bench.drivers.robot.ur.recipe import Value
from bench.simulation.program import PULSE_PHASE, Motion, PathProgram
from bench.simulation.ur.kinds import E_SERIES, ControllerKind
from bench.simulation.ur.script import ControlScript
from bench.simulation.ur.variables import initial_values

__all__ = ["CycleRegisters", "Machine", "RobotMode", "SafetyStatus"]

RUNTIME_STATES = {"STOPPED": 1, "PLAYING": 2, "PAUSED": 4}
# Gearing and friction of a small arm, rounded: enough that currents rise with speed and hold against gravity.
HOLDING_CURRENT_A = (0.0, 2.6, 1.4, 0.35, 0.1, 0.05)
CURRENT_PER_SPEED = 1.2
"""Amperes per rad/s."""
UNLIMITED = 1 << 31
"""Grants of a program that waits for none."""
UNLOCK_AFTER_NS = 5_000_000_000
"""A protective stop can be released 5 s after it occurred (dashboard server manual)."""
LONGEST_MEMORY = 10_000
"""Commands that are remembered: a run of a few thousand cycles."""


class RobotMode(IntEnum):
    """Robot modes of the RTDE guide, under the dashboard's words for them."""

    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    RUNNING = 7


class SafetyStatus(IntEnum):
    """Safety statuses of the RTDE guide, under the dashboard's words for them."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    SAFEGUARD_STOP = 5
    ROBOT_EMERGENCY_STOP = 7


MOVING_STATUSES = (SafetyStatus.NORMAL, SafetyStatus.REDUCED)
STOPPED_BIT = 1 << 10
SAFETY_BITS = {
    SafetyStatus.NORMAL: 1 << 0,
    SafetyStatus.REDUCED: 1 << 1,
    SafetyStatus.PROTECTIVE_STOP: 1 << 2 | STOPPED_BIT,
    SafetyStatus.SAFEGUARD_STOP: 1 << 4 | STOPPED_BIT,
    SafetyStatus.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | STOPPED_BIT,
}
"""`safety_status_bits` of each status (RTDE guide); bit 10 is 'stopped due to safety'."""


@dataclass(frozen=True, slots=True)
class CycleRegisters:
    """Which registers and output the program writes and reads."""

    grant: int | None = 24
    """None: the program waits for no grant and repeats its path until it is stopped."""
    counter: int = 24
    running: int = 25
    phase: int | None = None
    digital_output: int | None = None
    """Output that is high on the path."""
    pulses: bool = False
    """The output is high in the first part of the path only."""


class Machine:
    """State of the simulated controller. `tick` and the commands run on the scheduler's thread.

    Parameters
    ----------
    program : PathProgram
        The only program on this controller.
    registers : CycleRegisters
        How the program and the outside talk.
    rate_hz : float
        Ticks a second.
    kind : ControllerKind
        Generation of the controller.
    """

    def __init__(
        self, program: PathProgram, registers: CycleRegisters, rate_hz: float, kind: ControllerKind = E_SERIES
    ) -> None:
        self.program = program
        self.kind = kind
        self.loaded = False
        self._foreign = ""
        self._script: ControlScript | None = None
        self._goes_on = False
        self.values = initial_values()
        self.told: deque[str] = deque(maxlen=LONGEST_MEMORY)
        """Commands and grants that clients gave, in their words, the newest last."""
        self._grant_name = None if registers.grant is None else f"input_int_register_{registers.grant}"
        self._output_bit = 0 if registers.digital_output is None else 1 << registers.digital_output
        self._high_until = PULSE_PHASE if registers.pulses else 2.0
        self._counter_name = f"output_int_register_{registers.counter}"
        self._running_name = f"output_int_register_{registers.running}"
        self._phase_name = None if registers.phase is None else f"output_double_register_{registers.phase}"
        self._rate_hz = rate_hz
        self._stopped_ns = 0

    @property
    def state(self) -> str:
        """'STOPPED', 'PLAYING' or 'PAUSED': of whatever runs."""
        return self.program.state if self._script is None else "PLAYING"

    @property
    def loaded_name(self) -> str:
        """Name of the program that is loaded, ours or another; empty if none is."""
        return self.program.name if self.loaded else self._foreign

    @property
    def robot_mode(self) -> RobotMode:
        return RobotMode(int(self._scalar("robot_mode")))

    @property
    def safety_status(self) -> SafetyStatus:
        return SafetyStatus(int(self._scalar("safety_status")))

    @property
    def can_play(self) -> bool:
        """Whether `play` would start or resume the program."""
        is_ready = self.robot_mode == RobotMode.RUNNING and self.safety_status in MOVING_STATUSES
        return self.loaded and is_ready and self.state != "PLAYING"

    def _scalar(self, name: str) -> float:
        value = self.values[name]
        if isinstance(value, tuple):
            raise TypeError(f"{name} is a vector")
        return value

    def tick(self, tick_number: int, host_ns: int) -> None:
        """Advance the program to `host_ns` and set every variable that moves."""
        values = self.values
        speed = self._scalar("target_speed_fraction")
        granted = UNLIMITED if self._grant_name is None else int(self._scalar(self._grant_name))
        self.program.tick(host_ns, granted, speed)
        values["timestamp"] = tick_number / self._rate_hz
        values["control_step"] = tick_number
        if self._script is not None and not self._script.tick(values):
            self._script = None
        state = self.state
        values["runtime_state"] = RUNTIME_STATES[state]
        values["robot_status_bits"] = (values["robot_mode"] != RobotMode.POWER_OFF) | (state == "PLAYING") << 1
        self._set_motion(self.program.motion_at(host_ns))

    def _set_motion(self, motion: Motion) -> None:
        values = self.values
        values["actual_q"] = values["target_q"] = motion.q_rad
        values["actual_qd"] = values["target_qd"] = motion.qd_rad_s
        values["actual_TCP_pose"] = values["target_TCP_pose"] = motion.tcp_pose
        values["actual_TCP_speed"] = values["target_TCP_speed"] = motion.tcp_speed
        current = tuple(
            [hold + CURRENT_PER_SPEED * qd for hold, qd in zip(HOLDING_CURRENT_A, motion.qd_rad_s, strict=True)]
        )
        values["actual_current"] = values["target_current"] = values["joint_control_output"] = current
        values[self._counter_name] = motion.cycle_count
        values[self._running_name] = motion.cycle_running
        if self._phase_name is not None:
            values[self._phase_name] = motion.phase
        if self._output_bit:
            is_high = motion.cycle_running == 1 and motion.phase < self._high_until
            others = int(self._scalar("actual_digital_output_bits")) & ~self._output_bit
            values["actual_digital_output_bits"] = others | (self._output_bit if is_high else 0)

    def write_inputs(self, inputs: Mapping[str, Value]) -> None:
        """Keep what a client wrote and let it act where it does; from the network's thread."""
        self.values.update(inputs)
        if self._grant_name is not None and self._grant_name in inputs:
            self.told.append(f"grant {inputs[self._grant_name]}")
        slider = self._scalar("speed_slider_fraction")
        if inputs.get("speed_slider_mask") and 0.0 <= slider <= 1.0:
            self.values["target_speed_fraction"] = slider
        self._write_digital_outputs(inputs)

    def _write_digital_outputs(self, inputs: Mapping[str, Value]) -> None:
        for kind, shift in (("standard", 0), ("configurable", 8), ("tool", 16)):
            mask = int(self._scalar(f"{kind}_digital_output_mask")) << shift
            if f"{kind}_digital_output_mask" in inputs and mask:
                bits = int(self._scalar(f"{kind}_digital_output")) << shift
                kept = int(self._scalar("actual_digital_output_bits")) & ~mask
                self.values["actual_digital_output_bits"] = kept | (bits & mask)

    def play(self, _host_ns: int) -> None:
        if self.can_play:
            self.program.play()

    def pause(self, _host_ns: int) -> None:
        self.program.pause()

    def resume(self, _host_ns: int) -> None:
        """Do what a person at the pendant does after a pause."""
        if self.program.state == "PAUSED" and self.can_play:
            self.program.play()

    def run_script(self, text: str) -> None:
        """Do what the script port does with a program: ours ends, and that one runs."""
        self._end_program()
        if self.robot_mode == RobotMode.RUNNING and self.safety_status in MOVING_STATUSES:
            self._script = ControlScript.of(text)

    def _end_program(self) -> None:
        self.program.stop()
        self._script = None

    def stop(self, _host_ns: int) -> None:
        self._end_program()

    def load(self, _host_ns: int) -> None:
        self._end_program()
        self.loaded = True
        self._foreign = ""

    def load_foreign(self, name: str) -> None:
        """Do what a person at the pendant does who loads another program: ours ends. That one cannot be played."""
        self._end_program()
        self.loaded = False
        self._foreign = name

    def protective_stop(self, host_ns: int) -> None:
        """Do what a collision does: the program is paused until a person has looked and unlocked."""
        self._stopped_ns = host_ns
        self._set_safety(SafetyStatus.PROTECTIVE_STOP)
        self.program.pause()

    def can_unlock(self, host_ns: int) -> bool:
        """Whether the time that must pass after a protective stop has passed."""
        return host_ns - self._stopped_ns >= UNLOCK_AFTER_NS

    def unlock(self, _host_ns: int) -> None:
        if self.safety_status == SafetyStatus.PROTECTIVE_STOP:
            self._set_safety(SafetyStatus.NORMAL)

    def safeguard_stop(self, _host_ns: int) -> None:
        """Do what an opened door does: the program pauses until the door is closed."""
        if self.safety_status in MOVING_STATUSES:
            self._goes_on = self.program.state == "PLAYING"
            self._set_safety(SafetyStatus.SAFEGUARD_STOP)
            self.program.pause()

    def safeguard_release(self, _host_ns: int) -> None:
        """Close the door: the program goes on by itself, as a controller without a reset button has it."""
        if self.safety_status == SafetyStatus.SAFEGUARD_STOP:
            self._set_safety(SafetyStatus.NORMAL)
            if self._goes_on:
                self.program.play()

    def emergency_stop(self, host_ns: int) -> None:
        """Do what the red button does: power off, program stopped."""
        self._set_safety(SafetyStatus.ROBOT_EMERGENCY_STOP)
        self.power_off(host_ns)

    def restart_safety(self, host_ns: int) -> None:
        self._set_safety(SafetyStatus.NORMAL)
        self.power_off(host_ns)

    def move_slider(self, fraction: float) -> None:
        """Do what a person at the pendant does with the speed slider."""
        self.values["target_speed_fraction"] = fraction

    def reboot(self, _host_ns: int) -> None:
        """Be as after switching off and on: power off, nothing loaded, every register 0."""
        self._end_program()
        self.program.reset()
        self.loaded = False
        self._foreign = ""
        self.values.update(initial_values(), robot_mode=int(RobotMode.POWER_OFF))

    def power_off(self, _host_ns: int) -> None:
        self._end_program()
        self.values["robot_mode"] = RobotMode.POWER_OFF

    def power_on(self, _host_ns: int) -> None:
        if self.robot_mode == RobotMode.POWER_OFF and self.safety_status == SafetyStatus.NORMAL:
            self.values["robot_mode"] = RobotMode.IDLE

    def release_brakes(self, host_ns: int) -> None:
        self.power_on(host_ns)
        if self.robot_mode == RobotMode.IDLE:
            self.values["robot_mode"] = RobotMode.RUNNING

    def _set_safety(self, status: SafetyStatus) -> None:
        self.values["safety_status"] = self.values["safety_mode"] = int(status)
        self.values["safety_status_bits"] = SAFETY_BITS[status]
