"""The recorded traffic of a real tracker, cut, bent, doubled and mixed up: told, counted, and the stream goes on."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from natnet_recording import packets_of, traffic
from natnet_scripted import CLOCK_HZ, BareLink

from bench.drivers.tracker.natnet.bitstream import Bitstream
from bench.drivers.tracker.natnet.frame import decode_frame, encode_frame
from bench.drivers.tracker.natnet.stream import FrameStream
from bench.drivers.tracker.natnet.wire import Message
from bench.model import LogEntry, Record, TrackerFrame
from bench.timing import ManualClock

PERIOD_NS = 8_333_333
SERVERS = [(2, 10, 0, 0), (3, 0, 0, 0), (4, 1, 0, 0), (4, 5, 0, 0)]


class Listener:
    def __init__(self, server: tuple[int, ...] = (3, 0, 0, 0)) -> None:
        self.records: list[Record] = []
        self.missed = 0
        self.clock = ManualClock()
        bitstream = Bitstream(server, may_choose=False)
        self.stream = FrameStream(BareLink(), self.clock, self.records.append, bitstream, CLOCK_HZ, self._miss)
        self.stream.start()

    def _miss(self, _topic: str, n: int) -> None:
        self.missed += n

    def take(self, packet: bytes) -> None:
        self.clock.advance_ns(PERIOD_NS)
        self.stream.take(packet, self.clock.now_ns())
        self.stream.keep_up(self.clock.now_ns())

    def numbers(self) -> list[int]:
        return [record.frame_number for record in self.records if isinstance(record, TrackerFrame)]

    def n_broken(self) -> int:
        self.stream.finish()
        texts = [record.text for record in self.records if isinstance(record, LogEntry)]
        told = [text for text in texts if "cannot be read" in text]
        return int(told[-1].split(", ")[1].split()[0]) if told else 0


def of_version(packet: bytes, server: tuple[int, ...]) -> bytes:
    """Return a recorded packet as a server of that version would have sent it."""
    if struct.unpack_from("<H", packet)[0] != Message.FRAMEOFDATA:
        return packet
    return encode_frame(decode_frame(packet[4:], (3, 0)), server[:2])


def bend(packet: bytes, data: st.DataObject) -> bytes:
    """Cut a packet, or write over some of its bytes, or put some in or take some out."""
    how = data.draw(st.sampled_from(["cut", "write", "insert", "remove"]))
    at = data.draw(st.integers(0, len(packet) - 1))
    some = data.draw(st.binary(min_size=1, max_size=8))
    if how == "cut":
        return packet[:at]
    if how == "write":
        return packet[:at] + some + packet[at + len(some) :]
    return packet[:at] + some + packet[at:] if how == "insert" else packet[:at] + packet[at + len(some) :]


@settings(deadline=None, max_examples=300)
@given(st.data())
def test_whatever_becomes_of_a_packet_the_next_whole_frame_is_read(data: st.DataObject) -> None:
    server = data.draw(st.sampled_from(SERVERS))
    listener = Listener(server)
    good = [of_version(packet, server) for packet in packets_of(Message.FRAMEOFDATA)[:4]]
    listener.take(good[0])
    for _ in range(data.draw(st.integers(1, 8))):
        listener.take(bend(of_version(data.draw(st.sampled_from(traffic())), server), data))
    listener.take(good[-1])
    assert 162_737 in listener.numbers()


@settings(deadline=None, max_examples=100)
@given(st.lists(st.binary(max_size=300), max_size=30), st.sampled_from(SERVERS))
def test_garbage_is_counted_and_makes_no_frame(packets: list[bytes], server: tuple[int, ...]) -> None:
    listener = Listener(server)
    for packet in packets:
        listener.take(struct.pack("<HH", Message.FRAMEOFDATA, len(packet)) + packet)
    assert listener.n_broken() == len(packets)
    assert listener.numbers() == []
    assert listener.missed == 0


@settings(deadline=None, max_examples=100)
@given(st.sets(st.integers(1, 516)), st.integers(0, 5))
def test_of_the_recorded_frames_those_that_were_cut_are_missed_and_no_others(cut: set[int], n_bytes: int) -> None:
    listener = Listener()
    for index, packet in enumerate(packets_of(Message.FRAMEOFDATA)):
        listener.take(packet[: -1 - n_bytes] if index in cut else packet)
    assert listener.missed == listener.n_broken() == len(cut)
    assert len(listener.numbers()) == 518 - len(cut)


@pytest.mark.parametrize("packet", [b"", b"\x07", b"\x07\x00\xff"])
def test_a_packet_without_a_whole_header_is_counted(packet: bytes) -> None:
    listener = Listener()
    listener.take(packet)
    assert listener.n_broken() == 1
