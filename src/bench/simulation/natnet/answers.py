"""What the simulated tracker answers to each message of a client."""

from __future__ import annotations

from collections.abc import Callable

from bench.drivers.tracker.natnet.messages import (
    ServerInfo,
    decode_connect,
    decode_echo_request,
    decode_text,
    encode_echo_response,
    encode_integer_response,
    encode_number_response,
    encode_server_info,
    encode_text_response,
    encode_unrecognized,
)
from bench.drivers.tracker.natnet.models import Model, encode_models
from bench.drivers.tracker.natnet.wire import Message, Version, split_packet
from bench.errors import ProtocolError
from bench.simulation.natnet.clients import Address, Clients
from bench.simulation.natnet.packets import choose_version

__all__ = ["Answers"]

UNITS_TO_MILLIMETRES = 1000.0
UP_AXIS = 1
"""y, as in Motive's own default."""
ACCEPTED = 0
"""Return code of a command that was carried out."""
REFUSED = 1


class Answers:
    """Everything of the tracker's software that answers, without its sockets."""

    def __init__(
        self, info: ServerInfo, models: tuple[Model, ...], clients: Clients, rate_hz: float, ticks: Callable[[], int]
    ) -> None:
        self.info = info
        """What the server says of itself; may be another from one moment to the next."""
        self.models = models
        """May be changed too."""
        self._clients = clients
        self._rate_hz = rate_hz
        self._ticks = ticks
        self.is_recording = False
        self.newest_frame: Callable[[Version], bytes | None] = lambda _version: None
        """Gives the newest frame again, in a version, for REQUEST_FRAMEOFDATA."""

    @property
    def version(self) -> Version:
        """The server's own bitstream version."""
        return self.info.natnet_version[:2]

    def answer(self, packet: bytes, sender: Address) -> bytes | None:
        """Return the answer to a packet, or None where none is due (also to garbage, as Motive keeps silent)."""
        try:
            message, payload = split_packet(packet)
            return self._answer(message, payload, sender)
        except ProtocolError:
            return None

    def _answer(self, message: int, payload: bytes, sender: Address) -> bytes | None:
        if message == Message.ECHOREQUEST:
            return encode_echo_response(decode_echo_request(payload), self._ticks())
        if message == Message.KEEPALIVE:
            self._clients.hear(sender)
            return None
        if message in (Message.CONNECT, Message.DISCOVERY, Message.DISCONNECT):
            return self._meet(message, payload, sender)
        return self._inform(message, payload, sender)

    def _meet(self, message: int, payload: bytes, sender: Address) -> bytes | None:
        if message == Message.DISCONNECT:
            self._clients.remove(sender)
            return None
        if message == Message.CONNECT:
            self._clients.add(sender, self._choose(decode_connect(payload).bitstream))
        return encode_server_info(self.info)

    def _choose(self, wanted: Version | None) -> Version:
        # What goes to a whole group is in the server's own version, whatever one client asks for.
        return self.version if self.info.is_multicast else choose_version(self.version, wanted)

    def _inform(self, message: int, payload: bytes, sender: Address) -> bytes | None:
        version = self._clients.version_of(sender, self.version)
        if message == Message.REQUEST_MODELDEF:
            return encode_models(self.models, version)
        if message == Message.REQUEST_FRAMEOFDATA:
            return self.newest_frame(version)
        if message == Message.REQUEST:
            return self._carry_out(decode_text(payload), payload, sender)
        return encode_unrecognized(payload)

    def _carry_out(self, request: str, payload: bytes, sender: Address) -> bytes:
        name, _, argument = request.partition(",")
        facts = {
            "FrameRate": lambda: encode_number_response(self._rate_hz),
            "UnitsToMillimeters": lambda: encode_number_response(UNITS_TO_MILLIMETRES),
            "UpAxis": lambda: encode_integer_response(UP_AXIS),
            "Bitstream": lambda: self._bitstream(argument, sender),
            "StartRecording": lambda: self._record(True),
            "StopRecording": lambda: self._record(False),
            "LiveMode": lambda: encode_integer_response(ACCEPTED),
            "SubscribeToData": lambda: encode_integer_response(ACCEPTED),
        }
        fact = facts.get(name)
        return encode_unrecognized(payload) if fact is None else fact()

    def _record(self, on: bool) -> bytes:
        self.is_recording = on
        return encode_integer_response(ACCEPTED)

    def _bitstream(self, argument: str, sender: Address) -> bytes:
        if not argument:
            major, minor = self._clients.version_of(sender, self.version)
            return encode_text_response(f"Bitstream,{major}.{minor}")
        try:
            wanted = tuple(int(number) for number in argument.split("."))
        except ValueError:
            return encode_integer_response(REFUSED)
        chosen = self._choose(wanted)
        self._clients.change_version(sender, chosen)
        return encode_integer_response(ACCEPTED if chosen == wanted[:2] else REFUSED)
