"""What becomes of frames on their way, by the thousand and without a socket."""

from __future__ import annotations

import numpy as np
import pytest

from bench.config import SimulationConfig
from bench.drivers.tracker.natnet.frame import BODY, LABELED, Frame
from bench.simulation.natnet.delivery import Delivery
from bench.simulation.scheduler import Scheduler
from bench.timing import ManualClock

PERIOD_NS = 10_000_000
N = 5000


class Network:
    """Frames put in at their times, and what comes out, in order."""

    def __init__(self, **settings: float) -> None:
        self.clock = ManualClock()
        self.scheduler = Scheduler(self.clock)
        self.arrived: list[int] = []
        self.times_ns: list[int] = []
        rng = np.random.default_rng(4)
        self.delivery = Delivery(SimulationConfig(**settings), self.scheduler, rng, self._take)

    def _take(self, frame: Frame) -> None:
        self.arrived.append(frame.frame_number)
        self.times_ns.append(self.clock.now_ns())

    def carry(self, n: int = N, late_ns: int = 0) -> list[int]:
        """Send n frames a period apart, the first later by `late_ns`, and return the numbers as they arrive."""
        start_ns = self.clock.now_ns()
        for number in range(n):
            due_ns = start_ns + number * PERIOD_NS + (late_ns if number == 0 else 0)
            self.delivery.put(make_frame(number), due_ns)
        self.scheduler.call_at(start_ns + (n + 10) * PERIOD_NS, lambda _due_ns: self.scheduler.stop())
        self.scheduler.run()
        return self.arrived


def make_frame(number: int) -> Frame:
    none = np.zeros((0, 3), dtype=np.float32)
    return Frame(number, np.zeros(0, dtype=LABELED), np.zeros(0, dtype=BODY), none, 0.0, 1, 2, 3)


def test_by_default_every_frame_arrives_once_and_in_order() -> None:
    assert Network().carry() == list(range(N))


def test_frames_are_lost_as_often_as_configured() -> None:
    network = Network(frame_loss_probability=0.05)
    arrived = network.carry()
    assert len(arrived) == N - network.delivery.n_lost
    assert network.delivery.n_lost / N == pytest.approx(0.05, abs=0.01)
    assert arrived == sorted(set(arrived))


def test_frames_come_twice_as_often_as_configured() -> None:
    network = Network(frame_duplicate_probability=0.1)
    arrived = np.array(network.carry())
    assert sorted(set(arrived.tolist())) == list(range(N))
    assert np.count_nonzero(np.diff(arrived) == 0) == network.delivery.n_doubled == len(arrived) - N
    assert network.delivery.n_doubled / N == pytest.approx(0.1, abs=0.015)


def test_frames_are_overtaken_as_often_as_configured_and_none_is_lost() -> None:
    network = Network(frame_reorder_probability=0.05)
    arrived = network.carry()
    assert sorted(arrived) == list(range(N))
    assert network.delivery.n_held / N == pytest.approx(0.05, abs=0.01)
    newest = np.maximum.accumulate(arrived)
    behind = newest - arrived
    assert 0.9 * network.delivery.n_held < np.count_nonzero(behind) <= network.delivery.n_held
    assert set(behind.tolist()) <= {0, 1, 2}


def test_what_follows_a_late_frame_waits_for_it() -> None:
    network = Network()
    assert network.carry(5, late_ns=25_000_000) == [0, 1, 2, 3, 4]
    assert network.times_ns[0] == network.times_ns[1] == network.times_ns[2] < network.times_ns[3]


def test_losses_and_doubles_on_command_come_first() -> None:
    network = Network()
    network.delivery.lose_next, network.delivery.double_next = 3, 2
    assert network.carry(8) == [3, 3, 4, 4, 5, 6, 7]
