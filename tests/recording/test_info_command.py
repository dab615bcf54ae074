from __future__ import annotations

import sys
from pathlib import Path

import pytest
from recording_examples import T0_NS, make_frame, make_state, open_writer, write_run

from bench.cli import main
from bench.model import ClockSample, ClockSource, CycleEvent, CycleEventKind, DeviceInfo
from bench.recording import CLOCK, ROBOT, STATS, open_run


@pytest.fixture
def run_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a run of a second with two cycles, of which 3 frames were missed and whose tracker clock gains."""
    monkeypatch.setattr("bench.recording.writing.writer.CHUNK_BYTES", 2000)
    writer = open_writer(tmp_path / "run.mcap", extra={"bench.resumed_from": {"file": "old.mcap", "completed": "7"}})
    writer.add_device(DeviceInfo("robot", "ur", "10.0.0.2:30004", "5.15", 500.0))
    for i in range(100):
        if i in {0, 99}:
            send, ticks = T0_NS + i * 10_000_000, 5_000_000 + i * 100_100
            writer.put(ClockSample(ClockSource.TRACKER, send, ticks, send + 400_000, 1e7, 0))
        if i in {40, 80}:
            writer.put(CycleEvent(T0_NS + i * 10_000_000, CycleEventKind.COMPLETED, i // 40 - 1, 0.0, ""))
        writer.put(make_state(5 * i))
        writer.put(make_frame(i))
    writer.note_missed("/tracker/frame", 3)
    return writer.close(exit_status="abort", reason="Ctrl-C")


def _info(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], path: Path) -> dict[str, str]:
    """Return what is said by name: the first line under its verdict, topics under their names."""
    monkeypatch.setattr(sys, "argv", ["bench", "info", str(path)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code in (0, None)
    first, *lines = capsys.readouterr().out.splitlines()
    said = {line[2:17].strip() if not line.startswith("  /") else line.split()[0]: line[17:] for line in lines}
    return said | {"status": first.removeprefix(f"{path}: ")}


def test_a_finished_run_is_told_with_cycles_devices_clocks_and_losses(
    run_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = _info(monkeypatch, capsys, run_file)
    assert said["status"].startswith("complete: ")
    assert said["exit status"] == "abort: Ctrl-C"
    assert said["cycles"] == "2 completed in this file"
    assert said["goes on with"].startswith("old.mcap")
    assert said["robot"] == "ur 5.15 at 10.0.0.2:30004, 500 Hz"
    assert said["tracker clock"] == "answered in 0.40 ms; +0.99 ms in 1 s against host time"
    assert said["/robot/state"].split()[-4:] == ["100", "100.0", "0", "0"]
    assert said["/tracker/frame"].split()[-4:] == ["100", "100.0", "0", "3"]
    assert "lost" not in said


def test_an_unfinished_run_is_told_up_to_where_it_goes(
    run_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    content = run_file.read_bytes()
    cut = run_file.with_name("cut.mcap.active")
    cut.write_bytes(content[: len(content) // 3])
    said = _info(monkeypatch, capsys, cut)
    assert said["status"].startswith("unfinished: ")
    assert "about the last second" in said["lost"]
    assert said["exit status"] == "unfinished"
    assert int(said["/robot/state"].split()[-4]) == open_run(cut).topics[ROBOT] < 100


def test_a_glance_reads_one_chunk_and_passes_over_damaged_ones(run_file: Path) -> None:
    whole = open_run(run_file)
    states = whole[ROBOT].sequence
    first, last = whole.read_edge(ROBOT, last=False).sequence, whole.read_edge(ROBOT, last=True).sequence
    assert 0 < len(first) < 20
    assert 0 < len(last) < 20
    assert (first[0], last[-1]) == (states[0], states[-1])
    content = bytearray(run_file.read_bytes())
    name = b"\x03\0\0\0lz4"
    start = content.index(name)
    content[start + 500] ^= 0xFF
    run_file.write_bytes(bytes(content))
    damaged = open_run(run_file)
    assert damaged.read_edge(ROBOT, last=False).sequence[0] == first[-1] + 5
    assert damaged.status.lost.count("the chunk at byte") == 1
    assert len(damaged[ROBOT].sequence) == len(states) - len(first)
    assert damaged.status.lost.count("the chunk at byte") == 1


def test_a_glance_at_what_is_not_there_is_empty(tmp_path: Path) -> None:
    run = open_run(write_run(tmp_path / "run.mcap", [make_state(0)]))
    assert len(run.read_edge(CLOCK, last=True).send_ns) == 0
    assert len(run.read_edge(STATS, last=True).topic) > 0
    assert run.span_ns == (T0_NS, T0_NS)
