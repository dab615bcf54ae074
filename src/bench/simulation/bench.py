"""The whole simulated bench: robot controller and tracker on addresses of their own, one cable between them."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from bench.config import AnyRobotConfig, AnyTrackerConfig, Config, RobotConfig, SimulationConfig
from bench.errors import ConfigError
from bench.simulation.admin import AdminServer
from bench.simulation.device_clock import DeviceClock
from bench.simulation.modbus import ModbusController
from bench.simulation.natnet import NatNetServer
from bench.simulation.natnet.timing import stamp_delay_s
from bench.simulation.program import PathProgram
from bench.simulation.qualisys import QualisysServer
from bench.simulation.scene import Scene, make_path
from bench.simulation.scheduler import Scheduler
from bench.simulation.truth import TruthWriter
from bench.simulation.ur import KINDS, ControllerKind, UrController
from bench.timing import Clock

__all__ = ["SimulatedBench"]

TRACKER_TICKS_PER_S = 3_312_787
"""QueryPerformanceFrequency of a real Motive PC: not the 10 MHz one might assume."""
TRACKER_TICKS_AT_START = 987_654_321_012
"""The PC has been on for 3.5 days."""
QTM_TICKS_PER_S = 1_000_000
ROBOT_S_AT_START = 61.25
"""A controller answers about a minute after its own clock begins."""
FREE_REST_S = 0.05
"""Rest between the cycles of a program that waits for no grant: 6 samples at 125 Hz."""
DATA_PORT = 1511
"""NatNet's own, unless [tracker] says another."""
DASHBOARD_PORT = 29999
SLOW_RATE_HZ = 125.0


