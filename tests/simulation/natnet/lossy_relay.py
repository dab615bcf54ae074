"""A network that loses, doubles and overtakes: a UDP relay between a client and the simulated tracker."""

from __future__ import annotations

import select
import socket
import struct
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from bench.drivers.tracker.natnet.wire import LARGEST_PACKET, Message

LOSS, DOUBLING, OVERTAKING = 0.05, 0.02, 0.05
LONGEST_HELD = 8
"""Packets that may overtake one that is held back."""


class LossyRelay:
    """Passes on what the client sends as it is; what the tracker sends fares worse."""

    def __init__(self, host: str, server: tuple[str, int], seed: int = 1) -> None:
        self._rng = np.random.default_rng(seed)
        self._inner, self._outer = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._inner.bind((host, 0))
        self._outer.bind((host, 0))
        self._server = server
        self._client: tuple[str, int] | None = None
        self._held: list[tuple[int, bytes]] = []
        self._n_packets = 0
        self._stopping = threading.Event()
        self.address: tuple[str, int] = self._outer.getsockname()
        self.lost: set[int] = set()
        """Numbers of the frames that were lost."""
        self.passed: Counter[int] = Counter()
        """How often each frame was passed on."""
        self.order: list[int] = []

    def serve(self) -> None:
        while not self._stopping.is_set():
            for link in select.select([self._inner, self._outer], [], [], 0.02)[0]:
                packet, sender = link.recvfrom(LARGEST_PACKET)
                if link is self._outer:
                    self._client = sender
                    self._inner.sendto(packet, self._server)
                else:
                    self._treat(packet)

    def stop(self) -> None:
        self._stopping.set()

    def close(self) -> None:
        self._inner.close()
        self._outer.close()

    def _treat(self, packet: bytes) -> None:
        self._n_packets += 1
        chance = self._rng.random()
        if chance < LOSS:
            self._note(packet, is_lost=True)
        elif chance < LOSS + OVERTAKING:
            due = self._n_packets + int(self._rng.integers(1, LONGEST_HELD))
            self._held.append((due, packet))
        else:
            self._pass_on(packet)
            if chance > 1 - DOUBLING:
                self._pass_on(packet)
        for due, held in [one for one in self._held if one[0] <= self._n_packets]:
            self._held.remove((due, held))
            self._pass_on(held)

    def _pass_on(self, packet: bytes) -> None:
        if self._client is not None:
            self._outer.sendto(packet, self._client)
            self._note(packet, is_lost=False)

    def _note(self, packet: bytes, *, is_lost: bool) -> None:
        message, _, number = struct.unpack_from("<HHi", packet)
        if message == Message.FRAMEOFDATA and is_lost:
            self.lost.add(number)
        elif message == Message.FRAMEOFDATA:
            self.passed[number] += 1
            self.order.append(number)


@contextmanager
def lossy_relay(host: str, server: tuple[str, int]) -> Iterator[LossyRelay]:
    relay = LossyRelay(host, server)
    thread = threading.Thread(target=relay.serve)
    thread.start()
    try:
        yield relay
    finally:
        relay.stop()
        thread.join()
        relay.close()
