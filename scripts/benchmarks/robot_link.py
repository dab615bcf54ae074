"""Our reader of the robot's state beside ur_rtde's recorder, and what is made of its time stamps."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis import (
    CounterColumns,
    RobotSigns,
    align_by_arrival,
    count_cycles,
    find_cycles,
    make_cycle_source,
    refine_starts,
)
from bench.config import CycleConfig
from bench.simulation.device_clock import DeviceClock
from bench.timing import RunClock
from benchmarks.table import Row, ratio_row

PROCESSES = Path(__file__).with_name("robot_processes.py")
HOST = "127.0.65.1"
HZ = 500.0
PPM = 30.0
BIAS_LIMIT_US, SD_LIMIT_US = 300.0, 50.0
SECONDS, FULL_SECONDS = 20.0, 300.0
PERIOD_NS = 1e9 / HZ


def measure_robot_link(full: bool) -> list[Row]:
    """Read idle; then beside a busy thread with the stream held 40 ms each second, by ours and by the peer."""
    seconds = FULL_SECONDS if full else SECONDS
    with tempfile.TemporaryDirectory(prefix="bench-robot-") as name:
        folder = Path(name)
        with _controller(bursts=False) as device:
            _, idle = _read("ours", device, SECONDS, busy=False, output=folder / "idle.npz")
        with _controller(bursts=True) as device:
            ours, load = _read("ours", device, seconds, busy=True, output=folder / "load.npz")
            peer = _read_peer(device, seconds, folder / "peer.csv")
        rows = _rate_readers(ours, peer, seconds)
        for condition, (clock, stream) in {"idle": (idle[0], idle[1]), "busy, bursts": (load[0], load[1])}.items():
            rows += _rate_clocks(condition, clock, stream)
            rows.append(_rate_starts(condition, clock, stream))
    return rows


@contextmanager
def _controller(bursts: bool) -> Iterator[tuple[RunClock, DeviceClock]]:
    clock = RunClock.start()
    started_ns = clock.now_ns()
    command = [sys.executable, PROCESSES, "controller", HOST, clock.to_text(), started_ns, PPM, int(bursts)]
    process = subprocess.Popen(
        [str(word) for word in command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        if process.stdout is None or process.stdout.readline().strip() != "ready":
            raise RuntimeError("the simulated controller did not start")
        yield clock, DeviceClock(started_ns, round(61.25e9), 1e9, PPM)
    finally:
        process.communicate(timeout=30)


def _read(role: str, device: tuple[RunClock, DeviceClock], seconds: float, *, busy: bool, output: Path) -> Any:
    """Return the reader's own words, and with them what ours recorded with the true clock."""
    clock, controller_clock = device
    command = [sys.executable, PROCESSES, role, HOST, clock.to_text(), seconds, int(busy), output]
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=True)
    words = json.loads(done.stdout.splitlines()[-1])
    return words, (controller_clock, dict(np.load(output))) if role == "ours" else None


def _read_peer(device: tuple[RunClock, DeviceClock], seconds: float, output: Path) -> dict[str, float] | None:
    if importlib.util.find_spec("rtde_receive") is None:
        return None
    words: dict[str, float] = _read("peer", device, seconds, busy=True, output=output)[0]
    return words


def _rate_readers(ours: dict[str, float], peer: dict[str, float] | None, seconds: float) -> list[Row]:
    what = f"robot at 500 Hz, {seconds:g} s beside a busy thread, 40 ms bursts: "
    lost = f"{ours['lost']:.0f} of {ours['expected']:.0f}"
    if peer is None:
        return [Row(what + "packages lost", lost, "ur_rtde is not installed", "-")]
    peers = f"{peer['lost']:.0f} of {peer['expected']:.0f} (ur_rtde recording)"
    share = f"{peer['lost'] / peer['expected']:.1%} lost by the peer"
    return [
        Row(what + "packages lost", lost, peers, share),
        ratio_row(what + "reader's CPU, cores", ours["cores"], peer["cores"], "ur_rtde recording"),
    ]


