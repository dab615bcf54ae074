"""The processes of the tracker benchmark: a simulated tracker, our client, and the client from PyPI.

tracker_processes.py tracker HOST CLOCK STARTED_NS PPM
tracker_processes.py ours|peer HOST CLOCK SECONDS OUTPUT
"""

from __future__ import annotations

import json
import sys
import threading
import time

import numpy as np

HZ = 360.0
N_MARKERS = 50
PORT = 15_100
TICKS_PER_S = 3_312_787.0
TICKS_AT_START = 1_416_497_730_518
WARM_UP_S = 1.0


def main() -> None:
    role, host, *rest = sys.argv[1:]
    {"tracker": serve, "ours": read_ours, "peer": read_peer}[role](host, *rest)


class StillScene:
    """Fifty markers that the cameras see again and again: making them costs the simulated tracker nothing."""

    def __init__(self) -> None:
        from bench.model import UNLABELED
        from bench.simulation.scene import Exposure

        rng = np.random.default_rng(1)
        self.bodies: dict[int, tuple[str, object]] = {}
        self._exposure = Exposure(
            rng.normal(size=(N_MARKERS, 3)).astype(np.float32),
            np.arange(50_001, 50_001 + N_MARKERS, dtype=np.uint32),
            np.full(N_MARKERS, UNLABELED | 2, dtype=np.uint32),
            np.full(N_MARKERS, 0.01, dtype=np.float32),
            np.full(N_MARKERS, 0.0004, dtype=np.float32),
            (),
        )

    def expose(self, _frame_number: int, _host_ns: int) -> object:
        return self._exposure


def serve(host: str, clock_text: str, started_ns: str, ppm: str) -> None:
    """Stream until stdin closes, with the delays and the jitter of the simulated bench."""
    from bench.config import SimulationConfig
    from bench.simulation.device_clock import DeviceClock
    from bench.simulation.natnet import NatNetServer
    from bench.simulation.scheduler import Scheduler
    from bench.timing import RunClock

    clock = RunClock.from_text(clock_text)
    scheduler = Scheduler(clock)
    server = NatNetServer(
        host,
        StillScene(),
        scheduler,
        clock,
        tracker_clock=DeviceClock(int(started_ns), TICKS_AT_START, TICKS_PER_S, float(ppm)),
        command_port=PORT,
        simulation=SimulationConfig(tracker_rate_hz=HZ),
    )
    server.open()
    threading.Thread(target=lambda: (sys.stdin.read(), scheduler.stop()), daemon=True).start()
    print("ready", flush=True)
    scheduler.run()
    server.close()
    print(json.dumps({"sent": server.n_sent, "unsent": server.n_unsent}), flush=True)


def read_ours(host: str, clock_text: str, seconds: str, output: str) -> None:
    from bench.config import TrackerConfig
    from bench.drivers.tracker import make_tracker
    from bench.model import ClockSample, Record, TrackerFrame
    from bench.timing import RunClock

    frames: list[tuple[int, int, int, int]] = []
    samples: list[tuple[int, int, int]] = []
    n_points: set[int] = set()

    def keep(record: Record) -> None:
        if isinstance(record, TrackerFrame):
            frames.append((record.frame_number, record.device_ticks, record.arrival_ns, record.capture_ns))
            n_points.add(len(record.points_m))
        elif isinstance(record, ClockSample):
            samples.append((record.send_ns, record.device_ticks, record.receive_ns))

    client = make_tracker(TrackerConfig(host=host, command_port=PORT), RunClock.from_text(clock_text))
    client.open(keep)
    cores = _measure(float(seconds))
    client.close()
    if n_points != {N_MARKERS}:
        raise RuntimeError(f"frames of {n_points} points were read")
    np.savez(output, frames=np.array(frames, dtype=np.int64), samples=np.array(samples, dtype=np.int64))
    _tell([number for number, *_ in frames], cores)


def read_peer(host: str, _clock: str, seconds: str, _output: str) -> None:
    from natnet import DataFrame, NatNetClient

    numbers: list[int] = []

    def take(frame: DataFrame) -> None:
        numbers.append(frame.prefix.frame_number)

    own = host.rpartition(".")[0] + ".9"
    client = NatNetClient(server_ip_address=host, local_ip_address=own, command_port=PORT, use_multicast=False)
    client.on_data_frame_received_event.handlers.append(take)
    client.connect(timeout=5.0)
    client.run_async()
    cores = _measure(float(seconds))
    client.shutdown()
    _tell(numbers, cores)


def _measure(seconds: float) -> float:
    """Let pass what is measured, and return how many cores this process used meanwhile."""
    time.sleep(WARM_UP_S)
    began_s = time.process_time()
    time.sleep(seconds)
    return (time.process_time() - began_s) / seconds


def _tell(numbers: list[int], cores: float) -> None:
    lost = max(numbers) - min(numbers) + 1 - len(set(numbers))
    print(json.dumps({"received": len(numbers), "lost": lost, "cores": cores}))


if __name__ == "__main__":
    main()
