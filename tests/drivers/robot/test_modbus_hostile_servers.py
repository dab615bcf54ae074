"""Servers that are no Modbus servers, or bad ones: one clear sentence within the limits, no hang, nothing left open."""

from __future__ import annotations

import os
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import psutil
import pytest
from modbus_bench import make_config

from bench.config import ModbusRobotConfig
from bench.drivers.robot.modbus import ModbusProgram, ModbusSignalWatch, ModbusStateStream
from bench.errors import ConnectError, DeviceError
from bench.timing import RunClock

Answer = Callable[[socket.socket, bytes], None]
QUICK = ("unit_id = 1", "unit_id = 1\ntimeout_s = 0.1\nretries = 0")


def frame(
    request: bytes, *, tid: int | None = None, unit: int | None = None, pdu: bytes = b"", protocol: int = 0
) -> bytes:
    """Return an answer to a request, right but for what is told to be wrong."""
    (number,) = struct.unpack(">H", request[:2])
    body = pdu or right_pdu(request)
    head = (number if tid is None else tid, protocol, len(body) + 1, request[6] if unit is None else unit)
    return struct.pack(">HHHB", *head) + body


def right_pdu(request: bytes) -> bytes:
    function, _, count = struct.unpack(">BHH", request[7:12])
    n_bytes = (count + 7) // 8 if function in (1, 2) else 2 * count
    return bytes([function, n_bytes]) + bytes(n_bytes)


def flood(link: socket.socket, request: bytes) -> None:
    """Send answers to other questions for as long as somebody reads."""
    while True:
        link.sendall(frame(request, tid=7) * 200)


def dribble(link: socket.socket, request: bytes) -> None:
    """Send a frame that never ends, byte by byte."""
    link.sendall(request[:4] + b"\xff\xff")
    stop = threading.Event()
    while not stop.wait(0.01):
        link.sendall(b"\x01")


def close_at_once(link: socket.socket, _request: bytes) -> None:
    link.close()


def sends(make: Callable[[bytes], bytes]) -> Answer:
    return lambda link, request: link.sendall(make(request))


SERVERS: dict[str, tuple[Answer, str]] = {
    "garbage": (sends(lambda _request: bytes(range(255, 155, -1))), "did not answer within 0.1 s"),
    "an oversize frame": (
        sends(lambda request: request[:4] + b"\xff\xff" + bytes(70_000)),
        "not understood|did not answer",
    ),
    "silence": (lambda _link, _request: None, r"did not answer within 0.1 s \(reading"),
    "a close": (close_at_once, "broke while reading"),
    "another transaction": (sends(lambda request: frame(request, tid=999)), "did not answer within 0.1 s"),
    "another unit": (sends(lambda request: frame(request, unit=77)), "did not answer within 0.1 s"),
    "another protocol": (sends(lambda request: frame(request, protocol=9)), "did not answer within 0.1 s"),
    "a byte count too large": (
        sends(lambda request: frame(request, pdu=request[7:8] + b"\xc8\x00\x00")),
        "not understood|did not answer",
    ),
    "a byte count too small": (sends(lambda request: frame(request, pdu=request[7:8] + b"\x00")), "0 values came for"),
    "nothing after the function": (sends(lambda request: frame(request, pdu=request[7:8])), "not understood"),
    "another function": (sends(lambda request: frame(request, pdu=b"\x05\x00\x02\xff\x00")), "answers function 5 to"),
    "a function that does not exist": (
        sends(lambda request: frame(request, pdu=b"\x63\x00")),
        "did not answer|not understood",
    ),
    "an exception without a code": (
        sends(lambda request: frame(request, pdu=b"\x84")),
        "not understood|did not answer",
    ),
    "a flood": (flood, "did not answer within 0.1 s"),
    "bytes one by one": (dribble, "did not answer within 0.1 s"),
}


@contextmanager
def serving(answer: Answer) -> Iterator[ModbusRobotConfig]:
    """Serve any number of clients on an address of its own, each in a thread that ends with its client."""
    config = make_config(QUICK)
    threads: list[threading.Thread] = []

    def serve(link: socket.socket) -> None:
        with link, suppress(OSError):
            while request := link.recv(260):
                answer(link, request)

    def accept(server: socket.socket) -> None:
        with suppress(OSError):
            while True:
                threads.append(threading.Thread(target=serve, args=(server.accept()[0],)))
                threads[-1].start()

    with socket.create_server((config.host, config.port)) as server:
        acceptor = threading.Thread(target=accept, args=(server,))
        acceptor.start()
        try:
            yield config
        finally:
            server.shutdown(socket.SHUT_RDWR)
            acceptor.join()
            for thread in threads:
                thread.join()


@pytest.mark.parametrize("what", SERVERS)
def test_each_role_says_what_is_wrong_and_leaves_nothing_open(what: str) -> None:
    answer, words = SERVERS[what]
    n_open = psutil.Process(os.getpid()).num_fds()
    with serving(answer) as config:
        stream = ModbusStateStream(config, RunClock.start())
        with pytest.raises(DeviceError, match=words):
            stream.open(lambda _record: None)
        stream.close()
        program = ModbusProgram(config, RunClock.start())
        program.open()
        (sentence,) = program.check("x")
        assert f"Modbus controller {config.host}:{config.port}" in sentence
        program.close()
        watch = ModbusSignalWatch(config, RunClock.start())
        watch.open()
        with pytest.raises(DeviceError):
            watch.read()
        watch.close()
    assert psutil.Process(os.getpid()).num_fds() <= n_open


def test_a_server_that_never_accepts_is_one_sentence() -> None:
    config = make_config(QUICK)
    with socket.create_server((config.host, config.port), backlog=0) as server:
        fillers = []
        try:
            for _ in range(3):  # the queue of an idle server is full after them
                fillers.append(socket.socket())
                fillers[-1].setblocking(False)
                fillers[-1].connect_ex(server.getsockname())
            with pytest.raises((ConnectError, DeviceError), match=r"cannot be reached within 0.1 s|did not answer"):
                ModbusStateStream(config, RunClock.start()).open(lambda _record: None)
        finally:
            for filler in fillers:
                filler.close()


def test_a_write_that_another_register_confirms_is_not_taken_for_done() -> None:
    def confirm_another(link: socket.socket, request: bytes) -> None:
        if request[7] in (5, 6, 15, 16):
            link.sendall(frame(request, pdu=request[7:8] + b"\x00\x63" + request[10:12]))
        else:
            link.sendall(frame(request))

    with serving(confirm_another) as config:
        stream = ModbusStateStream(config, RunClock.start())
        with pytest.raises(DeviceError, match="writing holding 0: it says that it wrote 99"):
            stream.open(lambda _record: None)
        stream.close()
