"""Our NatNet client beside the one from PyPI, and what is made of the tracker's time stamps."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from natnet import DataFrame, PacketBuffer
from natnet import Version as PeerVersion

from bench.analysis import align_by_echo
from bench.drivers.tracker.natnet.frame import LABELED, decode_frame, encode_frame
from bench.drivers.tracker.natnet.wire import HEADER, Message, Version
from bench.simulation.device_clock import DeviceClock
from bench.timing import RunClock
from benchmarks.table import Row, ratio_row
from benchmarks.tracker_processes import HZ, N_MARKERS, TICKS_AT_START, TICKS_PER_S

PROCESSES = Path(__file__).with_name("tracker_processes.py")
RECORDED = Path(__file__).resolve().parents[2] / "tests" / "drivers" / "tracker" / "data" / "natnet" / "traffic.pcapng"
HOST = "127.0.66.1"
PPM = 42.0
SECONDS, FULL_SECONDS = 10.0, 60.0
SD_LIMIT_US = 100.0
CPU_LIMIT, DECODING_LIMIT = 1 / 3, 10.0
ROUNDS = 40
"""Rounds of decoding, ours and the peer's in turn; a noisy machine slows both, and the quickest of each count."""


def measure_tracker_link(full: bool) -> list[Row]:
    """Receive 360 frames a second of 50 markers, by ours and by the peer, and map ours to host time."""
    seconds = FULL_SECONDS if full else SECONDS
    with tempfile.TemporaryDirectory(prefix="bench-tracker-") as name, _tracker() as (clock, tracker_clock):
        output = Path(name) / "ours.npz"
        ours = _read("ours", clock, seconds, output)
        peer = _read("peer", clock, seconds, output)
        stream = dict(np.load(output))
    return [*_rate_clients(ours, peer, seconds), *_rate_clocks(tracker_clock, stream), *measure_decoding()]


@contextmanager
def _tracker() -> Iterator[tuple[RunClock, DeviceClock]]:
    clock = RunClock.start()
    started_ns = clock.now_ns()
    command = [sys.executable, PROCESSES, "tracker", HOST, clock.to_text(), started_ns, PPM]
    process = subprocess.Popen(
        [str(word) for word in command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        if process.stdout is None or process.stdout.readline().strip() != "ready":
            raise RuntimeError("the simulated tracker did not start")
        yield clock, DeviceClock(started_ns, TICKS_AT_START, TICKS_PER_S, PPM)
    finally:
        told, _ = process.communicate(timeout=30)
    if json.loads(told)["unsent"]:
        raise RuntimeError(f"the simulated tracker could not send every frame: {told}")


def _read(role: str, clock: RunClock, seconds: float, output: Path) -> dict[str, float]:
    command = [sys.executable, PROCESSES, role, HOST, clock.to_text(), seconds, output]
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=True)
    words: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return words


def _rate_clients(ours: dict[str, float], peer: dict[str, float], seconds: float) -> list[Row]:
    what = f"tracker, {HZ:g} frames/s of {N_MARKERS} markers, {seconds:g} s: "
    lost, peers = (f"{one['lost']:.0f} of {one['received'] + one['lost']:.0f}" for one in (ours, peer))
    return [
        Row(what + "frames lost", lost, f"{peers} (natnet 0.3.0)", "limit 0"),
        ratio_row(what + f"client's CPU, cores (limit {CPU_LIMIT:.2g})", ours["cores"], peer["cores"], "natnet 0.3.0"),
    ]


def _rate_clocks(clock: DeviceClock, stream: dict[str, Any]) -> list[Row]:
    """Compare the maps known online and in the report with the true time of each exposure."""
    _, ticks, arrival_ns, online_ns = stream["frames"].T
    send_ns, sample_ticks, receive_ns = stream["samples"].T
    segment, sample_segment = np.zeros(len(ticks), dtype=np.int64), np.zeros(len(send_ns), dtype=np.int64)
    mapped = align_by_echo(
        ticks, online_ns, segment, sample_segment, send_ns, sample_ticks, receive_ns, 1e9 / TICKS_PER_S
    )
    true_ns = np.array([clock.host_ns_at(int(tick)) for tick in ticks])
    asked = ticks >= sample_ticks[min(8, len(sample_ticks) - 1)]  # two seconds, after which the slope is known
    rows = []
    for name, host_ns in (("in the report", mapped.host_ns), ("online", online_ns)):
        mean_us, sd_us = _error_us((host_ns - true_ns)[asked])
        what = f"tracker clock {name}, {PPM:g} ppm: error of capture times ± sd, µs"
        rows.append(
            Row(what, f"{mean_us:.0f} ± {sd_us:.1f}", f"± {SD_LIMIT_US:g} (limit)", f"sd {sd_us / SD_LIMIT_US:.2g}")
        )
    mean_us, sd_us = _error_us(arrival_ns - true_ns)
    rows.append(Row("tracker clock, arrival taken for capture, µs", "-", f"{mean_us:.0f} ± {sd_us:.0f} (raw)", "-"))
    return rows


def _error_us(error_ns: Any) -> tuple[float, float]:
    error = error_ns.astype(float) * 1e-3
    return float(error.mean()), float(error.std())


def measure_decoding() -> list[Row]:
    """Decode recorded frames of a real tracker, and frames of 50 markers, against the client from PyPI."""
    recorded = _recorded_frames()
    frame = decode_frame(recorded[0], (3, 0))
    many = np.resize(frame.labeled, N_MARKERS).astype(LABELED)
    large = encode_frame(replace(frame, labeled=many), (4, 1))[HEADER.size :]
    return [
        _compare_decoders(f"NatNet, the {len(recorded)} recorded frames", recorded, (3, 0)),
        _compare_decoders(f"NatNet, frames of {N_MARKERS} markers", [large] * len(recorded), (4, 1)),
    ]


def _compare_decoders(what: str, payloads: list[bytes], version: Version) -> Row:
    peer_version = PeerVersion(*version)
    ours = peer = 0.0
    for _ in range(ROUNDS):
        ours = max(ours, _rate(payloads, lambda payload: decode_frame(payload, version)))
        peer = max(
            peer, _rate(payloads, lambda payload: DataFrame.read_from_buffer(PacketBuffer(payload), peer_version))
        )
    return ratio_row(f"{what}: decoded/s (limit {DECODING_LIMIT:g} times)", ours, peer, "natnet 0.3.0")


def _rate(payloads: list[bytes], decode: Callable[[bytes], object]) -> float:
    began_s = time.process_time()
    for payload in payloads:
        decode(payload)
    return len(payloads) / (time.process_time() - began_s)


def _recorded_frames() -> list[bytes]:
    """Return the payloads of the frames in the capture: UDP in Ethernet in enhanced packet blocks of pcapng."""
    raw, found, offset = RECORDED.read_bytes(), [], 0
    while offset < len(raw):
        kind, size = struct.unpack_from("<II", raw, offset)
        if kind == 6:
            captured = struct.unpack_from("<I", raw, offset + 20)[0]
            packet = raw[offset + 28 + 14 + 20 + 8 : offset + 28 + captured]
            message, n_bytes = HEADER.unpack_from(packet)
            if message == Message.FRAMEOFDATA:
                found.append(packet[HEADER.size : HEADER.size + n_bytes])
        offset += size
    return found
