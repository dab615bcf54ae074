"""The dashboard's line protocol over a plain socket, for where ur_rtde has no build.

Has the part of ur_rtde's ``DashboardClient`` that `bench.drivers.robot.ur.program` calls, by the same names and with
the same manners: a refused command is a `RuntimeError` that holds the controller's own reply.
"""

from __future__ import annotations

import socket

from bench.timing import Clock, patience_ns

__all__ = ["LONGEST_REPLY", "LineDashboard"]

PORT = 29999
ANSWER_LIMIT_S = 2.5
"""On a whole answer; as ur_rtde has it, so that both behave alike beside a controller that is slow to answer."""
LONGEST_REPLY = 4096
"""No reply of the dashboard is longer than a path and a sentence."""


class LineDashboard:
    """A connection to the dashboard server of a UR controller: one command a line, one line back.

    Parameters
    ----------
    hostname : str
        Address of the controller.
    clock : Clock
        For the limit on an answer, which is in the machine's own seconds.
    """

    def __init__(self, hostname: str, clock: Clock) -> None:
        self._hostname = hostname
        self._clock = clock
        self._link: socket.socket | None = None
        self._received = b""

    def connect(self, timeout_ms: int = 2000) -> None:
        """Connect and take the banner; `OSError` or `RuntimeError` if there is none."""
        self._link = socket.create_connection((self._hostname, PORT), timeout_ms * 1e-3)
        self._received = b""
        try:
            banner = self._read_line()
        except (OSError, RuntimeError):
            self.disconnect()
            raise
        if "Dashboard" not in banner:
            self.disconnect()
            raise RuntimeError(f"it says '{banner}' where a dashboard names itself")

    def disconnect(self) -> None:
        """Close the connection. May be called twice."""
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def polyscopeVersion(self) -> str:  # noqa: N802 - ur_rtde's names, here and below
        return self._ask("PolyscopeVersion")

    def isInRemoteControl(self) -> bool:  # noqa: N802
        return self._expect("is in remote control", ("true", "false")) == "true"

    def safetystatus(self) -> str:
        return self._expect("safetystatus", ("Safetystatus",))

    def safetymode(self) -> str:
        return self._expect("safetymode", ("Safetymode",))

    def robotmode(self) -> str:
        return self._expect("robotmode", ("Robotmode",))

    def programState(self) -> str:  # noqa: N802
        return self._ask("programState")

    def getLoadedProgram(self) -> str:  # noqa: N802
        return self._ask("get loaded program")

    def loadURP(self, program: str) -> None:  # noqa: N802
        self._expect(f"load {program}", ("Loading program",))

    def play(self) -> None:
        self._expect("play", ("Starting program",))

    def stop(self) -> None:
        self._expect("stop", ("Stopped",))

    def _expect(self, command: str, beginnings: tuple[str, ...]) -> str:
        reply = self._ask(command)
        if not reply.lower().startswith(tuple(text.lower() for text in beginnings)):
            raise RuntimeError(reply)
        return reply

    def _ask(self, command: str) -> str:
        if self._link is None:
            raise RuntimeError("not connected")
        try:
            self._link.settimeout(ANSWER_LIMIT_S)
            self._link.sendall(f"{command}\n".encode())
            return self._read_line()
        except TimeoutError as error:
            raise RuntimeError("Operation canceled") from error

    def _read_line(self) -> str:
        limit_ns = self._clock.now_ns() + patience_ns(self._clock, ANSWER_LIMIT_S)
        while b"\n" not in self._received:
            piece = self._receive(limit_ns)
            if not piece:
                raise RuntimeError("End of file")
            self._received += piece
            if len(self._received) > LONGEST_REPLY:
                raise RuntimeError(f"more than {LONGEST_REPLY} bytes without the end of a line")
        line, _, self._received = self._received.partition(b"\n")
        return line.decode("utf-8", "replace").strip()

    def _receive(self, limit_ns: int) -> bytes:
        """Return what comes next, nothing at the end; `TimeoutError` at the limit, which an answer that drips meets."""
        left_s = (limit_ns - self._clock.now_ns()) / patience_ns(self._clock, 1.0)
        if self._link is None:
            return b""
        if left_s <= 0.0:
            raise TimeoutError("timed out")
        self._link.settimeout(left_s)
        return self._link.recv(LONGEST_REPLY)
