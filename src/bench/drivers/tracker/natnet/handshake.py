"""What is asked of a tracker before its frames are read: who it is, how it streams, and what it measures in."""

from __future__ import annotations

from ipaddress import ip_address
from struct import Struct

from bench.config import TrackerConfig
from bench.drivers.base import RecordSink
from bench.drivers.tracker.natnet.bitstream import WANTED_VERSION, Bitstream
from bench.drivers.tracker.natnet.frame import OLDEST_VERSION, STAMPS_SINCE
from bench.drivers.tracker.natnet.link import CommandLink
from bench.drivers.tracker.natnet.messages import (
    ConnectRequest,
    ServerInfo,
    decode_number,
    decode_server_info,
    encode_connect,
    encode_request,
)
from bench.drivers.tracker.natnet.models import RigidBodyModel
from bench.drivers.tracker.natnet.networks import find_trackers
from bench.drivers.tracker.natnet.records import NS_PER_S
from bench.drivers.tracker.natnet.wire import Message, dotted, encode_packet
from bench.errors import ConnectError, DeviceStateError, ProtocolError
from bench.model import DeviceInfo, LogEntry, Severity
from bench.timing import Clock

__all__ = ["CONNECT", "begin_streaming", "connect", "describe", "name_software"]

CONNECT = encode_connect(ConnectRequest("bench", (0, 1), WANTED_VERSION, WANTED_VERSION))
CONNECT_TRIES, CONNECT_WAIT_S = 6, 0.5
"""3 s of machine time in all; a tracker on the same network answers within 2 ms."""
QUESTION_TRIES, QUESTION_WAIT_S = 3, 0.25
METRES_TO_MILLIMETRES = 1000.0
UP_AXES = {0: "x", 1: "y", 2: "z"}
FLOAT, INTEGER = Struct("<f"), Struct("<i")


def connect(link: CommandLink, config: TrackerConfig) -> ServerInfo:
    """Ask the tracker who it is.

    Raises
    ------
    ConnectError
        No answer within 3 s; the hint names the trackers that did answer a call on this machine's networks.
    """
    answer = link.ask(CONNECT, (Message.SERVERINFO,), tries=CONNECT_TRIES, wait_s=CONNECT_WAIT_S)
    if answer is None:
        raise ConnectError(
            f"The tracker at {link.name} does not answer: no NatNet server info within "
            f"{CONNECT_TRIES * CONNECT_WAIT_S:g} s.",
            hint=_advise(link, config),
        )
    return decode_server_info(answer[1])


def _advise(link: CommandLink, config: TrackerConfig) -> str:
    is_on_this_computer = ip_address(link.local_address).is_loopback
    found = find_trackers(config.command_port, link.local_address if is_on_this_computer else config.local_address)
    found.pop(config.host, None)
    if not found:
        return (
            "Is Motive running, its streaming enabled on this network, and does its PC's firewall let UDP port "
            f"{config.command_port} through?"
        )
    names = ", ".join(f"{address} ({name})" for address, name in sorted(found.items()))
    return f"On this machine's networks these trackers answer: {names}. Set [tracker] host to the one you mean."


def begin_streaming(server: ServerInfo, link: CommandLink, config: TrackerConfig) -> Bitstream:
    """Receive the frames as the tracker streams them, and return the decoder of its version.

    Before NatNet 3 a tracker does not tell how it streams: then both ways are open.

    Raises
    ------
    ProtocolError
        Its NatNet is older than 2.9, or it has no clock.
    DeviceStateError
        It streams in another way than the configuration asks for.
    ConnectError
        Its multicast cannot be received.
    """
    is_old = server.natnet_version < STAMPS_SINCE
    if server.natnet_version < OLDEST_VERSION:
        raise ProtocolError(
            f"The tracker at {link.name} speaks NatNet {dotted(server.natnet_version)}; 2.9 is the oldest that "
            "bench reads.",
            hint="Update to Motive 1.9 or newer; from 2.0 on its cameras' times are known.",
        )
    if server.clock_hz == 0 and not is_old:
        raise ProtocolError(f"The tracker at {link.name} does not tell the frequency of its clock.")
    streamed = "multicast" if server.is_multicast else "unicast"
    if not is_old and config.connection not in ("auto", streamed):
        raise DeviceStateError(
            f"The tracker at {link.name} streams {streamed}, and [tracker] connection asks for {config.connection}.",
            hint=f"Set Motive's Transmission Type to {config.connection.capitalize()}, or leave connection out.",
        )
    is_multicast = config.connection == "multicast" or (config.connection == "auto" and (is_old or server.is_multicast))
    if is_multicast:
        group = config.multicast_group or ".".join(map(str, server.multicast_group))
        link.follow(group, config.data_port or server.data_port)
    else:
        link.unfollow()
    return Bitstream(server.natnet_version, may_choose=not is_multicast)