class SimulatedBench:
    """Robot, tracker and cable of one configuration.

    Parameters
    ----------
    config : Config
        Without a ``[simulation]`` table its defaults hold.
    clock : Clock
        Host time; the devices' own clocks drift against it as configured.
    truth : Path, optional
        Where to write what the simulated tracker knew.

    Raises
    ------
    ConfigError
        A table is missing, or the cable cannot be simulated.
    """

    def __init__(self, config: Config, clock: Clock, *, truth: Path | None = None) -> None:
        if config.robot is None or config.tracker is None:
            missing = "robot" if config.robot is None else "tracker"
            raise ConfigError(f"A simulated bench needs a [{missing}] table.", hint="See bench_configs/simulated.toml.")
        self._robot_config, self._tracker_config = config.robot, config.tracker
        self._simulation = config.simulation or SimulationConfig()
        self._sync_output = config.calibration.sync_output
        self._clock = clock
        self.scheduler = Scheduler(clock)
        path = make_path(config)
        rest_s = 0.0 if config.robot.cycle.is_granted else FREE_REST_S
        cycle_s = self._simulation.cycle_s
        self.program = PathProgram(config.robot.program, cycle_s=cycle_s, path=path, rest_s=rest_s)
        self.scene = Scene(config, self.program)
        self._truth: TruthWriter | None = None
        self._open_truth = partial(_open_truth, truth, config, self.scene)
        started_ns = clock.now_ns()
        self.robot = self._make_robot(config.robot, started_ns)
        self.tracker = self._make_tracker(config.tracker, started_ns)
        self._admin = self._make_admin()

    def open(self) -> list[str]:
        """Bind all ports and return one line for each device that serves.

        Raises
        ------
        ConnectError
            A port is already in use; nothing stays open, and no truth file is left behind.
        RecordingError
            The truth file exists or cannot be created.
        """
        self._truth = self._open_truth()
        self.scene.truth = self._truth.put if self._truth else None
        try:
            self.robot.open()
            self.tracker.open()
            if self._admin is not None:
                self._admin.open()
        except BaseException:
            self._close_devices()
            if self._truth is not None:
                self._truth.discard()
            raise
        robot, tracker = self._robot_config, self._tracker_config
        robot_ports = " ".join(f"{name}={port}" for name, port in self.robot.ports.items())
        if self._admin is not None:
            robot_ports += f" admin={self._simulation.admin_port}"
        tracker_ports = (
            f"rt={tracker.port}"
            if tracker.kind == "qualisys"
            else f"command={tracker.command_port} data={tracker.data_port or DATA_PORT}"
        )
        return [
            f"ready robot {robot.kind} {robot.host} {robot_ports} program={robot.program}",
            f"ready tracker {tracker.kind} {tracker.host} {tracker_ports} rate_hz={self._simulation.tracker_rate_hz:g}",
        ]

    def run(self) -> None:
        """Let simulated time pass until `stop` is called; the caller's thread runs everything timed."""
        self.scheduler.run()

    def stop(self) -> None:
        """Make `run` return. May be called from any thread and from a signal handler."""
        self.scheduler.stop()

    def close(self) -> None:
        """Close all ports and finish the truth file. `RecordingError` if that could not be written whole."""
        try:
            self._close_devices()
        finally:
            if self._truth is not None:
                self._truth.close()

    def _close_devices(self) -> None:
        if self._admin is not None:
            self._admin.close()
        try:
            self.tracker.close()
        finally:
            self.robot.close()

    def _make_robot(self, robot: AnyRobotConfig, started_ns: int) -> UrController | ModbusController:
        clock = DeviceClock(started_ns, round(ROBOT_S_AT_START * 1e9), 1e9, self._simulation.robot_clock_ppm)
        if robot.kind == "modbus":
            return ModbusController(robot, self.program, self.scheduler, self._clock, controller_clock=clock)
        return self._make_ur(robot, clock)

    def _make_ur(self, robot: RobotConfig, clock: DeviceClock) -> UrController:
        cycle, kind = robot.cycle, KINDS[self._simulation.controller]
        return UrController(
            robot.host,
            self.program,
            self.scheduler,
            self._clock,
            controller_clock=clock,
            rate_hz=_controller_rate_hz(robot.rate_hz, kind),
            grant_register=cycle.grant_register if cycle.is_granted else None,
            counter_register=cycle.counter_register,
            running_register=cycle.running_register,
            phase_register=cycle.phase_register,
            digital_output=self._sync_output if cycle.digital_output is None else cycle.digital_output,
            output_pulses=cycle.digital_output_mode == "pulse",
            remote_control=self._simulation.remote_control,
            rtde_port=robot.rtde_port,
            dashboard_port=DASHBOARD_PORT,
            robot_api_port=robot.robot_api_port,
            kind=kind,
        )

    def _make_admin(self) -> AdminServer | None:
        port = self._simulation.admin_port
        if port == 0:
            return None
        return AdminServer(self._robot_config.host, port, self.robot, self.tracker, self._clock)

    def _make_tracker(self, tracker: AnyTrackerConfig, started_ns: int) -> NatNetServer | QualisysServer:
        ppm = self._simulation.tracker_clock_ppm
        if tracker.kind == "qualisys":
            return QualisysServer(
                tracker.host,
                self.scene,
                self.scheduler,
                self._clock,
                tracker_clock=DeviceClock(started_ns, 0, QTM_TICKS_PER_S, ppm),
                rate_hz=self._simulation.tracker_rate_hz,
                port=tracker.port,
            )
        return NatNetServer(
            tracker.host,
            self.scene,
            self.scheduler,
            self._clock,
            tracker_clock=DeviceClock(started_ns, TRACKER_TICKS_AT_START, TRACKER_TICKS_PER_S, ppm),
            command_port=tracker.command_port,
            data_port=tracker.data_port or DATA_PORT,
            simulation=self._simulation,
        )


def _controller_rate_hz(asked_hz: float, kind: ControllerKind) -> float:
    """Return a quarter of the controller's tick where that gives the asked rate, as it costs a quarter."""
    return SLOW_RATE_HZ if SLOW_RATE_HZ % asked_hz == 0.0 else kind.rate_hz


def _open_truth(path: Path | None, config: Config, scene: Scene) -> TruthWriter | None:
    if path is None:
        return None
    markers = config.cable.arc_length_m
    arc_length_m = np.linspace(markers[0], markers[-1], config.analysis.arc_length_samples)
    delay_s = stamp_delay_s(config.simulation or SimulationConfig())
    facts = {**scene.facts(), "tracker_stamp_delay_s": delay_s}
    return TruthWriter(path, scene.curvature(arc_length_m), arc_length_m, len(markers), facts)
