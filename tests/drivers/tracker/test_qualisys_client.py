"""The Qualisys driver against a simulated QTM, and against servers that are none."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from bench.config import QualisysConfig
from bench.drivers.tracker import make_tracker
from bench.drivers.tracker.qualisys import client as client_module
from bench.errors import ConfigError, ConnectError, ProtocolError
from bench.model import LogEntry, StampKind, TrackerFrame
from bench.timing import RunClock

sys.path.insert(0, str(Path(__file__).parents[2] / "simulation" / "qualisys"))

from qualisys_bench import running_qtm

HOST, OTHER = "127.0.71.21", "127.0.71.22"
PATIENCE_S = 30.0


class Recorder:
    """A sink, and the callbacks."""

    def __init__(self):
        self.records, self.missed, self.losses = [], [], []
        self._changed = threading.Condition()

    def take(self, record):
        self._note(self.records, record)

    def make_client(self, clock=None, host=HOST):
        return make_tracker(
            QualisysConfig(host=host),
            clock or RunClock.start(),
            on_missed=lambda _topic, n: self._note(self.missed, n),
            on_lost=lambda error: self._note(self.losses, str(error)),
        )

    def wait_for(self, condition):
        with self._changed:
            assert self._changed.wait_for(condition, PATIENCE_S), self.said

    @property
    def frames(self):
        return [record for record in self.records if isinstance(record, TrackerFrame)]

    @property
    def said(self):
        return [record.text for record in self.records if isinstance(record, LogEntry)]

    def _note(self, notes, note):
        with self._changed:
            notes.append(note)
            self._changed.notify_all()


@pytest.fixture
def recorder():
    return Recorder()


@pytest.fixture
def qtm():
    with running_qtm(HOST) as running:
        yield running


@contextmanager
def server(answer: bytes, host: str = OTHER) -> Iterator[None]:
    """Accept everybody, send `answer`, and listen."""
    listener = socket.create_server((host, 22223))
    links: list[socket.socket] = []

    def serve() -> None:
        while True:
            try:
                link, _ = listener.accept()
            except OSError:
                return
            links.append(link)
            link.sendall(answer)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield
    finally:
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        thread.join()
        for link in links:
            link.close()


def test_every_frame_arrives_with_what_was_shown(qtm, recorder):
    client = recorder.make_client(qtm.clock)
    info = client.open(recorder.take)
    recorder.wait_for(lambda: len(recorder.frames) >= 40)
    client.close()
    assert (info.kind, info.rate_hz, info.bodies) == ("qualisys", 100.0, {1: "clamp"})
    assert info.detail["up_axis"] == "+Y"
    for frame in recorder.frames:
        shown = qtm.scene.exposures[frame.frame_number]
        assert frame.points_m == pytest.approx(shown.points_m, rel=1e-6)
        assert (frame.ids.tolist(), frame.flags.tolist()) == ([1, 2, 3, *shown.ids[3:]], [0] * 3 + [0x10] * 9)
        assert frame.stamp is StampKind.TRACKER_TIME
        assert frame.bodies[0].position_m == pytest.approx((1.0, 2.0, 3.0))
        assert qtm.scene.host_ns[frame.frame_number] <= frame.capture_ns <= frame.arrival_ns
    numbers = [frame.frame_number for frame in recorder.frames]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert recorder.missed == []


def test_a_stall_is_counted_frame_by_frame_and_told(qtm, recorder):
    client = recorder.make_client(qtm.clock)
    client.open(recorder.take)
    recorder.wait_for(lambda: len(recorder.frames) >= 5)
    qtm.server.stall(0.3)
    before = len(recorder.frames)
    recorder.wait_for(lambda: recorder.missed and len(recorder.frames) > before + 5)
    client.close()
    numbers = [frame.frame_number for frame in recorder.frames]
    assert sum(recorder.missed) == numbers[-1] - numbers[0] + 1 - len(numbers)
    assert any("Frames missed" in text for text in recorder.said)


@pytest.mark.parametrize("fault", ["silence", "closed"])
def test_a_lost_tracker_is_told_and_comes_back_in_a_segment_of_its_own(qtm, recorder, fault, monkeypatch):
    monkeypatch.setattr(client_module, "RETRY_S", 0.05)
    client = recorder.make_client(qtm.clock)
    client.open(recorder.take)
    recorder.wait_for(lambda: len(recorder.frames) >= 5)
    if fault == "silence":
        qtm.server.stall(1.5)
    else:
        qtm.server.drop_clients()
    recorder.wait_for(lambda: "The tracker sends frames again." in recorder.said)
    recorder.wait_for(lambda: recorder.frames[-1].segment > 0)
    client.close()
    expected = "has sent no frame for 1 s" if fault == "silence" else "closed the connection"
    assert [expected in text for text in recorder.losses] == [True]
    assert any(expected in text for text in recorder.said)
    assert len({frame.frame_number for frame in recorder.frames}) == len(recorder.frames)


def test_nobody_there_is_told_in_one_sentence(recorder):
    client = recorder.make_client(host=OTHER)
    with pytest.raises(ConnectError, match="refuses the connection"):
        client.open(recorder.take)
    client.close()


def test_a_server_that_never_answers_is_given_up(recorder, monkeypatch):
    monkeypatch.setattr(client_module, "TIMEOUT_S", 0.2)
    client = recorder.make_client(host=OTHER)
    with server(b""), pytest.raises(ConnectError, match="accepts the connection but does not answer"):
        client.open(recorder.take)
    client.close()


@pytest.mark.parametrize(
    "answer",
    [
        b"HTTP/1.1 400 Bad Request\r\n\r\n",
        np.uint32([8, 77]).tobytes(),
        np.uint32([10, 6]).tobytes() + b"ab",
        np.uint32([0, 1, 0, 1]).tobytes(),
    ],
)
def test_garbage_instead_of_qtm_is_an_error_and_no_hang(recorder, monkeypatch, answer):
    monkeypatch.setattr(client_module, "TIMEOUT_S", 0.3)
    client = recorder.make_client(host=OTHER)
    with server(answer), pytest.raises((ConnectError, ProtocolError)):
        client.open(recorder.take)
    client.close()


def test_without_the_library_the_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "qtm_rt", None)
    monkeypatch.delitem(sys.modules, "bench.drivers.tracker.qualisys.client", raising=False)
    with pytest.raises(ConfigError, match="qtm-rt") as failure:
        make_tracker(QualisysConfig(host=HOST), RunClock.start())
    assert "cable-bench[qualisys]" in failure.value.hint


def test_the_simulated_bench_does_without_the_library():
    """It speaks QTM's protocol by itself; an extra must not be asked of who only simulates."""
    code = "import sys; sys.modules['qtm_rt'] = None; import bench.simulation.bench"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=PATIENCE_S)


def test_a_client_can_be_closed_before_it_is_opened(recorder):
    recorder.make_client().close()
