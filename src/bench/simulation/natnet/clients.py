"""Who wants the frames."""

from __future__ import annotations

import threading

from bench.drivers.tracker.natnet.wire import Version
from bench.timing import Clock, patience_ns

__all__ = ["Address", "Clients"]

Address = tuple[str, int]

KEEPALIVE_LIMIT_S = 10.0
"""Machine time without CONNECT or KEEPALIVE after which a client gets no more frames."""


class Clients:
    """The unicast clients, each with its bitstream version. May be used from several threads."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._versions: dict[Address, Version] = {}
        self._heard_ns: dict[Address, int] = {}

    def add(self, address: Address, version: Version) -> None:
        """Begin, or begin anew, to serve a client."""
        with self._lock:
            self._versions[address] = version
            self._heard_ns[address] = self._clock.now_ns()

    def hear(self, address: Address) -> None:
        """Note that a client still listens; one that never connected stays unknown."""
        with self._lock:
            if address in self._versions:
                self._heard_ns[address] = self._clock.now_ns()

    def change_version(self, address: Address, version: Version) -> None:
        with self._lock:
            if address in self._versions:
                self._versions[address] = version

    def change_versions(self, version: Version) -> None:
        """Give every client the same version."""
        with self._lock:
            self._versions = dict.fromkeys(self._versions, version)

    def forget(self) -> None:
        """Know no client any more."""
        with self._lock:
            self._versions.clear()
            self._heard_ns.clear()

    def version_of(self, address: Address, default: Version) -> Version:
        with self._lock:
            return self._versions.get(address, default)

    def remove(self, address: Address) -> None:
        with self._lock:
            self._versions.pop(address, None)
            self._heard_ns.pop(address, None)

    def drop_silent(self) -> None:
        """Forget the clients that have not been heard for 10 s."""
        oldest_ns = self._clock.now_ns() - patience_ns(self._clock, KEEPALIVE_LIMIT_S)
        with self._lock:
            silent = [address for address, heard_ns in self._heard_ns.items() if heard_ns < oldest_ns]
        for address in silent:
            self.remove(address)

    def snapshot(self) -> list[tuple[Address, Version]]:
        """Return all clients as they are now."""
        with self._lock:
            return list(self._versions.items())