def describe(link: CommandLink, server: ServerInfo, bitstream: Bitstream, sink: RecordSink, clock: Clock) -> DeviceInfo:
    """Ask all that the run file says of a tracker.

    Raises
    ------
    DeviceStateError
        Positions are streamed in another unit than metres.
    """
    millimetres = _ask_number(link, "UnitsToMillimeters")
    if millimetres not in (None, METRES_TO_MILLIMETRES):
        raise DeviceStateError(
            f"The tracker at {link.name} streams positions in units of {millimetres:g} mm, not in metres.",
            hint="Set the streaming scale in Motive back to 1 (metres).",
        )
    rate_hz = _ask_number(link, "FrameRate")
    up_axis = _ask_number(link, "UpAxis", INTEGER)
    return DeviceInfo(
        device="tracker",
        kind="natnet",
        address=link.name,
        version=name_software(server),
        rate_hz=float("nan") if rate_hz is None else rate_hz,
        bodies=_ask_bodies(link, bitstream, sink, clock),
        detail={
            "bitstream": dotted(bitstream.version),
            "clock_hz": str(server.clock_hz or NS_PER_S),  # NatNet 2 counts seconds, recorded as nanoseconds
            "connection": link.group or "unicast",
            "local_address": link.local_address,
            "receive_buffer_bytes": str(link.receive_buffer_bytes),
            "stamped_by": link.stamped_by,
            "up_axis": UP_AXES.get(-1 if up_axis is None else int(up_axis), "unknown"),
            "version_chosen_by": "client" if bitstream.is_chosen else "server",
        },
    )


def _ask_number(link: CommandLink, question: str, layout: Struct = FLOAT) -> float | None:
    answers = (Message.RESPONSE, Message.UNRECOGNIZED_REQUEST)
    answer = link.ask(encode_request(question), answers, tries=QUESTION_TRIES, wait_s=QUESTION_WAIT_S)
    if answer is None or answer[0] == Message.UNRECOGNIZED_REQUEST:
        return None
    return decode_number(answer[1], layout)


def _ask_bodies(link: CommandLink, bitstream: Bitstream, sink: RecordSink, clock: Clock) -> dict[int, str]:
    """Return the rigid bodies' names. A run without rigid bodies does not need them, so their lack is no error."""
    question = encode_packet(Message.REQUEST_MODELDEF)
    answer = link.ask(question, (Message.MODELDEF,), tries=QUESTION_TRIES, wait_s=QUESTION_WAIT_S)
    try:
        models = () if answer is None else bitstream.decode_models(answer[1])
        problem = "gave no model definitions." if answer is None else ""
    except ProtocolError as error:
        models, problem = (), f"gave model definitions that cannot be read: {error}"
    if problem:
        sink(LogEntry(clock.now_ns(), Severity.WARN, "tracker", f"The tracker at {link.name} {problem}"))
    return {model.body_id: model.name for model in models if isinstance(model, RigidBodyModel)}


def name_software(server: ServerInfo) -> str:
    """Return name and versions of the tracker's software."""
    return f"{server.name} {dotted(server.app_version)}, NatNet {dotted(server.natnet_version)}"
