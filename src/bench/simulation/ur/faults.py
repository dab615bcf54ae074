"""What may go wrong with a controller's links, on command: for tests of whoever talks to it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from bench.simulation.network import ServerThread
from bench.simulation.scheduler import Scheduler
from bench.simulation.ur.rtde import RtdeServer
from bench.timing import Clock, patience_ns

__all__ = ["LinkFaults", "wait_for"]

T = TypeVar("T")

ANSWER_LIMIT_S = 10.0
"""A thread of the simulator that does not act in this time is not running."""


def wait_for(post: Callable[[Callable[[], None]], None], action: Callable[[], T]) -> T:
    """Have another thread run `action`, by way of `post`, and return what it returned, or raise what it raised.

    Raises
    ------
    TimeoutError
        That thread is not running.
    """
    future: Future[T] = Future()

    def act() -> None:
        try:
            future.set_result(action())
        except Exception as error:
            future.set_exception(error)

    post(act)
    return future.result(ANSWER_LIMIT_S)


class LinkFaults:
    """Faults of one controller's network side. Each call returns when the fault is in effect; any thread but its own.

    Durations are in the machine's own seconds, as the limits are that clients have for a link.

    Parameters
    ----------
    network : ServerThread
        Serves the controller's ports.
    rtde : RtdeServer
        Sends the data packages.
    scheduler : Scheduler
        Ends what lasts a while.
    clock : Clock
        The scheduler's.
    """

    def __init__(self, network: ServerThread, rtde: RtdeServer, scheduler: Scheduler, clock: Clock) -> None:
        self._network = network
        self._rtde = rtde
        self._scheduler = scheduler
        self._clock = clock
        self._stalled_until_ns = self._held_until_ns = 0
        self._n_skip = 0

    def lets_pass(self) -> bool:
        """Whether the data packages of this tick are sent; the scheduler's thread, once a tick."""
        if self._n_skip > 0:
            self._n_skip -= 1
            return False
        return self._stalled_until_ns == 0

    def stall(self, duration_s: float) -> None:
        """Neither send, nor answer, nor accept for a while; the packages of that time never come."""
        self._stalled_until_ns = max(self._stalled_until_ns, self._end_ns(duration_s))
        wait_for(self._network.call, self._network.sleep)
        self._scheduler.call_at(self._stalled_until_ns, self._end_stall)

    def burst(self, duration_s: float) -> None:
        """Hold everything for a while, then deliver it at once, as a network does; nothing is lost."""
        self._held_until_ns = max(self._held_until_ns, self._end_ns(duration_s))
        self._rtde.hold_packages()
        self._scheduler.call_at(self._held_until_ns, self._end_burst)

    def delay(self, duration_s: float) -> None:
        """Let every package come so much later from now on, as a network does that queues; 0 ends it."""
        self._rtde.delay_ns = patience_ns(self._clock, duration_s)

    def skip(self, n_ticks: int) -> None:
        """Send no packages in the next ticks of the controller, as one does that is busy."""
        self._n_skip = n_ticks

    def drop(self, *, abruptly: bool) -> None:
        """Close all connections: by RST if `abruptly`, else by FIN."""
        wait_for(self._network.call, lambda: self._network.drop_clients(abruptly=abruptly))

    def set_half_open(self, is_half_open: bool) -> None:
        """Accept clients from now on and never answer them, as a controller does that boots; or end that."""
        self._network.is_half_open = is_half_open

    def hold_register(self, number: int) -> None:
        """Let an input register belong to another client. `ValueError` if it is unknown or in use."""
        wait_for(self._network.call, lambda: self._rtde.claim(f"input_int_register_{number}"))

    def release_register(self, number: int) -> None:
        """End that."""
        wait_for(self._network.call, lambda: self._rtde.release(f"input_int_register_{number}"))

    def _end_ns(self, duration_s: float) -> int:
        return self._clock.now_ns() + patience_ns(self._clock, duration_s)

    def _end_stall(self, host_ns: int) -> None:
        if host_ns >= self._stalled_until_ns:
            self._stalled_until_ns = 0
            self._network.call(self._network.wake)

    def _end_burst(self, host_ns: int) -> None:
        if host_ns >= self._held_until_ns:
            self._rtde.release_packages()
