from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from recording_examples import make_frame, make_state, write_run

from bench.cli import main
from bench.run.journal import Journal


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> bytes:
    monkeypatch.setattr("bench.recording.writing.writer.CHUNK_BYTES", 1)
    return write_run(tmp_path / "whole.mcap", [make_state(0), make_frame(0)]).read_bytes()


def _salvage(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["bench", "salvage", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    code = ended.value.code
    assert isinstance(code, int)
    return code


def test_the_exit_code_says_whether_all_some_or_nothing_was_kept(
    recording: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.mcap.active"
    for cut, code, said in (
        (len(recording), 0, "has its end and no damage: there was nothing to salvage."),
        (len(recording) - 5, 0, "bench report"),
        (200, 1, "could be kept"),
        (3, 1, "nothing in it can be kept"),
    ):
        bad.write_bytes(recording[:cut])
        good = tmp_path / f"good-{cut}.mcap"
        assert _salvage(monkeypatch, bad, "--output", good) == code
        out, err = capsys.readouterr()
        assert said in (err if code else out)
        assert good.exists() == (code == 0)
        assert ("of /robot/state" in out) == (code == 0)


def test_what_was_lost_is_said_and_is_exit_code_3(
    recording: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.mcap.active"
    name = b"\x03\0\0\0lz4"
    second_chunk = recording.index(name, recording.index(name) + 1)
    bad.write_bytes(recording[:second_chunk])
    assert _salvage(monkeypatch, bad, "--in-place") == 3
    out = capsys.readouterr().out
    assert f"{tmp_path / 'bad.mcap'}: " in out
    assert "lost: 37 bytes from byte" in out
    assert "about the last second" in out
    assert not bad.exists()


def test_one_place_must_be_named(
    recording: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "whole.mcap"
    for options in ((), ("--in-place", "--output", tmp_path / "x.mcap")):
        assert _salvage(monkeypatch, path, *options) == 2
        assert "--in-place" in capsys.readouterr().err
    assert path.read_bytes() == recording


def test_a_recording_that_is_being_written_is_left_alone(
    recording: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    live = tmp_path / "run.mcap.active"
    live.write_bytes(recording[:-5])
    journal = Journal(tmp_path / "run.mcap", {})
    try:
        assert _salvage(monkeypatch, live, "--in-place") == 5
    finally:
        journal.close(remove=True)
    assert "a bench that still runs" in capsys.readouterr().err
    assert live.read_bytes() == recording[:-5]


def test_a_disk_that_refuses_leaves_no_half_copy(
    recording: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    bad = tmp_path / "bad.mcap"
    bad.write_bytes(recording[:-5])
    monkeypatch.setattr(os, "fdatasync", refuse)
    assert _salvage(monkeypatch, bad, "--output", tmp_path / "good.mcap") == 5
    assert "No space left" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.mcap", "whole.mcap"]
