from __future__ import annotations

import socket
import struct
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.drivers.receive import KERNEL, PROGRAM, StampedSocket
from bench.timing import RunClock

OPTION = 35
UTC_NS = 1_700_000_000_000_000_000
MS = 1_000_000
on_linux = pytest.mark.skipif(sys.platform != "linux", reason="only Linux stamps what arrives")


class Machine:
    """A computer's two clocks and a socket whose packets come when the test says; the kernel stamps by UTC."""

    def __init__(self, speed=1.0, refuses=False):
        self.monotonic_ns = 0
        self.utc_offset_ns = UTC_NS
        self.speed = speed
        self.waiting = []
        self.is_stamping = False
        self._refuses = refuses

    def now_ns(self):
        return round(self.monotonic_ns * self.speed)

    def utc_ns(self):
        return self.monotonic_ns + self.utc_offset_ns

    def arrive(self, data, stamped=True):
        """Return the true host time."""
        self.waiting.append((data, self.utc_ns() if stamped else None))
        return self.now_ns()

    def setsockopt(self, level, option, value):
        if self._refuses:
            raise OSError("no such option")
        self.is_stamping = (level, option, value) == (socket.SOL_SOCKET, OPTION, 1)

    def recvmsg(self, largest, _ancillary):
        data, stamp_ns = self.waiting.pop(0)
        notes = [(socket.SOL_SOCKET, 1, b"another note")]
        if stamp_ns is not None and self.is_stamping:
            notes.append((socket.SOL_SOCKET, OPTION, struct.pack("@ll", *divmod(stamp_ns, 10**9))))
        return data[:largest], notes, 0, ("192.0.2.1", 1510)

    def recvfrom(self, largest):
        data, _ = self.waiting.pop(0)
        return data[:largest], ("192.0.2.1", 1510)


def receiver(machine, option=OPTION):
    return StampedSocket(machine, machine, 2048, option=option, utc_ns=machine.utc_ns)


@pytest.mark.parametrize("speed", [1.0, 20.0])
def test_the_kernels_stamp_is_when_it_came_however_late_it_is_read(speed):
    machine = Machine(speed)
    stamped = receiver(machine)
    machine.monotonic_ns += 2 * MS
    came_ns = machine.arrive(b"one")
    machine.monotonic_ns += 40 * MS
    assert stamped.receive() == (b"one", ("192.0.2.1", 1510), came_ns)
    assert (stamped.stamped_by, stamped.n_reads, stamped.n_unstamped) == (KERNEL, 1, 0)
    assert stamped.remark() == ""


@pytest.mark.parametrize(("option", "refuses"), [(None, False), (OPTION, True)])
def test_without_kernel_stamps_the_program_stamps_and_says_nothing(option, refuses):
    machine = Machine(refuses=refuses)
    stamped = receiver(machine, option)
    machine.arrive(b"one")
    machine.monotonic_ns += 40 * MS
    assert stamped.receive() == (b"one", ("192.0.2.1", 1510), machine.now_ns())
    assert (stamped.stamped_by, stamped.remark()) == (PROGRAM, "")


def test_a_socket_that_cannot_tell_notes_is_stamped_by_the_program():
    class Plain:
        recvfrom = staticmethod(lambda _largest: (b"one", None))

    machine = Machine()
    assert StampedSocket(Plain(), machine, 99, option=OPTION).stamped_by == PROGRAM


def test_a_read_without_a_stamp_has_the_programs_and_is_counted():
    machine = Machine()
    stamped = receiver(machine)
    for stamp in (True, False):
        machine.arrive(b"one", stamp)
    machine.monotonic_ns += 3 * MS
    assert stamped.receive()[2] == 0
    assert stamped.receive()[2] == machine.now_ns()
    assert (stamped.n_unstamped, stamped.remark()) == (1, "")
    for _ in range(30):
        machine.arrive(b"one", stamped=False)
        stamped.receive()
    assert stamped.remark().startswith("31 of 32 reads had no stamp")


@given(
    step_ns=st.integers(-5_000 * MS, 5_000 * MS).filter(lambda step: abs(step) > 2 * MS),
    waits_ms=st.lists(st.integers(0, 400), min_size=1, max_size=6),
)
def test_a_step_of_utc_puts_no_arrival_before_the_truth(step_ns, waits_ms):
    machine = Machine()
    stamped = receiver(machine)
    true_ns = []
    for wait_ms in waits_ms:  # they come one after the other, and none is read yet
        machine.monotonic_ns += wait_ms * MS
        true_ns.append(machine.arrive(b"x"))
    machine.utc_offset_ns += step_ns
    for came_ns in true_ns:
        machine.monotonic_ns += MS // 10
        assert came_ns <= stamped.receive()[2] <= machine.now_ns()
    machine.monotonic_ns += MS
    last_ns = machine.arrive(b"x")
    machine.monotonic_ns += 7 * MS
    late_ns = stamped.receive()[2] - last_ns
    assert late_ns == 0, "once the step is over the kernel's stamps hold again"


@given(waits=st.lists(st.tuples(st.integers(0, 30), st.booleans(), st.booleans()), max_size=20))
def test_arrivals_are_in_order_and_never_before_the_truth(waits):
    machine = Machine()
    stamped = receiver(machine)
    true_ns, found_ns = [], []
    for wait_ms, has_stamp, is_read in waits:
        machine.monotonic_ns += wait_ms * MS
        true_ns.append(machine.arrive(b"x", has_stamp))
        while is_read and machine.waiting:
            found_ns.append(stamped.receive()[2])
    assert found_ns == sorted(found_ns)
    assert all(true <= found <= machine.now_ns() for true, found in zip(true_ns, found_ns, strict=False))


@on_linux
@pytest.mark.parametrize("kind", [socket.SOCK_STREAM, socket.SOCK_DGRAM])
def test_real_sockets_give_stamps_between_sending_and_receiving(kind):
    clock = RunClock.start()
    ours, theirs = _pair(kind)
    with ours, theirs:
        stamped = StampedSocket(ours, clock, 2048)
        assert stamped.stamped_by == KERNEL
        while stamped.n_reads - stamped.n_unstamped < 20:  # the kernel takes a while to begin
            before_ns = clock.now_ns()
            theirs.sendto(b"packet", ours.getsockname()) if kind == socket.SOCK_DGRAM else theirs.send(b"packet")
            data, _, arrival_ns = stamped.receive()
            assert data == b"packet"
            assert before_ns - MS <= arrival_ns <= clock.now_ns()


def _pair(kind):
    if kind == socket.SOCK_DGRAM:
        ours, theirs = socket.socket(type=kind), socket.socket(type=kind)
        ours.bind(("127.0.66.1", 0))
    else:
        with socket.create_server(("127.0.66.1", 0)) as server:
            theirs = socket.create_connection(server.getsockname())
            ours, _ = server.accept()
    ours.settimeout(10.0)
    return ours, theirs
