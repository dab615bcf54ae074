"""The way of the frames through a network that may lose, double and overtake them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from bench.config import SimulationConfig
from bench.drivers.tracker.natnet.frame import Frame
from bench.simulation.scheduler import Scheduler

__all__ = ["Delivery"]

HELD_PERIODS = 1.5
"""A frame that is overtaken comes after the one or two that follow it."""


class Delivery:
    """Sends frames when they are due, less what gets lost. On the scheduler's thread, but for what is ordered.

    Parameters
    ----------
    simulation : SimulationConfig
        How often frames are lost, doubled and overtaken.
    scheduler : Scheduler
    rng : numpy.random.Generator
    send : callable
        Sends a frame to whoever wants it.
    """

    def __init__(
        self,
        simulation: SimulationConfig,
        scheduler: Scheduler,
        rng: np.random.Generator,
        send: Callable[[Frame], None],
    ) -> None:
        self._shares = (
            simulation.frame_loss_probability,
            simulation.frame_duplicate_probability,
            simulation.frame_reorder_probability,
        )
        self._is_perfect = not any(self._shares)
        self._held_ns = round(HELD_PERIODS / simulation.tracker_rate_hz * 1e9)
        self._scheduler = scheduler
        self._rng = rng
        self._send = send
        self._last_ns = 0
        self.lose_next = 0
        """So many frames are lost from now on, whatever chance says."""
        self.double_next = 0
        """So many frames are sent twice from now on."""
        self.n_lost = 0
        """Frames lost on the way."""
        self.n_doubled = 0
        """Frames sent twice."""
        self.n_held = 0
        """Frames held back, so that the next ones overtake them unless they are held too."""

    def put(self, frame: Frame, due_ns: int) -> None:
        """Let a frame leave at `due_ns`, but never before one that was due earlier, unless that is overtaken."""
        is_lost, is_doubled, is_held = self._draw()
        if is_lost:
            self.n_lost += 1
            return
        if is_held:
            self.n_held += 1
            due_ns += self._held_ns
        else:
            due_ns = self._last_ns = max(self._last_ns, due_ns)
        for _ in range(1 + is_doubled):
            self._scheduler.call_at(due_ns, partial(self._leave, frame))
        self.n_doubled += is_doubled

    def _draw(self) -> tuple[bool, bool, bool]:
        loss, double, hold = (False,) * 3 if self._is_perfect else (self._rng.random(3) < self._shares).tolist()
        if self.lose_next:
            self.lose_next -= 1
            loss = True
        elif self.double_next and not loss:
            self.double_next -= 1
            double = True
        return loss, double, hold

    def _leave(self, frame: Frame, _due_ns: int) -> None:
        self._send(frame)
