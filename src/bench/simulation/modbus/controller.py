"""A simulated controller with a Modbus server: a PLC that scans, and a robot that follows its path."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from bench.config import ModbusRobotConfig
from bench.simulation.device_clock import DeviceClock
from bench.simulation.modbus.faults import PlcFaults
from bench.simulation.modbus.logic import PlcLogic
from bench.simulation.modbus.server import TableServer
from bench.simulation.modbus.tables import Tables
from bench.simulation.program import PathProgram
from bench.simulation.scheduler import Scheduler
from bench.timing import Clock

__all__ = ["ModbusController"]

SCAN_S = 0.01
"""A usual PLC's scan; its registers are as old as that."""
COUNT_BEFORE = 65_530
"""Where a counter that counts on stands at first: a 16-bit one wraps within the first cycles."""


class ModbusController:
    """Serves one robot by Modbus TCP to any number of clients.

    Parameters
    ----------
    config : ModbusRobotConfig
        Address and register map, as the driver has them.
    program : PathProgram
        The only program on the controller.
    scheduler : Scheduler
        Runs the scans.
    clock : Clock
        Host time.
    controller_clock : DeviceClock
        The controller's own clock.
    """

    def __init__(
        self,
        config: ModbusRobotConfig,
        program: PathProgram,
        scheduler: Scheduler,
        clock: Clock,
        *,
        controller_clock: DeviceClock,
    ) -> None:
        self.tables = Tables(config.map)
        self.logic = PlcLogic(config, program, self.tables, clock, controller_clock, COUNT_BEFORE)
        self.server = TableServer(config.host, config.port, config.unit_id, self.tables)
        self._at_scan: deque[Callable[[], None]] = deque()
        self.faults = PlcFaults(self.logic, self.server, self._at_scan.append)
        self.ports = {"port": config.port}
        """For the line that says that it serves."""
        self._scheduler = scheduler
        self._clock = clock
        self._is_open = False

    def open(self) -> None:
        """Bind the port, start serving and scan for the first time. `ConnectError` if the port is in use."""
        now_ns = self._clock.now_ns()
        self.logic.scan(now_ns)
        self.server.open()
        self._is_open = True
        self._schedule(now_ns)

    def close(self) -> None:
        """Stop scanning and close all connections. May be called twice."""
        self._is_open = False
        self.server.close()

    def _schedule(self, now_ns: int) -> None:
        self._scheduler.call_at(now_ns + round(SCAN_S * 1e9), self._scan)

    def _scan(self, due_ns: int) -> None:
        if self._is_open:
            for _ in range(len(self._at_scan)):
                self._at_scan.popleft()()
            self.logic.scan(due_ns)
            self._schedule(due_ns)
