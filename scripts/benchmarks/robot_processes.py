"""The processes of the robot benchmark: a simulated controller, our reader, and ur_rtde's recorder.

robot_processes.py controller HOST CLOCK STARTED_NS PPM BURSTS
robot_processes.py ours|peer HOST CLOCK SECONDS BUSY OUTPUT
"""

from __future__ import annotations

import json
import sys
import threading
import time
from pathlib import Path

import numpy as np

HZ = 500.0
BURST_S = 0.04
BURST_PERIOD_NS = 1_000_000_000
BUSY_S, IDLE_S = 0.005, 0.001
"""A thread that computes like a curvature is drawn: 5 ms of Python, then a breath."""
TIMESTAMP_AT_START = 61.25e9


def main() -> None:
    role, host, *rest = sys.argv[1:]
    {"controller": serve, "ours": read_ours, "peer": read_peer}[role](host, *rest)


def serve(host: str, clock_text: str, started_ns: str, ppm: str, bursts: str) -> None:
    """Stream at 500 Hz and drive path after path, until stdin closes; hold the stream 40 ms each second if asked."""
    from bench.simulation.device_clock import DeviceClock
    from bench.simulation.program import PathProgram
    from bench.simulation.scheduler import Scheduler
    from bench.simulation.ur import UrController
    from bench.timing import RunClock

    clock = RunClock.from_text(clock_text)
    scheduler = Scheduler(clock)
    program = PathProgram(cycle_s=1.0, rest_s=0.05)
    controller_clock = DeviceClock(int(started_ns), round(TIMESTAMP_AT_START), 1e9, float(ppm))
    controller = UrController(
        host, program, scheduler, clock, controller_clock=controller_clock, rate_hz=HZ, grant_register=None
    )
    controller.open()
    controller.machine.loaded = True
    program.play()

    def burst(due_ns: int) -> None:
        controller.faults.burst(BURST_S)
        scheduler.call_at(due_ns + BURST_PERIOD_NS, burst)

    if int(bursts):
        scheduler.call_at(clock.now_ns() + BURST_PERIOD_NS, burst)
    threading.Thread(target=lambda: (sys.stdin.read(), scheduler.stop()), daemon=True).start()
    print("ready", flush=True)
    scheduler.run()
    controller.close()


class Load:
    """A busy Python thread beside the reader, and what it costs, so that the reader's own cost is known."""

    def __init__(self, busy: bool) -> None:
        self.cpu_s = 0.0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._compute, daemon=True)
        self._began_s = time.process_time()
        if busy:
            self._thread.start()

    def stop(self) -> float:
        """Return the CPU time of this process without the load's."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        return time.process_time() - self._began_s - self.cpu_s

    def _compute(self) -> None:
        while not self._stopping.is_set():
            until = time.perf_counter() + BUSY_S
            while time.perf_counter() < until:
                sum(k * k for k in range(200))
            time.sleep(IDLE_S)
        self.cpu_s = time.thread_time()


def stamp_twice() -> dict[int, int]:
    """Make our reader note when the program was woken, by the stamp that it gives; where that is the kernel's."""
    from bench.drivers.receive import KERNEL, StampedSocket
    from bench.drivers.robot.ur import link

    woken: dict[int, int] = {}

    class TwiceStamped(StampedSocket):
        def receive(self) -> tuple[bytes, object, int]:
            data, sender, arrival_ns = super().receive()
            if self.stamped_by == KERNEL:
                woken[arrival_ns] = self._clock.now_ns()
            return data, sender, arrival_ns

    link.StampedSocket = TwiceStamped
    return woken


def read_ours(host: str, clock_text: str, seconds: str, busy: str, output: str) -> None:
    from bench.config import RobotConfig
    from bench.drivers.robot.ur.state import UrStateStream
    from bench.model import Record, RobotState
    from bench.timing import RunClock

    states: list[RobotState] = []

    def keep(record: Record) -> None:
        if isinstance(record, RobotState):
            states.append(record)

    woken = stamp_twice()
    stream = UrStateStream(RobotConfig(host=host, program="bend_test.urp", rate_hz=HZ), RunClock.from_text(clock_text))
    load = Load(busy == "1")
    stream.open(keep)
    time.sleep(float(seconds))
    stream.close()
    cpu_s = load.stop()
    names = ("arrival_ns", "controller_time_s", "cycle_count", "cycle_running", "runtime_state", "digital_outputs")
    columns = {name: np.array([getattr(state, name) for state in states]) for name in names}
    joints = {name: np.array([getattr(state, name) for state in states]) for name in ("q_rad", "qd_rad_s")}
    columns["woken_ns"] = np.array([woken.get(state.arrival_ns, state.arrival_ns) for state in states])
    np.savez(output, **columns, **joints)
    _tell(columns["controller_time_s"], cpu_s)


def read_peer(host: str, _clock: str, seconds: str, busy: str, output: str) -> None:
    from rtde_receive import RTDEReceiveInterface

    names = ["timestamp", "actual_q", "actual_qd", "runtime_state", "actual_digital_output_bits"]
    load = Load(busy == "1")
    receiver = RTDEReceiveInterface(host, HZ, names)
    receiver.startFileRecording(output, names)
    time.sleep(float(seconds))
    receiver.stopFileRecording()
    receiver.disconnect()
    cpu_s = load.stop()
    lines = Path(output).read_text(encoding="utf-8").splitlines()
    _tell(np.array([float(line.split(",")[0]) for line in lines[1:] if line]), cpu_s)


def _tell(time_s: np.ndarray, cpu_s: float) -> None:
    expected = round(float(time_s.max() - time_s.min()) * HZ) + 1
    kept = len(np.unique(np.rint(time_s * HZ).astype(np.int64)))
    span_s = float(time_s.max() - time_s.min())
    print(json.dumps({"expected": expected, "lost": expected - kept, "cores": cpu_s / span_s}), flush=True)


if __name__ == "__main__":
    main()
