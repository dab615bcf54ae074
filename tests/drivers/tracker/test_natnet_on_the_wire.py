"""What Wireshark sees of a short session on the loopback network."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import struct
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from natnet_recorder import PATIENCE_S, Recorder, connected
from natnet_scripted import make_packet, scripted_tracker
from test_natnet_multicast import free_port

from bench.drivers.tracker.natnet.wire import Message
from bench.model import ClockSample

TOOLS_MISSING = [tool for tool in ("tshark", "dumpcap") if shutil.which(tool) is None]
pytestmark = [
    pytest.mark.skipif(bool(TOOLS_MISSING), reason=f"not installed: {', '.join(TOOLS_MISSING)}"),
    pytest.mark.skipif(os.geteuid() != 0, reason="only root may listen to the loopback network"),
]
HOST = "127.0.32.51"


@contextmanager
def captured(path: Path) -> Iterator[None]:
    """Write what passes on the loopback network to a file."""
    command = ["dumpcap", "-q", "-i", "lo", "-f", "udp", "-w", str(path)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as listener:
        try:
            wait_until_written(path, b"the session begins")
            yield
            wait_until_written(path, b"the session has ended")
        finally:
            listener.send_signal(signal.SIGINT)


def wait_until_written(path: Path, mark: bytes) -> None:
    """Send a mark until the capture has it: then it listens, and has written all that was sent before."""
    deadline = time.monotonic() + PATIENCE_S
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        while not (path.exists() and mark in path.read_bytes()):
            assert time.monotonic() < deadline
            sender.sendto(mark, (HOST, 9))
            time.sleep(0.02)


def dissect(path: Path, *options: str) -> list[list[str]]:
    done = subprocess.run(["tshark", "-r", str(path), *options], capture_output=True, text=True, check=True)
    return [line.split("\t") for line in done.stdout.splitlines()]


@pytest.mark.parametrize("is_multicast", [False, True])
def test_nothing_of_a_session_is_malformed_and_every_packet_announces_its_size(
    tmp_path: Path, is_multicast: bool
) -> None:
    path, recorder = tmp_path / "session.pcapng", Recorder()
    with captured(path), scripted_tracker(HOST) as tracker:
        tracker.info = replace(tracker.info, is_multicast=is_multicast, data_port=free_port())
        with connected(tracker, recorder):
            for number in range(100, 120):
                (tracker.send_to_group if is_multicast else tracker.send)(make_packet(number))
            recorder.wait_for_frame(119)
            recorder.wait_for(lambda record: isinstance(record, ClockSample))
    ours = f"ip.addr == {HOST}"  # other tests may run beside this one
    assert dissect(path, "-Y", f"({ours}) && (_ws.malformed || _ws.short)") == []
    fields = dissect(path, "-Y", ours, "-T", "fields", "-e", "udp.length", "-e", "udp.payload")
    seen = set()
    for length, payload in fields:
        packet = bytes.fromhex(payload)
        if packet.startswith(b"the session"):
            continue
        message, announced = struct.unpack_from("<HH", packet)
        assert int(length) == 8 + len(packet) == 8 + 4 + announced
        seen.add(message)
    assert {Message.CONNECT, Message.SERVERINFO, Message.FRAMEOFDATA, Message.ECHOREQUEST} <= seen
