"""Receiving from a socket, with the moment at which the bytes reached this computer.

The program's own stamp is late by the time it takes to wake up: some 10 µs where nothing else runs, 5 ms beside a busy
Python thread. Linux stamps each packet as the network card hands it over, by the computer's UTC clock; that stamp is
carried over to host time by how long ago it was. Where there is none, the program's own stamp stands.
"""

from __future__ import annotations

import socket
import struct
import sys
import time
from collections.abc import Callable
from typing import Any

from bench.timing import Clock

__all__ = ["KERNEL", "KERNEL_STAMPS", "PROGRAM", "StampedSocket"]

KERNEL, PROGRAM = "kernel", "program"
"""Who stamps what arrives."""
KERNEL_STAMPS: int | None = 35 if sys.platform == "linux" else None
"""SO_TIMESTAMPNS, which is SCM_TIMESTAMPNS too (Linux, asm-generic/socket.h); Python's socket module lacks it. macOS
stamps datagrams only, and in its monotonic clock or to the microsecond; Windows has it for few network cards."""
TIMESPEC = struct.Struct("@ll")
ANCILLARY_BYTES = 64
"""One control message of two 8-byte numbers takes 32."""
STEP_NS = 1_000_000
"""NTP slews by at most 0.5 ms in the second after which a link is lost: more between two reads is a step of UTC."""
FEW, MANY = 20, 0.01
"""Reads without a stamp that are not worth a word: the kernel takes a moment to begin, and later leaves out 4 of 10 001
over loopback (measured 2026-11). A step of UTC costs those that wait to be read."""
NS_PER_S = 1_000_000_000


class StampedSocket:
    """Receives from a socket of any kind; everything else is done with the socket itself.

    A stream socket tells the stamp of the last packet of what it returns. So of several messages that are received at
    once, all but the last look later than they came, never earlier; a datagram has its own stamp.

    Parameters
    ----------
    link : socket
        Connected, or bound.
    clock : Clock
        Host time.
    largest_bytes : int
        Most that one call returns.
    option : int, optional
        Socket option that asks for the kernel's stamps; None where there is none.
    utc_ns : callable
        The computer's UTC clock, by which the kernel stamps.
    """

    def __init__(
        self,
        link: socket.socket,
        clock: Clock,
        largest_bytes: int,
        *,
        option: int | None = KERNEL_STAMPS,
        utc_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._link = link
        self._clock = clock
        self._largest_bytes = largest_bytes
        self._option = option if _switch_on(link, option) else None
        self._utc_ns = utc_ns
        self._last = (utc_ns(), clock.now_ns())
        self._steady_since_ns = self._last[0]
        """UTC since which no step was seen: a stamp before it may be from before the step."""
        self._latest_ns = self._last[1]
        self.n_reads = 0
        self.n_unstamped = 0
        """Reads whose stamp the kernel left out, or which lay across a step of UTC: stamped by the program."""

    @property
    def stamped_by(self) -> str:
        """`KERNEL`, or `PROGRAM` where the system has no such stamps."""
        return PROGRAM if self._option is None else KERNEL

    def remark(self) -> str:
        """Return a sentence if the kernel left out so many stamps that it shows; else empty."""
        if self._option is None or self.n_unstamped <= FEW + MANY * self.n_reads:
            return ""
        return f"{self.n_unstamped} of {self.n_reads} reads had no stamp of the kernel's; they have the program's."

    def receive(self) -> tuple[bytes, Any, int]:
        """Return what arrived, whom from (None: the one connected), and the host time at which it did.

        Raises
        ------
        OSError
            As the socket's own receive calls; `TimeoutError` where its time limit is over.
        """
        self.n_reads += 1
        if self._option is None:
            data, sender = self._link.recvfrom(self._largest_bytes)
            return data, sender, self._clock.now_ns()
        data, notes, _, sender = self._link.recvmsg(self._largest_bytes, ANCILLARY_BYTES)
        # in this order: an interruption between the two makes the stamp later, which the clock's map can bear
        utc_ns = self._utc_ns()
        # never before the read before it, whose stamp may be the program's
        self._latest_ns = max(self._latest_ns, self._map(notes, utc_ns, self._clock.now_ns()))
        return data, sender, self._latest_ns

    def _map(self, notes: list[tuple[int, int, bytes]], utc_ns: int, now_ns: int) -> int:
        """Return the kernel's stamp in host time; `now_ns` where it has none, or none that can be trusted."""
        last_utc_ns, last_ns = self._last
        self._last = utc_ns, now_ns
        speed = self._clock.speed
        if abs((utc_ns - last_utc_ns) * speed - (now_ns - last_ns)) > STEP_NS * speed:
            self._steady_since_ns = utc_ns
        for level, kind, data in notes:
            if level == socket.SOL_SOCKET and kind == self._option and len(data) == TIMESPEC.size:
                seconds, nanoseconds = TIMESPEC.unpack(data)
                stamp_ns: int = seconds * NS_PER_S + nanoseconds
                if self._steady_since_ns <= stamp_ns <= utc_ns:
                    return now_ns - round((utc_ns - stamp_ns) * speed)
        self.n_unstamped += 1
        return now_ns


def _switch_on(link: socket.socket, option: int | None) -> bool:
    if option is None or not hasattr(link, "recvmsg"):
        return False
    try:
        link.setsockopt(socket.SOL_SOCKET, option, 1)
    except OSError:
        return False
    return True
