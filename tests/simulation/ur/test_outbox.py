from __future__ import annotations

import socket

import pytest

from bench.simulation.outbox import Outbox

PATIENCE_NS = 10_000_000_000


@pytest.fixture
def pair():
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    theirs.setblocking(False)
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    yield ours, theirs
    ours.close()
    theirs.close()


def read_all(link):
    data = b""
    try:
        while piece := link.recv(1 << 20):
            data += piece
    except BlockingIOError:
        pass
    return data


def numbered(number, size=1000):
    return number.to_bytes(4, "big") * (size // 4)


def test_a_client_that_reads_gets_every_package(pair):
    ours, theirs = pair
    outbox = Outbox(ours, PATIENCE_NS)
    for number in range(50):
        outbox.send_package(numbered(number), number)
        assert read_all(theirs) == numbered(number)
    assert outbox.is_empty
    assert outbox.skipped == 0


def test_a_slow_reader_gets_whole_packages_and_the_newest_last(pair):
    ours, theirs = pair
    outbox = Outbox(ours, PATIENCE_NS)
    for number in range(500):
        outbox.send_package(numbered(number), number)
    assert outbox.skipped > 0
    data = read_all(theirs)
    while not outbox.is_empty:
        outbox.flush(500)
        data += read_all(theirs)
    packages = [data[start : start + 1000] for start in range(0, len(data), 1000)]
    numbers = [int.from_bytes(package[:4], "big") for package in packages]
    assert packages == [numbered(number) for number in numbers]
    assert numbers == sorted(set(numbers))
    assert numbers[-1] == 499
    assert len(numbers) + outbox.skipped == 500


def test_answers_are_never_skipped_and_come_before_the_package_that_waits(pair):
    ours, theirs = pair
    outbox = Outbox(ours, PATIENCE_NS)
    while outbox.is_empty:
        outbox.send_package(numbered(1), 0)
    outbox.send_package(numbered(2), 0)
    outbox.send(b"answer")
    data = b""
    while not outbox.is_empty:
        data += read_all(theirs)
        outbox.flush(0)
    data += read_all(theirs)
    assert data.endswith(b"answer" + numbered(2))


def test_a_client_that_does_not_read_is_cut_off_after_the_limit(pair):
    ours, theirs = pair
    outbox = Outbox(ours, PATIENCE_NS)
    while outbox.is_empty:
        outbox.send_package(numbered(1), 0)
    outbox.send_package(numbered(2), PATIENCE_NS)
    assert not outbox.is_cut
    outbox.send_package(numbered(3), PATIENCE_NS + 1)
    assert outbox.is_cut
    read_all(theirs)
    assert theirs.recv(1) == b""


def test_a_client_that_reads_a_little_is_not_cut_off(pair):
    ours, theirs = pair
    outbox = Outbox(ours, PATIENCE_NS)
    for step in range(40):
        for _ in range(20):
            outbox.send_package(numbered(1), step * PATIENCE_NS // 2)
        theirs.recv(4000)
    assert not outbox.is_cut


def test_a_client_that_asks_for_ever_and_never_reads_is_cut_off(pair):
    ours, _ = pair
    outbox = Outbox(ours, PATIENCE_NS)
    for _ in range(300):
        outbox.send(bytes(8192))
    assert outbox.is_cut


def test_sending_to_a_client_that_is_gone_raises_nothing(pair):
    ours, theirs = pair
    outbox = Outbox(ours, PATIENCE_NS)
    theirs.close()
    outbox.send(b"hello")
    outbox.send_package(b"hello", 0)
    assert outbox.is_cut
    outbox.close()
    outbox.flush(0)