def _rate_clocks(condition: str, clock: DeviceClock, stream: dict[str, Any]) -> list[Row]:
    """Compare the map of the report with what is done elsewhere, by the true time of each sample."""
    ticks, arrival = np.rint(stream["controller_time_s"] * 1e9).astype(np.int64), stream["arrival_ns"]
    true = _true_ns(clock, ticks)
    segment = np.zeros(len(ticks), dtype=np.int64)
    hull = align_by_arrival(ticks, arrival, arrival, segment, 1.0).host_ns
    woken = stream["woken_ns"]  # as everybody else stamps
    base = woken[0] + ticks - ticks[0]
    x, late = (ticks - ticks[0]).astype(float), (woken - base).astype(float)
    line = np.polyval(np.polyfit(x, late, 1), x)
    peers = {
        "the program's own stamps": align_by_arrival(ticks, woken, woken, segment, 1.0).host_ns,
        "raw arrival": woken,
        "least squares": base + line,
        "one offset": base + late.min(),
    }
    ours = _error_us(hull, true)
    rows = [
        Row(
            f"robot clock, {condition}, {PPM:g} ppm: bias ± sd, µs",
            _pm(ours),
            f"{BIAS_LIMIT_US:g} ± {SD_LIMIT_US:g} (limit)",
            f"sd {ours[1] / SD_LIMIT_US:.2g}",
        )
    ]
    for name, mapped in peers.items():
        theirs = _error_us(mapped, true)
        ratio = f"sd {ours[1] / theirs[1]:.2g}"
        rows.append(Row(f"robot clock, {condition}, against {name}", _pm(ours), f"{_pm(theirs)} ({name})", ratio))
    return rows


def _rate_starts(condition: str, clock: DeviceClock, stream: dict[str, Any]) -> Row:
    """Find the cycles by the joints alone; the true start is the tick in which the program says that it begins."""
    ticks = np.rint(stream["controller_time_s"] * 1e9).astype(np.int64)
    host = align_by_arrival(ticks, stream["arrival_ns"], stream["arrival_ns"], 0 * ticks, 1.0).host_ns
    source = make_cycle_source(CycleConfig(source="joint_return"))
    if source is None:
        raise RuntimeError("the joints are a source of cycles")
    signs = RobotSigns(stream["digital_outputs"].astype(np.int64), stream["q_rad"], stream["qd_rad_s"])
    first = int(np.flatnonzero(stream["cycle_running"] == 0)[0])  # the recording begins on the path
    part = slice(first, None)
    signs = RobotSigns(signs.digital_outputs[part], signs.q_rad[part], signs.qd_rad_s[part])
    runtime = stream["runtime_state"][part].astype(np.int64)
    count, running = count_cycles(source, runtime, signs)
    shown = CounterColumns(host[part], count, running, np.full(len(count), np.nan), runtime)
    table, _ = refine_starts(find_cycles(shown), host[part], np.abs(signs.qd_rad_s).max(axis=1))
    marks = stream["cycle_running"][part]
    true = _true_ns(clock, ticks[part][np.flatnonzero(np.diff(marks) == 1) + 1])
    n = min(len(true), len(table.start_ns))
    error = np.abs(table.start_ns[:n] - true[:n]) / PERIOD_NS
    what = f"cycle start by the joints, {condition}: largest error of {n}, periods of 2 ms"
    return ratio_row(what, float(error.max()), 1.0, "limit")


def _true_ns(clock: DeviceClock, ticks: Any) -> Any:
    elapsed = (ticks - clock.ticks_origin) / (1.0 + clock.drift_ppm * 1e-6)
    return clock.host_origin_ns + np.rint(elapsed).astype(np.int64)


def _error_us(mapped: Any, true: Any) -> tuple[float, float]:
    error = (mapped - true).astype(float) * 1e-3
    return float(error.mean()), float(error.std())


def _pm(error: tuple[float, float]) -> str:
    return f"{error[0]:.0f} ± {error[1]:.0f}"
