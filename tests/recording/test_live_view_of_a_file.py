"""The live view of a run that was under way before anybody watched."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from recording_examples import T0_NS, make_frame, open_writer

from bench.live.server import LiveServer
from bench.live.view import show_run
from bench.model import CycleEvent, CycleEventKind, LogEntry, Record, RunState, Severity, StateChange
from bench.recording import CYCLE, POINTS, RunFollower, open_run
from bench.recording.writing import writer as writer_module

N_FRAMES = 300


class Screen(LiveServer):
    """Keeps what a server would send."""

    def __init__(self) -> None:
        self.forwarded: dict[str, list[bytes]] = defaultdict(list)
        self.statuses: list[Mapping[str, Any]] = []

    def forward(self, topic: str, payload: bytes, host_ns: int) -> None:
        self.forwarded[topic].append(payload)

    def show_status(self, values: Mapping[str, Any], host_ns: int) -> None:
        self.statuses.append(values)


class GrowsAtFirstWait(threading.Event):
    """A stop that is never set; the first time that anybody waits for it, the file grows by its rest."""

    def __init__(self, path: Path, rest: bytes) -> None:
        super().__init__()
        self._path, self._rest = path, rest

    def wait(self, timeout: float | None = None) -> bool:
        with self._path.open("ab") as stream:
            stream.write(self._rest)
        self._rest = b""
        return False


@pytest.fixture
def finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(writer_module, "CHUNK_BYTES", 20_000)  # many chunks of few records
    writer = open_writer(tmp_path / "a.mcap")
    writer.put_all([StateChange(T0_NS, RunState.RUNNING, ""), LogEntry(T0_NS, Severity.WARN, "run", "links are slow")])
    for i in range(N_FRAMES):
        writer.put_all(_records(i))
    return writer.close(exit_status="success", reason="all cycles are done")


def _records(i: int) -> list[Record]:
    frame = make_frame(i, n_points=12)
    if i % 10 != 9:
        return [frame]
    return [frame, CycleEvent(frame.arrival_ns, CycleEventKind.COMPLETED, i // 10, float("nan"))]


def test_what_was_there_before_is_counted_and_only_what_comes_is_shown(tmp_path: Path, finished: Path) -> None:
    data, growing = finished.read_bytes(), tmp_path / "b.mcap.active"
    growing.write_bytes(data[: len(data) // 2])
    n_before = open_run(growing).topics[CYCLE]
    assert 0 < n_before < N_FRAMES // 10
    screen = Screen()
    show_run(RunFollower(growing), screen, GrowsAtFirstWait(growing, data[len(data) // 2 :]))
    status = screen.statuses[-1]
    assert (status["state"], status["alarms"], status["last_alarm"]) == ("RUNNING", 1, "links are slow")
    assert status["cycles_completed"] == N_FRAMES // 10
    assert len(screen.forwarded[CYCLE]) == N_FRAMES // 10 - n_before
    assert 0 < len(screen.forwarded[POINTS]) < N_FRAMES // 2


def test_markers_of_which_no_cable_can_be_made_are_shown_with_the_reason(tmp_path: Path, finished: Path) -> None:
    growing = tmp_path / "b.mcap.active"
    screen = Screen()
    show_run(RunFollower(growing), screen, GrowsAtFirstWait(growing, finished.read_bytes()))
    assert "No static marker was found" in screen.statuses[-1]["cable"]
    assert len(screen.forwarded[POINTS]) > 0
