"""Salvaging a run that was split: in place each part that needs it, as a copy all parts in one file."""

from __future__ import annotations

from pathlib import Path

import pytest
from recording_examples import make_frame, make_state, open_writer

from bench.errors import RecordingError, RecordingExistsError
from bench.recording import FRAME, ROBOT, open_run, salvage_copy, salvage_in_place
from bench.recording.reading.status import LAST_SECOND
from bench.run.journal import Journal, is_held

N_RECORDS = 30


@pytest.fixture
def split(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("bench.recording.writing.writer.CHUNK_BYTES", 1)
    for name in ("fdatasync", "fsync"):
        monkeypatch.setattr(f"bench.recording.files.output.os.{name}", lambda _descriptor: None)
    writer = open_writer(tmp_path / "run.mcap", split_bytes=9_000, attachments={"calibration.toml": "[a]"})
    for i in range(N_RECORDS):
        writer.put(make_state(i))
        writer.put(make_frame(i, n_points=2))
    path = writer.close(exit_status="success", reason="done")
    assert len(writer.paths) > 5
    return path


def break_off(split: Path, number: int) -> Path:
    """Leave the run as a kill in that part does; the part is cut in its last record."""
    later = sorted(split.parent.glob("run.*.mcap"), key=lambda path: int(path.name.split(".")[1]))
    for path in later[number - 1 :]:
        path.unlink()
    last = later[number - 2]
    data = last.read_bytes()
    active = last.with_name(last.name + ".active")
    active.write_bytes(data[: data.index(b"bench.continues") - 20])
    last.unlink()
    return active


def test_in_place_the_part_that_broke_off_gets_its_end_and_the_others_are_left_alone(split: Path) -> None:
    active = break_off(split, 4)
    before, states = split.read_bytes(), open_run(split)[ROBOT].sequence.tolist()
    salvaged = salvage_in_place(split)
    assert salvaged.path == split
    assert (salvaged.is_closed, salvaged.was_complete) == (False, False)
    assert sum(salvaged.topics.values()) == sum(open_run(split).topics.values())
    assert split.read_bytes() == before
    assert not active.exists()
    run = open_run(split)
    assert str(run.status).startswith("salvaged: ")
    assert run.status.lost.endswith(LAST_SECOND)
    assert run.status.lost.count(LAST_SECOND) == 1
    assert run[ROBOT].sequence.tolist() == states


def test_in_place_a_part_between_others_that_lacks_its_end_has_lost_no_second(split: Path) -> None:
    second = split.with_name("run.2.mcap")
    data = second.read_bytes()
    active = second.with_name("run.2.mcap.active")
    active.write_bytes(data[: data.index(b"bench.continues") - 13])
    second.unlink()
    salvaged = salvage_in_place(split)
    assert salvaged.is_closed
    run = open_run(split)
    assert run.status.complete, run.status.lost
    assert run[ROBOT].sequence.tolist() == list(range(N_RECORDS))


def test_a_later_part_that_is_named_is_salvaged_alone(split: Path) -> None:
    active = break_off(split, 4)
    salvaged = salvage_in_place(active)
    assert salvaged.path == split.with_name("run.4.mcap")
    assert open_run(split).status.lost.endswith(LAST_SECOND)


def test_a_part_that_broke_off_before_its_first_record_gets_its_end_too(split: Path) -> None:
    active = break_off(split, 4)
    data = active.read_bytes()
    active.write_bytes(data[: data.index(b"lz4") - 45])
    salvage_in_place(split)
    assert open_run(split.with_name("run.4.mcap")).topics == {}
    assert open_run(split).status.lost.endswith(LAST_SECOND)


def test_a_part_of_which_nothing_can_be_kept_is_left_as_it_is_and_named(split: Path) -> None:
    active = break_off(split, 4)
    active.write_bytes(b"")
    salvaged = salvage_in_place(split)
    assert salvaged.lost == ("run.4.mcap is missing, and so is all that followed",) or "run.4.mcap" in salvaged.lost[0]
    assert active.read_bytes() == b""


def test_a_copy_of_a_run_in_parts_is_one_file_with_all_of_it(split: Path, tmp_path: Path) -> None:
    from mcap.reader import make_reader

    whole, expected = tmp_path / "whole.mcap", open_run(split)
    salvaged = salvage_copy(split, whole)
    assert salvaged.was_complete
    assert salvaged.lost == ()
    run = open_run(whole)
    assert run.status.complete
    assert "part" not in str(run.status)
    assert run.topics == expected.topics == salvaged.topics
    assert run[ROBOT].sequence.tolist() == list(range(N_RECORDS))
    assert run[FRAME].frame_number.tolist() == expected[FRAME].frame_number.tolist()
    assert {name: values for name, values in run.metadata.items() if name != "bench.salvage"} == expected.metadata
    with whole.open("rb") as stream:
        reader = make_reader(stream)
        assert sorted(one.name for one in reader.iter_attachments()) == ["calibration.toml", "config.toml"]
        assert [one.name for one in reader.iter_metadata()].count("bench.run") == 1
        assert sum(1 for _ in reader.iter_messages()) == sum(run.topics.values())


def test_a_copy_says_which_part_was_missing(split: Path, tmp_path: Path) -> None:
    n_lost = sum(open_run(split.with_name("run.3.mcap")).topics.values())
    split.with_name("run.3.mcap").unlink()
    salvaged = salvage_copy(split, tmp_path / "whole.mcap")
    said = f"run.3.mcap is missing: {n_lost} messages"
    assert salvaged.lost == (said,)
    assert open_run(tmp_path / "whole.mcap").status.lost == said


def test_a_part_that_is_damaged_in_its_middle_is_named_and_nothing_is_changed(split: Path) -> None:
    broken = split.with_name("run.3.mcap")
    data = bytearray(broken.read_bytes())
    data[data.index(b"\x03\0\0\0lz4") + 60] ^= 0xFF
    broken.write_bytes(data)
    with pytest.raises(RecordingError, match=r"run\.3\.mcap is damaged at byte"):
        salvage_in_place(split)
    assert broken.read_bytes() == data


def test_no_part_is_finished_where_one_of_the_names_is_taken(split: Path) -> None:
    active = break_off(split, 4)
    before = active.read_bytes()
    other = open_writer(split.with_name("other.mcap"), run_id="another").close(exit_status="success", reason="")
    other.rename(split.with_name("run.4.mcap"))
    assert open_run(split).status.lost.endswith(LAST_SECOND)  # the other run's file is ignored
    with pytest.raises(RecordingExistsError, match=r"run\.4\.mcap exists already"):
        salvage_in_place(split)
    assert active.read_bytes() == before


def test_every_part_of_a_run_that_is_being_written_is_held(split: Path) -> None:
    journal = Journal(split, {})
    try:
        assert is_held(split)
        assert is_held(split.with_name("run.3.mcap.active"))
        assert not is_held(split.with_name("other.3.mcap"))
    finally:
        journal.close(remove=True)
    assert not is_held(split.with_name("run.3.mcap.active"))
