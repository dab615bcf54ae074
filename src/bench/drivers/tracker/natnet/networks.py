"""What NatNet needs of the networks: multicast groups to listen to, and trackers that answer a call."""

from __future__ import annotations

import errno
import fcntl
import socket
import time
from struct import Struct

from bench.drivers.tracker.natnet.messages import ConnectRequest, decode_server_info, encode_connect
from bench.drivers.tracker.natnet.wire import LARGEST_PACKET, Message, split_packet
from bench.errors import ConnectError, ProtocolError

__all__ = ["find_trackers", "open_group_socket"]

SIOCGIFADDR, SIOCGIFBRDADDR = 0x8915, 0x8919
"""linux/sockios.h: an interface's address, and the one that reaches all on its network."""
NONE, LOOPBACK = socket.inet_ntoa(bytes(4)), "127."
INTERFACE_NAME = Struct("16s240x")
INTERFACE_ADDRESS = Struct("20x4s232x")
"""struct ifreq, with room to spare."""
CALL_S = 0.5
"""How long answers to a call are waited for; a tracker on the same network needs 2 ms."""


def open_group_socket(group: str, port: int, local_address: str) -> socket.socket:
    """Open a socket that hears a multicast group on the network card that has `local_address`.

    Bound to the group itself: bound to the card's own address, Linux would deliver nothing; bound to no address, all
    that other programs join.

    Raises
    ------
    ConnectError
        The port is taken by a program that shares it with nobody, or the card takes no part in multicasts.
    """
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((group, port))
        membership = socket.inet_aton(group) + socket.inet_aton(local_address)
        listener.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    except OSError as error:
        listener.close()
        taken = error.errno == errno.EADDRINUSE
        raise ConnectError(
            f"The tracker's multicast {group}:{port} cannot be received at {local_address}: {error.strerror}.",
            hint=f"Another program holds UDP port {port} for itself: end it, or set another port in Motive."
            if taken
            else "Set [tracker] local_address to this machine's address on the tracker's network.",
        ) from error
    return listener


def find_trackers(command_port: int, local_address: str = "") -> dict[str, str]:
    """Call for trackers on every network of this machine.

    Parameters
    ----------
    command_port : int
    local_address : str, optional
        Call on the network of this address alone; of a loopback address, on this computer alone.

    Returns
    -------
    dict
        Name and version of the software, by the address it answers from.
    """
    found: dict[str, str] = {}
    call = encode_connect(ConnectRequest("bench"), Message.DISCOVERY)
    sockets = [
        caller
        for own, everyone in _networks()
        if _is_wanted(own, local_address) and (caller := _call(own, (everyone, command_port), call)) is not None
    ]
    try:
        deadline = time.monotonic() + CALL_S
        for caller in sockets:
            found |= _collect_answers(caller, deadline)
    finally:
        for caller in sockets:
            caller.close()
    return found


def _is_wanted(own: str, local_address: str) -> bool:
    return local_address in ("", own) or (own.startswith(LOOPBACK) and local_address.startswith(LOOPBACK))


def _networks() -> list[tuple[str, str]]:
    """Return our own address and the broadcast address of each network."""
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            request = INTERFACE_NAME.pack(name.encode()[:15])
            try:
                own, everyone = (_ask_interface(probe, what, request) for what in (SIOCGIFADDR, SIOCGIFBRDADDR))
            except OSError:  # the card is down, or has no IPv4 address
                continue
            found.append((own, _loopback_broadcast(own) if everyone == NONE else everyone))
    return [(own, everyone) for own, everyone in found if everyone]


def _ask_interface(probe: socket.socket, what: int, request: bytes) -> str:
    return socket.inet_ntoa(INTERFACE_ADDRESS.unpack(fcntl.ioctl(probe, what, request))[0])


def _loopback_broadcast(own: str) -> str:
    """Return the broadcast address that the loopback network has without naming it; empty for other networks."""
    return "127.255.255.255" if own.startswith(LOOPBACK) else ""


def _call(own: str, everyone: tuple[str, int], call: bytes) -> socket.socket | None:
    caller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        caller.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        caller.bind((own, 0))
        caller.sendto(call, everyone)
    except OSError:  # a network that cannot be called on has nobody to name
        caller.close()
        return None
    return caller


def _collect_answers(caller: socket.socket, deadline: float) -> dict[str, str]:
    found: dict[str, str] = {}
    while True:
        caller.settimeout(max(0.001, deadline - time.monotonic()))
        try:
            packet, sender = caller.recvfrom(LARGEST_PACKET)
            message, payload = split_packet(packet)
            if message == Message.SERVERINFO:
                info = decode_server_info(payload)
                found[sender[0]] = f"{info.name} {info.app_version[0]}.{info.app_version[1]}"
        except ProtocolError:
            continue
        except OSError:
            return found
