"""Robots: the state stream and the control of the robot's own program, chosen by `[robot] kind`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bench.config import AnyRobotConfig, RobotConfig
from bench.drivers.base import ProgramControl, SignalWatch, StateStream
from bench.drivers.flight import FlightRecorder
from bench.drivers.robot.modbus import ModbusProgram, ModbusSignalWatch, ModbusStateStream
from bench.drivers.robot.ur.program import UrDashboardProgram
from bench.drivers.robot.ur.robot_api import RobotApiProgram
from bench.drivers.robot.ur.state import UrStateStream
from bench.drivers.robot.ur.watch import UrSignalWatch
from bench.errors import LinkLostError
from bench.timing import Clock

__all__ = ["make_program_control", "make_signal_watch", "make_state_stream"]

FIRST_POLYSCOPE_X = 10
"""Major version; CB3 is 3, PolyScope 5 is 5. From here on there is a Robot API in place of the dashboard."""


def make_state_stream(
    config: AnyRobotConfig,
    clock: Clock,
    *,
    on_missed: Callable[[str, int], None] | None = None,
    on_lost: Callable[[LinkLostError], None] | None = None,
    on_restored: Callable[[], None] | None = None,
    reconnect_s: float = 0.0,
    flight: FlightRecorder | None = None,
) -> StateStream:
    """Return the state stream of the configured robot, not yet open.

    Parameters
    ----------
    config : AnyRobotConfig
        The robot.
    clock : Clock
        Stamps what arrives.
    on_missed : callable, optional
        Called with the topic and the number of samples that never came; from the reader thread.
    on_lost : callable, optional
        Called once for each loss of the link; from the reader thread.
    on_restored : callable, optional
        Called once for each lost link that is back; from the reader thread.
    reconnect_s : float
        How long to try to reconnect after each loss, machine time; 0: a loss is final.
    flight : FlightRecorder, optional
        Keeps the last packets for the day on which the link ends badly.
    """
    keys: dict[str, Any] = {"on_missed": on_missed, "on_lost": on_lost, "on_restored": on_restored}
    keys |= {"reconnect_s": reconnect_s, "flight": flight}
    if config.kind == "ur":
        return UrStateStream(config, clock, **keys)
    return ModbusStateStream(config, clock, **keys)


def make_program_control(config: AnyRobotConfig, clock: Clock, *, controller_version: str = "") -> ProgramControl:
    """Return the program control of the configured robot, not yet open.

    Parameters
    ----------
    config : AnyRobotConfig
        The robot.
    clock : Clock
        Paces the polling.
    controller_version : str, optional
        What the state stream told of itself (`DeviceInfo.version`): decides where `program_control` is 'auto'.
    """
    if config.kind == "ur":
        return _make_ur_program(config, clock, controller_version)
    return ModbusProgram(config, clock)


def make_signal_watch(config: AnyRobotConfig, clock: Clock) -> SignalWatch:
    """Return a look at the configured robot that touches nothing, not yet open."""
    return UrSignalWatch(config, clock) if config.kind == "ur" else ModbusSignalWatch(config, clock)


def _make_ur_program(config: RobotConfig, clock: Clock, version: str) -> ProgramControl:
    major = version.partition(".")[0]
    is_polyscope_x = major.isdecimal() and int(major) >= FIRST_POLYSCOPE_X
    if config.program_control == "robot_api" or (config.program_control == "auto" and is_polyscope_x):
        return RobotApiProgram(config, clock)
    return UrDashboardProgram(config, clock)
