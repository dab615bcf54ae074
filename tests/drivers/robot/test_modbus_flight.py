"""The bytes that a Modbus controller sent last are kept when its link ends badly."""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from pathlib import Path

import pytest
from modbus_bench import make_config, rig, wait_until

from bench.drivers.flight import FlightRecorder
from bench.drivers.robot.modbus import ModbusStateStream
from bench.errors import DeviceTimeoutError, LinkLostError, ProtocolError
from bench.timing import RunClock

GARBAGE = b"HTTP/1.1 400 Bad Request\r\n\r\n"


def test_a_lost_controller_leaves_the_last_questions_and_answers(tmp_path: Path) -> None:
    lost: list[LinkLostError] = []
    with rig() as bench:
        flight = FlightRecorder("robot", bench.clock, tmp_path / "run-1")
        states: list[object] = []
        stream = ModbusStateStream(bench.config, bench.clock, on_lost=lost.append, silence_s=0.2, flight=flight)
        stream.open(states.append)
        wait_until(lambda: len(states) > 3, "a few states")
        bench.controller.close()
        wait_until(lambda: lost, "the loss")
        stream.close()
    (path,) = tmp_path.iterdir()
    assert str(lost[0]).endswith(f"The last 20 packets of the link are in {path}.")
    packets = [line.split(" ") for line in path.read_text(encoding="utf-8").splitlines()[2:]]
    assert {direction for _, direction, _ in packets} == {"<", ">"}
    assert all(bytes.fromhex(data)[2:4] == b"\0\0" for _, _, data in packets), "each begins as Modbus TCP does"


def test_bytes_that_are_no_modbus_are_kept(tmp_path: Path) -> None:
    config = make_config(("unit_id = 1", "unit_id = 1\ntimeout_s = 0.1\nretries = 0"))
    clock = RunClock.start()
    with socket.create_server((config.host, config.port)) as server:
        thread = threading.Thread(target=_answer_all, args=(server,), daemon=True)
        thread.start()
        stream = ModbusStateStream(config, clock, flight=FlightRecorder("robot", clock, tmp_path / "run-1"))
        with pytest.raises((DeviceTimeoutError, LinkLostError, ProtocolError)) as caught:
            stream.open(lambda _record: None)
        server.shutdown(socket.SHUT_RDWR)
        thread.join()
    (path,) = tmp_path.iterdir()
    assert str(path) in caught.value.hint
    assert f" < {GARBAGE.hex()}" in path.read_text(encoding="utf-8")


def _answer_all(server: socket.socket) -> None:
    with suppress(OSError):
        while True:
            connection, _ = server.accept()
            with connection, suppress(OSError):
                connection.recv(300)
                connection.sendall(GARBAGE)
                connection.recv(300)
