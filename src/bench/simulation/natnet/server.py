"""A tracker on the wire: exposures at exact periods of its own clock, frames to every client or to the group."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from bench.config import SimulationConfig
from bench.drivers.tracker.natnet.frame import BITSTREAM_CHANGED, MODELS_CHANGED, RECORDING, Frame, encode_frame
from bench.drivers.tracker.natnet.messages import ServerInfo
from bench.drivers.tracker.natnet.wire import Version
from bench.simulation.device_clock import DeviceClock
from bench.simulation.natnet.answers import Answers
from bench.simulation.natnet.clients import Address, Clients
from bench.simulation.natnet.delivery import Delivery
from bench.simulation.natnet.links import Links
from bench.simulation.natnet.packets import APP_VERSIONS, make_frame, make_models
from bench.simulation.natnet.timing import FrameTiming
from bench.simulation.scene import Scene
from bench.simulation.scheduler import Scheduler
from bench.simulation.ur.faults import wait_for
from bench.timing import Clock, patience_ns

__all__ = ["NatNetServer"]

FIRST_FRAME_NUMBER = 1042
"""Motive counts from its own start, long before anyone listens."""
NUMBER_AFTER_RESTART = 17
TICKS_S_AFTER_RESTART = 45.0
"""A PC that was switched off counts from its own start: it takes about so long."""
LONGEST_JUMP = 10
"""By how much a frame number may jump."""


class NatNetServer:
    """Simulates OptiTrack Motive, streaming unicast or multicast.

    Parameters
    ----------
    host : str
        Address to bind.
    scene : Scene
        Is exposed once a period, on the scheduler's thread, whether or not anyone listens.
    scheduler : Scheduler
        Runs exposures and transmissions.
    clock : Clock
    tracker_clock : DeviceClock
        The clock that Motive's stamps and clock answers are in.
    command_port, data_port : int
        NatNet's ports; unicast uses the first alone.
    simulation : SimulationConfig, optional
        Version, rate, cameras, delays and faults of the network; left out, its defaults.
    """

    def __init__(
        self,
        host: str,
        scene: Scene,
        scheduler: Scheduler,
        clock: Clock,
        *,
        tracker_clock: DeviceClock,
        command_port: int = 1510,
        data_port: int = 1511,
        simulation: SimulationConfig | None = None,
    ) -> None:
        simulation = simulation or SimulationConfig()
        self._scene = scene
        self._scheduler = scheduler
        self._clock = clock
        self._tracker_clock = tracker_clock
        self._simulation = simulation
        self._rate_hz = simulation.tracker_rate_hz
        self._rng = np.random.default_rng(simulation.seed)
        self._timing = FrameTiming(simulation, tracker_clock.ticks_per_s, self._rng)
        self._clients = Clients(clock)
        self._answers = Answers(
            self._describe(simulation.natnet_version, data_port),
            make_models(scene),
            self._clients,
            self._rate_hz,
            self._read_clock,
        )
        self._answers.newest_frame = self._encode_newest
        group = simulation.natnet_group if simulation.natnet_multicast else None
        self._links = Links((host, command_port), data_port, group, self._answer, self._clients.drop_silent)
        self.delivery = Delivery(simulation, scheduler, self._rng, self._transmit)
        """What becomes of the frames on their way."""
        self._newest: Frame | None = None
        self._is_open = False
        self._first_period = 0
        self._n_since_start = 0
        self._next_number = FIRST_FRAME_NUMBER
        self._changed = 0
        self._unseen: dict[int, str] = {}
        self._silent_until_ns = 0
        self.n_exposed = 0
        """Exposures so far."""
        self.n_sent = 0
        """Frame packets handed to the network, over all clients."""
        self.n_unsent = 0
        """Frame packets that the network did not take: its buffer was full."""

    def open(self) -> None:
        """Bind the ports, answer from now on, and expose from the next full period of the tracker's clock.

        Raises
        ------
        ConnectError
            An address is in use, or not ours.
        """
        self._links.open()
        self._is_open = True
        self._start_exposing()

    def close(self) -> None:
        """Stop answering and sending; what is still scheduled does nothing. May be called twice."""
        self._is_open = False
        self._links.close()

    @property
    def address(self) -> Address:
        """Host and command port; with port 0 the one that the system chose."""
        return self._links.address

    def stall(self, duration_s: float) -> None:
        """Send and answer nothing for a while of the machine's own time; what was due then never comes. Any thread."""
        self._silent_until_ns = self._clock.now_ns() + patience_ns(self._clock, duration_s)

    def act(self, effect: Callable[[], None]) -> None:
        """Run `effect` on the scheduler's thread and return when it is done; any thread but that."""
        now_ns = self._clock.now_ns()
        wait_for(lambda action: self._scheduler.call_at(now_ns, lambda _due_ns: action()), effect)

    def jump(self, n_numbers: int) -> None:
        """Leave out so many frame numbers. On the scheduler's thread, as what follows."""
        self._next_number += n_numbers

    def restart(self) -> None:
        """Be as after the PC was switched off and on: another clock, other frame numbers, no client known."""
        host_ns = self._clock.now_ns()
        ticks = round(TICKS_S_AFTER_RESTART * self._tracker_clock.ticks_per_s)
        self._tracker_clock = replace(self._tracker_clock, host_origin_ns=host_ns, ticks_origin=ticks)
        self._clients.forget()
        self._answers.is_recording = False
        self._next_number = NUMBER_AFTER_RESTART
        self._newest = None
        self._start_exposing()

    def change_version(self, name: str) -> None:
        """Speak another NatNet version from now on, to every client."""
        self._answers.info = self._describe(name, self._answers.info.data_port)
        self._clients.change_versions(self._answers.version)
        self._changed |= BITSTREAM_CHANGED

    def add_body(self, name: str) -> None:
        """Define one more rigid body, which no camera sees."""
        self._unseen[max((*self._scene.bodies, *self._unseen), default=0) + 1] = name
        self._answers.models = make_models(self._scene, self._unseen)
        self._changed |= MODELS_CHANGED

    def _describe(self, version_name: str, data_port: int) -> ServerInfo:
        major, minor = (int(part) for part in version_name.split("."))
        return ServerInfo(
            "Motive (simulated by bench)",
            APP_VERSIONS[major, minor],
            (major, minor, 0, 0),
            round(self._tracker_clock.ticks_per_s),
            data_port,
            self._simulation.natnet_multicast,
            tuple(int(part) for part in self._simulation.natnet_group.split(".")),
        )

    def _is_silent(self) -> bool:
        return self._clock.now_ns() < self._silent_until_ns

    def _answer(self, packet: bytes, sender: Address) -> bytes | None:
        return None if self._is_silent() else self._answers.answer(packet, sender)

    def _read_clock(self) -> int:
        return self._tracker_clock.ticks_at(self._clock.now_ns())

    def _start_exposing(self) -> None:
        self._n_since_start = 0
        self._first_period = int(self._read_clock() * self._rate_hz / self._tracker_clock.ticks_per_s) + 1
        self._schedule_exposure()

    def _schedule_exposure(self) -> None:
        clock, period = self._tracker_clock, self._first_period + self._n_since_start
        ticks = round(period * clock.ticks_per_s / self._rate_hz)
        self._scheduler.call_at(clock.host_ns_at(ticks), partial(self._expose, clock, ticks))

    def _expose(self, clock: DeviceClock, ticks: int, host_ns: int) -> None:
        if not self._is_open or clock is not self._tracker_clock:
            return
        number = self._draw_number()
        exposure = self._scene.expose(number, host_ns)
        stamps, leaves_ns = self._timing.draw(ticks)
        params = (RECORDING if self._answers.is_recording else 0) | self._changed
        timestamp_s = self._n_since_start / self._rate_hz
        ptp_ns = host_ns if self._simulation.ptp else None
        frame = make_frame(exposure, number, timestamp_s, stamps, params=params, ptp_ns=ptp_ns, unseen=self._unseen)
        self._changed = 0
        self.n_exposed += 1
        self._n_since_start += 1
        self.delivery.put(frame, host_ns + leaves_ns)
        self._schedule_exposure()

    def _draw_number(self) -> int:
        number = self._next_number
        self._next_number += 1
        chance = self._simulation.frame_jump_probability
        if chance and self._rng.random() < chance:
            self._next_number += int(self._rng.integers(1, LONGEST_JUMP + 1))
        return number

    def _transmit(self, frame: Frame) -> None:
        if not self._is_open:
            return
        self._newest = frame
        if self._simulation.natnet_multicast:
            self._count(not self._is_silent() and self._links.send_to_group(encode_frame(frame, self._answers.version)))
            return
        packets: dict[Version, bytes] = {}
        for address, version in self._clients.snapshot():
            if version not in packets:
                packets[version] = encode_frame(frame, version)
            self._count(not self._is_silent() and self._links.send(packets[version], address))

    def _count(self, is_sent: bool) -> None:
        self.n_sent += is_sent
        self.n_unsent += not is_sent

    def _encode_newest(self, version: Version) -> bytes | None:
        return None if self._newest is None else encode_frame(self._newest, version)
