"""One TCP connection to a controller's RTDE port: connect, ask and be answered within a limit."""

from __future__ import annotations

import socket
from collections import deque
from contextlib import suppress

from bench.drivers.flight import FlightRecorder
from bench.drivers.receive import StampedSocket
from bench.drivers.robot.ur.codec import Frame, FrameSplitter, PackageType, encode_frame
from bench.errors import ConnectError, LinkLostError, ProtocolError
from bench.timing import Clock, patience_ns

__all__ = ["ArrivedFrame", "RtdeLink"]

RECEIVE_BYTES = 65_536
"""More than a second of a 500 Hz stream waits in the kernel; this much of it is taken at once."""
CHECK_HOST = "Check that the controller is on, the cable and [robot] host."

ArrivedFrame = tuple[int, Frame]
"""Host time at which the bytes came that completed a frame, and the frame."""


class RtdeLink:
    """A blocking socket with RTDE framing. One thread receives; `send` may be called from others.

    Parameters
    ----------
    host, port : str, int
        Address of the controller.
    clock : Clock
        Stamps what arrives.
    timeout_s : float
        Limit on connecting and on each answer, in the machine's own seconds.
    flight : FlightRecorder
        Keeps the last packets.
    """

    def __init__(self, host: str, port: int, clock: Clock, timeout_s: float, flight: FlightRecorder) -> None:
        self.peer = f"controller {host}:{port}"
        self._clock = clock
        self._timeout_s = timeout_s
        self._flight = flight
        self._splitter = FrameSplitter()
        self._arrived: deque[ArrivedFrame] = deque()
        self.unasked: list[ArrivedFrame] = []
        """Data packages and texts that came while an answer was awaited, oldest first."""
        self._socket = self._connect(host, port)
        self.stamps = StampedSocket(self._socket, clock, RECEIVE_BYTES)
        """Receives, and knows who stamps the arrivals."""

    def _connect(self, host: str, port: int) -> socket.socket:
        try:
            link = socket.create_connection((host, port), timeout=self._timeout_s)
        except TimeoutError as error:
            raise ConnectError(f"The {self.peer} did not answer in {self._timeout_s:g} s.", hint=CHECK_HOST) from error
        except ConnectionRefusedError as error:
            raise ConnectError(
                f"The {self.peer} refuses the connection.",
                hint="Wait until the robot has started; check [robot] rtde_port and that RTDE is enabled there.",
            ) from error
        except (OSError, UnicodeError) as error:
            raise ConnectError(f"The {self.peer} cannot be reached: {_reason(error)}.", hint=CHECK_HOST) from error
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return link

    def ask(self, kind: PackageType, payload: bytes = b"") -> bytes:
        """Send a request and return the payload of its answer.

        Raises
        ------
        ConnectError
            No answer within the limit, or the connection closed instead.
        ProtocolError
            Something arrived that is no RTDE.
        """
        limit_ns = self._clock.now_ns() + patience_ns(self._clock, self._timeout_s)
        try:
            self.send(kind, payload)
            while self._clock.now_ns() <= limit_ns:
                arrival_ns, frame = self._next()
                if frame[0] == kind:
                    return frame[1]
                self._set_aside(kind, arrival_ns, frame)
        except TimeoutError:
            pass
        except (LinkLostError, OSError) as error:
            raise ConnectError(
                f"The {self.peer} closed the connection when asked for RTDE package '{chr(kind)}'.",
                hint="Wait until the robot has started, then try again.",
            ) from error
        raise ConnectError(
            f"The {self.peer} accepts the connection but did not answer RTDE package '{chr(kind)}' "
            f"in {self._timeout_s:g} s.",
            hint="Wait until the robot has started; if it has, restart it.",
        )

    def _next(self) -> ArrivedFrame:
        if not self._arrived:
            arrival_ns, frames = self.receive()
            self._arrived.extend((arrival_ns, frame) for frame in frames)
            if not frames:
                return arrival_ns, (PackageType.TEXT, b"")
        return self._arrived.popleft()

    def _set_aside(self, awaited: PackageType, arrival_ns: int, frame: Frame) -> None:
        """Keep a package nobody asked for: data may overtake the answer to START."""
        if frame[0] not in (PackageType.DATA, PackageType.TEXT):
            raise ProtocolError(
                f"RTDE package '{chr(frame[0])}' came where '{chr(awaited)}' is due.",
                hint="Check that this port is the controller's RTDE port (30004).",
            )
        if frame[1]:
            self.unasked.append((arrival_ns, frame))

    def take_waiting(self) -> list[ArrivedFrame]:
        """Return, once, everything that arrived and was no answer; `receive` continues after it."""
        waiting = self.unasked + list(self._arrived)
        self.unasked = []
        self._arrived.clear()
        return waiting

    def set_timeout(self, timeout_s: float) -> None:
        """Limit how long `receive` and `send` may wait, in the machine's own seconds."""
        self._socket.settimeout(timeout_s)

    def receive(self) -> tuple[int, list[Frame]]:
        """Return the host time at which bytes arrived, and the frames they complete (possibly none).

        Of frames that came one after the other and are taken together, it is the time of the last: true for the
        newest, and for the others late, as a delay of the network would be.

        Raises
        ------
        TimeoutError
            Nothing arrived within the limit.
        LinkLostError
            The connection is closed.
        ProtocolError
            The bytes are no RTDE.
        """
        try:
            data, _, arrival_ns = self.stamps.receive()
        except TimeoutError:
            raise
        except OSError as error:
            raise LinkLostError(f"The connection to the {self.peer} broke: {_reason(error)}.") from error
        if not data:
            raise LinkLostError(f"The {self.peer} closed the connection.")
        self._flight.note_received(data, arrival_ns)
        return arrival_ns, self._splitter.feed(data)

    def send(self, kind: PackageType, payload: bytes = b"") -> None:
        """Send one package; `OSError` if it cannot be sent."""
        frame = encode_frame(kind, payload)
        self._flight.note_sent(frame)
        self._socket.sendall(frame)

    def interrupt(self) -> None:
        """Make a `receive` that waits in another thread return."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the socket. May be called twice."""
        self._socket.close()


def _reason(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error)
    return text[:1].lower() + text[1:]
