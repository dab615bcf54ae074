"""The journal of a run, and what a run that goes on with it reads from both of its files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.config import Config, ProgramFile, simulated_config, to_toml
from bench.errors import ConfigError, RecordingError, RunError
from bench.model import CycleEvent, CycleEventKind, RunState, StateChange
from bench.recording import CYCLE, RunWriter, open_run
from bench.run.about import attach_program
from bench.run.journal import Journal, is_held, journal_path, read_completed
from bench.run.resume import PROGRAM, RESUMED, hash_test, read_origin, verify_origin
from bench.timing import ManualClock


def write_run(
    path: Path,
    n_recorded: int,
    n_before: int = 0,
    *,
    extra: dict[str, dict[str, str]] | None = None,
    program: ProgramFile | None = None,
    split_bytes: int = 0,
) -> Path:
    clock = ManualClock()
    notes = {RESUMED: {"completed": str(n_before)}} if n_before else {}
    notes |= {PROGRAM: program.to_metadata()} if program else {}
    writer = RunWriter(
        path,
        clock,
        config_toml=to_toml(simulated_config()),
        versions={},
        run_id="r1",
        extra=notes | (extra or {}),
        attachments=attach_program(program),
        split_bytes=split_bytes,
    )
    for i in range(n_recorded):
        for kind in (CycleEventKind.GRANTED, CycleEventKind.STARTED, CycleEventKind.COMPLETED):
            writer.put(CycleEvent(clock.now_ns(), kind, n_before + i))
    writer.put(CycleEvent(clock.now_ns(), CycleEventKind.STARTED, n_before + n_recorded))
    return writer.close(exit_status="abort", reason="test")


def change(config: Config, table: str, **values: object) -> Config:
    part = getattr(config, table).model_copy(update=values)
    return config.model_copy(update={table: part})


def test_a_journal_says_how_many_cycles_are_done_and_where_the_run_is(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "a.mcap", {"run_id": "r1", "completed": 0})
    for n in (0, 1, 1, 2):
        journal.note_completed(n)
    journal.note_state(StateChange(5, RunState.HOLDING, "the door"))
    lines = [json.loads(line) for line in journal_path(tmp_path / "a.mcap").read_text().splitlines()]
    assert [line["completed"] for line in lines if "completed" in line] == [0, 0, 1, 2]
    assert lines[-1] == {"state": "HOLDING", "reason": "the door", "host_ns": 5}
    assert read_completed(tmp_path / "a.mcap.active") == 2
    journal.close(remove=True)
    assert list(tmp_path.iterdir()) == []


def test_a_run_file_that_a_living_bench_writes_is_not_resumed(tmp_path: Path) -> None:
    path = write_run(tmp_path / "a.mcap", 3)
    journal = Journal(path, {})
    with pytest.raises(RecordingError, match="still runs"):
        read_origin(path)
    journal.close(remove=False)
    assert not is_held(path)
    assert read_origin(path).n_completed == 3


@settings(max_examples=30, deadline=None)
@given(st.binary(max_size=200))
def test_whatever_a_power_cut_leaves_of_a_journal_is_read(
    tmp_path_factory: pytest.TempPathFactory, junk: bytes
) -> None:
    folder = tmp_path_factory.mktemp("journal")
    journal_path(folder / "a.mcap").write_bytes(b'{"completed": 41}\n' + junk)
    assert read_completed(folder / "a.mcap") >= 41


def test_a_folder_that_takes_no_journal_ends_no_run(tmp_path: Path) -> None:
    journal_path(tmp_path / "a.mcap").mkdir()
    journal = Journal(tmp_path / "a.mcap", {})
    journal.note_completed(1)
    journal.close(remove=True)


def test_completed_cycles_are_counted_once_from_the_file(tmp_path: Path) -> None:
    origin = read_origin(write_run(tmp_path / "a.mcap", 7))
    assert (origin.n_completed, origin.n_recorded) == (7, 7)
    assert "driven again" in origin.describe()


def test_the_journal_knows_the_last_second_that_the_file_lacks(tmp_path: Path) -> None:
    path = write_run(tmp_path / "a.mcap", 7)
    journal_path(path).write_text('{"completed": 7}\n{"completed": 8}\n')
    origin = read_origin(path)
    assert (origin.n_completed, origin.n_recorded) == (8, 7)
    assert "Of 1 of them the end was not recorded" in origin.describe()


def test_a_run_that_was_killed_in_its_third_part_is_gone_on_with_from_its_last_cycle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bench.recording.writing.writer.CHUNK_BYTES", 1)
    path = write_run(tmp_path / "a.mcap", 9, split_bytes=9_000)
    parts = open_run(path).parts
    assert len(parts) > 3
    for part in parts[3:]:
        part.path.unlink()
    data = parts[2].path.read_bytes()
    parts[2].path.unlink()
    (tmp_path / "a.3.mcap.active").write_bytes(data[: data.index(b"bench.continues") - 13])
    recorded = open_run(path)[CYCLE]
    n_recorded = int((recorded.kind == CycleEventKind.COMPLETED).sum())
    journal_path(path).write_text(json.dumps({"completed": n_recorded + 1}) + "\n")
    origin = read_origin(path)
    assert 0 < n_recorded < 9
    assert (origin.n_completed, origin.n_recorded) == (n_recorded + 1, n_recorded)
    assert origin.to_metadata()["file"] == "a.mcap"
    with pytest.raises(RunError, match=r"a\.3\.mcap\.active is part 3 of the run that begins in a\.mcap") as caught:
        read_origin(tmp_path / "a.3.mcap.active")
    assert caught.value.hint == f"Go on with that: --resume {path}."


def test_a_run_that_went_on_with_another_counts_from_there(tmp_path: Path) -> None:
    assert read_origin(write_run(tmp_path / "b.mcap", 4, n_before=7)).n_completed == 11


def test_another_test_is_refused_by_the_keys_that_differ(tmp_path: Path) -> None:
    origin = read_origin(write_run(tmp_path / "a.mcap", 2))
    config = change(change(simulated_config(), "cable", length_m=1.5), "robot", program="other.urp")
    with pytest.raises(ConfigError, match=r"different are cable\.length_m, robot\.program"):
        verify_origin(origin, config, 10)


def test_addresses_limits_and_policies_may_change(tmp_path: Path) -> None:
    origin = read_origin(write_run(tmp_path / "a.mcap", 2))
    config = change(change(simulated_config(), "robot", host="127.0.64.9"), "policy", hold_timeout_s=1.0)
    config = change(config, "cable", max_speed_m_s=1.0)
    verify_origin(origin, change(config, "run", name="b", operator="somebody"), 3)
    assert hash_test(config) == hash_test(origin.config)


BEND = ProgramFile("bend.urp", b"\x1f\x8b a program")


def test_the_copy_of_the_program_goes_on_with_the_run(tmp_path: Path) -> None:
    origin = read_origin(write_run(tmp_path / "a.mcap", 2, program=BEND))
    assert origin.read_program() == BEND
    verify_origin(origin, simulated_config(), 10, BEND)
    assert origin.doubt_program(BEND) == ""
    assert read_origin(write_run(tmp_path / "b.mcap", 2)).read_program() is None


def test_another_program_is_another_test(tmp_path: Path) -> None:
    origin = read_origin(write_run(tmp_path / "a.mcap", 2, program=BEND))
    changed = ProgramFile("bend.urp", BEND.content + b".")
    with pytest.raises(ConfigError, match=f"with another program: .*{BEND.sha256}; now .*{changed.sha256}"):
        verify_origin(origin, simulated_config(), 10, changed)
    verify_origin(origin, simulated_config(), 10, ProgramFile("renamed.urp", BEND.content))


@pytest.mark.parametrize(("before", "now"), [(BEND, None), (None, BEND)])
def test_a_program_that_only_one_of_two_runs_knows_is_told(
    tmp_path: Path, before: ProgramFile | None, now: ProgramFile | None
) -> None:
    origin = read_origin(write_run(tmp_path / "a.mcap", 2, program=before))
    verify_origin(origin, simulated_config(), 10, now)
    without = "this run" if now is None else "a.mcap"
    assert origin.doubt_program(now).endswith(f"cannot be told: {without} has no copy of it.")


def test_a_damaged_copy_is_not_carried_on(tmp_path: Path) -> None:
    path = write_run(tmp_path / "a.mcap", 2, program=BEND)
    path.write_bytes(path.read_bytes().replace(b"a program", b"a progrom"))
    with pytest.raises(RecordingError, match=r"no attachment 'program\.urp' that is undamaged"):
        read_origin(path).read_program()
    lying = {PROGRAM: BEND.to_metadata() | {"sha256": "0" * 64}}
    path = write_run(tmp_path / "b.mcap", 2, program=BEND, extra=lying)
    with pytest.raises(RecordingError, match="is not what its SHA-256 says"):
        read_origin(path).read_program()


def test_a_run_with_all_its_cycles_is_refused(tmp_path: Path) -> None:
    origin = read_origin(write_run(tmp_path / "a.mcap", 5))
    with pytest.raises(RunError, match="nothing is left to do"):
        verify_origin(origin, simulated_config(), 5)


def test_an_imported_take_is_refused(tmp_path: Path) -> None:
    path = write_run(tmp_path / "a.mcap", 0, extra={"bench.import": {"file": "take.csv"}})
    with pytest.raises(RunError, match="imported take"):
        read_origin(path)
