"""A simulated QTM that shows a known scene, with its scheduler running."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.simulation.device_clock import DeviceClock
from bench.simulation.qualisys import QualisysServer
from bench.simulation.scheduler import Scheduler
from bench.timing import RunClock

sys.path.insert(0, str(Path(__file__).parents[1] / "natnet"))

from natnet_bench import FakeScene

DRIFT_PPM = -42.0
PATIENCE_S = 20.0


class SimulatedQtm:
    """A server, its scheduler and its scene."""

    def __init__(self, host: str, clock: RunClock) -> None:
        self.host = host
        self.clock = clock
        self.scheduler = Scheduler(clock)
        self.scene = FakeScene()
        self.tracker_clock = DeviceClock(clock.now_ns(), 0, 1e6, DRIFT_PPM)
        self.server = QualisysServer(
            host, self.scene, self.scheduler, clock, tracker_clock=self.tracker_clock, rate_hz=100.0
        )


@contextmanager
def running_qtm(host: str, speed: float = 1.0) -> Iterator[SimulatedQtm]:
    qtm = SimulatedQtm(host, RunClock.start(speed))
    qtm.server.open()
    thread = threading.Thread(target=qtm.scheduler.run)
    thread.start()
    try:
        yield qtm
    finally:
        qtm.scheduler.stop()
        thread.join()
        qtm.server.close()
