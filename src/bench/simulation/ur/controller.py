"""A simulated UR controller: ticks on its own clock, RTDE and dashboard ports on an address of its own."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from bench.simulation.device_clock import DeviceClock
from bench.simulation.network import ServerThread, Session
from bench.simulation.outbox import Outbox
from bench.simulation.program import PathProgram
from bench.simulation.scheduler import Scheduler
from bench.simulation.ur.dashboard import DashboardSession
from bench.simulation.ur.faults import LinkFaults, wait_for
from bench.simulation.ur.http import HttpSession
from bench.simulation.ur.kinds import E_SERIES, ControllerKind
from bench.simulation.ur.machine import CycleRegisters, Machine
from bench.simulation.ur.rest import RobotApi
from bench.simulation.ur.rtde import RtdeServer, RtdeSession
from bench.simulation.ur.script import ScriptSession
from bench.timing import Clock, patience_ns

__all__ = ["UrController"]

CUT_OFF_S = 10.0
"""A client that does not read is cut off after about 10 s (reported of real controllers)."""


class UrController:
    """Serves one robot to any number of clients.

    Parameters
    ----------
    host : str
        Address to serve on; a loopback address of its own, as clients assume the real ports.
    program : PathProgram
        The only program on the controller.
    scheduler : Scheduler
        Runs the ticks, and the effects of the dashboard's commands.
    clock : Clock
        Host time, for what is measured in it.
    controller_clock : DeviceClock
        The controller's clock: 1e9 ticks a second. What it reads at the start is the first `timestamp`.
    rate_hz : float
        Ticks a second: 500 for e-Series, 125 for CB3.
    grant_register, counter_register, running_register, phase_register : int
        Registers by which the program is granted cycles and tells them; without the first it waits for no grant.
    digital_output : int, optional
        Output that shows the cycles: high on the path, or in its first part only if `output_pulses`.
    remote_control : bool
        Whether the robot is in remote control.
    rtde_port, dashboard_port, robot_api_port : int
        The real controller's ports; PolyScope X has the last instead of the second. The script port is the one below
        the first: 30003.
    kind : ControllerKind
        Generation of the controller.
    """

    def __init__(
        self,
        host: str,
        program: PathProgram,
        scheduler: Scheduler,
        clock: Clock,
        *,
        controller_clock: DeviceClock,
        rate_hz: float = 500.0,
        grant_register: int | None = 24,
        counter_register: int = 24,
        running_register: int = 25,
        phase_register: int | None = None,
        digital_output: int | None = None,
        output_pulses: bool = False,
        remote_control: bool = True,
        rtde_port: int = 30004,
        dashboard_port: int = 29999,
        robot_api_port: int = 80,
        kind: ControllerKind = E_SERIES,
    ) -> None:
        registers = CycleRegisters(
            grant_register, counter_register, running_register, phase_register, digital_output, output_pulses
        )
        self.machine = Machine(program, registers, rate_hz, kind)
        self.remote_control = remote_control
        """May be switched while clients are connected; each keeps the permission it had when it connected."""
        self._host = host
        self._scheduler = scheduler
        self._clock = clock
        self._controller_clock = controller_clock
        self._rate_hz = rate_hz
        control = {"dashboard": dashboard_port} if kind.has_dashboard else {"robot_api": robot_api_port}
        self.ports = {"rtde": rtde_port} | control
        """What is served, and where."""
        self._rtde = RtdeServer(self.machine, rate_hz)
        self._network: ServerThread | None = None
        self._faults: LinkFaults | None = None
        self._is_open = False
        self._tick_number = 0

    def open(self) -> None:
        """Bind the ports, start serving and schedule the first tick.

        Raises
        ------
        ConnectError
            A port is already in use.
        """
        network = ServerThread(patience_ns(self._clock, CUT_OFF_S))
        welcome: dict[str, Callable[[Outbox], Session]] = {
            "rtde": self._welcome_rtde,
            "dashboard": self._welcome_dashboard,
            "robot_api": self._welcome_robot_api,
        }
        try:
            for name, port in self.ports.items():
                network.listen(self._host, port, welcome[name])
            network.listen(self._host, self.ports["rtde"] - 1, self._welcome_script)
        except BaseException:
            network.close()
            raise
        self._network = network
        self._faults = LinkFaults(network, self._rtde, self._scheduler, self._clock)
        self._is_open = True
        ticks_now = self._controller_clock.ticks_at(self._clock.now_ns())
        self._tick_number = math.ceil(ticks_now / self._controller_clock.ticks_per_s * self._rate_hz)
        self._schedule_tick()
        network.start()

    def close(self) -> None:
        """Stop ticking, close all connections and end the network's thread. May be called twice."""
        self._is_open = False
        if self._network is not None:
            self._network.close()

    @property
    def faults(self) -> LinkFaults:
        """What may go wrong with the links of a controller that serves."""
        if self._faults is None:
            raise RuntimeError("the controller is not open")
        return self._faults

    def run_later(self, delay_ns: int, effect: Callable[[int], None]) -> None:
        """Run `effect(host_ns)` on the scheduler's thread after a delay of the clock."""
        self._scheduler.call_at(self._clock.now_ns() + delay_ns, effect)

    def act(self, effect: Callable[[int], None]) -> None:
        """Run `effect(host_ns)` on the scheduler's thread and return when it is done; any thread but that."""
        wait_for(lambda action: self.run_later(0, lambda _host_ns: action()), lambda: effect(self._clock.now_ns()))

    def reboot(self) -> None:
        """Switch off and on: all connections end, the controller's time begins at 0, the robot is powered off."""
        self.act(self._reboot)
        self.faults.drop(abruptly=False)

    def _reboot(self, host_ns: int) -> None:
        self.machine.reboot(host_ns)
        self._controller_clock = replace(self._controller_clock, host_origin_ns=host_ns, ticks_origin=0)
        self._tick_number = 0

    def _schedule_tick(self) -> None:
        controller_clock = self._controller_clock
        due_ns = controller_clock.host_ns_at(self._tick_number / self._rate_hz * controller_clock.ticks_per_s)
        self._scheduler.call_at(due_ns, self._tick)

    def _tick(self, due_ns: int) -> None:
        if not self._is_open:
            return
        self.machine.tick(self._tick_number, due_ns)
        if self.faults.lets_pass():
            self._rtde.send_packages(self._tick_number, self._clock.now_ns())
        self._tick_number += 1
        self._schedule_tick()

    def _welcome_rtde(self, outbox: Outbox) -> RtdeSession:
        session = RtdeSession(self._rtde, outbox)
        self._rtde.add(session)
        return session

    def _welcome_dashboard(self, outbox: Outbox) -> DashboardSession:
        return DashboardSession(
            self.machine, outbox, self.run_later, self._clock.now_ns, is_remote=lambda: self.remote_control
        )

    def _welcome_robot_api(self, outbox: Outbox) -> HttpSession:
        api = RobotApi(self.machine, self.run_later, self._clock.now_ns, is_remote=lambda: self.remote_control)
        return HttpSession(outbox, api.answer)

    def _welcome_script(self, outbox: Outbox) -> ScriptSession:
        return ScriptSession(outbox, self._run_script)

    def _run_script(self, text: str) -> None:
        if self.remote_control or not self.machine.kind.has_remote_control:
            self.run_later(0, lambda _host_ns: self.machine.run_script(text))
