from __future__ import annotations

import re
import struct
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from damaged_bytes import draw_changes_and_a_cut, find_chunks, find_records, flip_a_bit, record_small_chunks
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory
from recording_examples import make_frame, make_state, write_run

from bench.errors import RecordingError, RecordingExistsError, RecordingUnfinishedError
from bench.recording import ROBOT, Salvaged, open_run, salvage_copy, salvage_in_place

N_FRAMES = 30
Messages = list[tuple[str, int, int, int, bytes]]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return record_small_chunks(tmp_path_factory.mktemp("runs") / "run.mcap", N_FRAMES)


def _read(path: Path) -> Messages:
    """Read a finished file with the MCAP project's own reader: through its summary, and from the start."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = [
            (channel.topic, m.log_time, m.publish_time, m.sequence, m.data)
            for _, channel, m in reader.iter_messages(log_time_order=False)
        ]
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(found)
        assert summary.statistics.metadata_count == len(list(reader.iter_metadata()))
        assert summary.statistics.attachment_count == len(list(reader.iter_attachments()))
        counts = Counter(summary.channels[key].topic for key in summary.statistics.channel_message_counts)
        assert counts.keys() == {message[0] for message in found}
        for topic in counts:
            assert [m.sequence for _, _, m in reader.iter_messages([topic], log_time_order=False)] == [
                message[3] for message in found if message[0] == topic
            ]
        stream.seek(0)
        n_streamed = sum(
            type(record).__name__ == "Message" for record in StreamReader(stream, validate_crcs=True).records
        )
        assert n_streamed == len(found)
    return found


def _messages_of(recording: bytes, folder: Path, keep: list[int] | None = None) -> Messages:
    """Return the messages of the chunks `keep` (None: all) of an undamaged recording."""
    path = folder / "whole.mcap"
    path.write_bytes(recording)
    whole, found, at = _read(path), [], 0
    for number, n in enumerate(_count_by_chunk(recording)):
        found += whole[at : at + n] if keep is None or number in keep else []
        at += n
    assert at == len(whole)
    return found


def _count_by_chunk(recording: bytes) -> list[int]:
    counts: list[int] = []
    for opcode, start, end in find_records(recording):
        if opcode == 6:
            counts.append(0)
        elif opcode == 7:
            counts[-1] += (end - start - 15) // 16
    return counts


def _copy(folder: Path, data: bytes) -> Salvaged:
    source, target = folder / "bad.mcap", folder / "good.mcap"
    source.write_bytes(data)
    target.unlink(missing_ok=True)
    salvaged = salvage_copy(source, target)
    assert source.read_bytes() == data
    return salvaged


def _finish(folder: Path, data: bytes) -> Salvaged:
    target = folder / "run.mcap"
    target.unlink(missing_ok=True)
    (folder / "run.mcap.active").write_bytes(data)
    return salvage_in_place(folder / "run.mcap.active")


@pytest.mark.parametrize("salvage", [_copy, _finish])
def test_every_whole_record_before_a_cut_is_kept_wherever_the_cut_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, salvage: Callable[[Path, bytes], Salvaged]
) -> None:
    monkeypatch.setattr("bench.recording.writing.writer.CHUNK_BYTES", 1)
    small = write_run(tmp_path / "small.mcap", [make_state(0), make_frame(0, 1)]).read_bytes()
    monkeypatch.setattr("os.fsync", lambda _: None)  # what is on the disk is not the question, and thousands take long
    monkeypatch.setattr("os.fdatasync", lambda _: None)
    whole, counts, chunks = _messages_of(small, tmp_path), _count_by_chunk(small), find_chunks(small)
    n_seen = set()
    begin = chunks[0][1] - 9  # of what stands before there is nothing to keep
    for cut in [*range(0, begin, 37), *range(begin, chunks[-1][1] + 9)]:
        n_chunks = sum(end <= cut for _, end in chunks)
        n_messages = sum(counts[:n_chunks])
        if not n_chunks:
            with pytest.raises(RecordingUnfinishedError, match="kept"):
                salvage(tmp_path, small[:cut])
            continue
        (tmp_path / "cut.mcap").write_bytes(small[:cut])
        assert sum(open_run(tmp_path / "cut.mcap").topics.values()) == n_messages
        salvaged = salvage(tmp_path, small[:cut])
        assert sum(salvaged.topics.values()) == n_messages
        if n_messages not in n_seen:
            assert _read(salvaged.path) == whole[:n_messages]
            n_seen.add(n_messages)
    assert len(n_seen) == len(chunks) > 2


@pytest.mark.parametrize("salvage", [_copy, _finish])
def test_a_recording_cut_between_two_records_loses_nothing_and_says_that_it_broke_off(
    recording: bytes, tmp_path: Path, salvage: Callable[[Path, bytes], Salvaged]
) -> None:
    starts = [start for opcode, start, _ in find_records(recording) if opcode == 6]
    salvaged = salvage(tmp_path, recording[: starts[4]])
    assert (salvaged.lost, salvaged.was_complete, salvaged.is_closed) == ((), False, False)
    run = open_run(salvaged.path)
    assert str(run.status).startswith("salvaged: ")
    assert run.status.lost == "what was received in about the last second before the recording broke off"
    assert not run.status.complete
    assert run.exit_status == "unfinished"
    assert _read(salvaged.path) == _messages_of(recording, tmp_path, [0, 1, 2, 3])


@pytest.mark.parametrize("salvage", [_copy, _finish])
def test_a_recording_that_lost_its_summary_only_is_complete_again(
    recording: bytes, tmp_path: Path, salvage: Callable[[Path, bytes], Salvaged]
) -> None:
    data_end = next(end for opcode, _, end in find_records(recording) if opcode == 15)
    for cut in (data_end - 13, data_end - 5, data_end, data_end + 700, len(recording) - 1):
        salvaged = salvage(tmp_path, recording[:cut])
        assert (salvaged.lost, salvaged.is_closed) == ((), True)
        run = open_run(salvaged.path)
        assert run.status.complete
        assert run.exit_status == "success"
        assert _read(salvaged.path) == _messages_of(recording, tmp_path)


def test_a_salvaged_file_is_decoded_bit_equal_by_ros2s_own_rules(recording: bytes, tmp_path: Path) -> None:
    cut = find_chunks(recording)[-2][1] + 40
    columns = open_run(_finish(tmp_path, recording[:cut]).path)[ROBOT]
    with (tmp_path / "run.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        states = [ros for *_, ros in reader.iter_decoded_messages([ROBOT], log_time_order=False)]
    assert [list(state.q_rad) for state in states] == columns.q_rad.tolist()
    assert [state.cycle_count for state in states] == columns.cycle_count.tolist()


def test_a_damaged_chunk_is_left_out_of_the_copy_and_named_with_its_times_and_topics(
    recording: bytes, tmp_path: Path
) -> None:
    chunks, counts = find_chunks(recording), _count_by_chunk(recording)
    for number, (start, end) in enumerate(chunks):
        salvaged = _copy(tmp_path, flip_a_bit(recording, (start, end)))
        keep = [i for i in range(len(chunks)) if i != number]
        assert _read(salvaged.path) == _messages_of(recording, tmp_path, keep)
        (sentence,) = salvaged.lost
        assert f"the chunk at byte {start + 9} " in sentence
        assert "2023-11-14 22:13:20" in sentence
        told = sum(int(n) for n in re.findall(r"(\d+) of /", sentence))
        assert told == counts[number]
        run = open_run(salvaged.path)
        assert sentence in run.status.lost
        assert not run.status.complete


def test_a_damaged_length_costs_its_record_and_not_what_stands_behind_it(recording: bytes, tmp_path: Path) -> None:
    chunks = find_chunks(recording)
    for number, (start, _) in enumerate(chunks[:-1]):
        damaged = bytearray(recording)
        struct.pack_into("<Q", damaged, start + 1, 2**40)
        salvaged = _copy(tmp_path, bytes(damaged))
        keep = [i for i in range(len(chunks)) if i != number]
        assert _read(salvaged.path) == _messages_of(recording, tmp_path, keep)
        assert f"{chunks[number + 1][0] - start} bytes from byte {start} on" in salvaged.lost[0]


def test_a_damaged_index_is_made_anew(recording: bytes, tmp_path: Path) -> None:
    for opcode, start, end in find_records(recording):
        if opcode != 7 or start > find_chunks(recording)[3][0]:
            continue
        for at in (start, start + 9, start + 11, start + 15, start + 23, end - 2):
            damaged = bytearray(recording)
            damaged[at] ^= 0x84
            (tmp_path / "run.mcap").write_bytes(bytes(damaged))
            assert sum(open_run(tmp_path / "run.mcap").topics.values()) == sum(_count_by_chunk(recording))
            assert _read(_copy(tmp_path, bytes(damaged)).path) == _messages_of(recording, tmp_path)


def test_definitions_that_were_lost_with_the_first_chunk_are_written_again(recording: bytes, tmp_path: Path) -> None:
    chunks = find_chunks(recording)
    salvaged = _copy(tmp_path, flip_a_bit(recording[: chunks[-1][1]], chunks[0]))
    assert _read(salvaged.path) == _messages_of(recording, tmp_path, list(range(1, len(chunks))))


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_whatever_bytes_are_changed_the_copy_holds_only_what_was_recorded(
    recording: bytes, data: st.DataObject
) -> None:
    changed = draw_changes_and_a_cut(data, recording)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        whole = Counter(_messages_of(recording, folder))
        try:
            salvaged = _copy(folder, changed)
        except RecordingUnfinishedError:
            assert not (folder / "good.mcap").exists()
            return
        assert not Counter(_read(salvaged.path)) - whole
        assert sorted(path.name for path in folder.iterdir()) == ["bad.mcap", "good.mcap", "whole.mcap"]


def test_in_place_touches_nothing_but_the_end(recording: bytes, tmp_path: Path) -> None:
    chunks = find_chunks(recording)
    _finish(tmp_path, recording[: chunks[5][1] - 3])
    keep = chunks[4][1]
    assert (tmp_path / "run.mcap").read_bytes()[:keep] == recording[:keep]
    assert not (tmp_path / "run.mcap.active").exists()


def test_a_torn_end_is_cut_away_in_place(recording: bytes, tmp_path: Path) -> None:
    chunks = find_chunks(recording)
    torn = bytearray(recording[: chunks[6][1]])
    torn[(chunks[5][0] + chunks[5][1]) // 2 :] = bytes(len(torn) - (chunks[5][0] + chunks[5][1]) // 2)
    salvaged = _finish(tmp_path, bytes(torn) + bytes(8192))
    assert _read(salvaged.path) == _messages_of(recording, tmp_path, [0, 1, 2, 3, 4])
    assert len(salvaged.lost) == 2


def test_a_file_damaged_before_its_end_is_not_finished_in_place(recording: bytes, tmp_path: Path) -> None:
    chunks = find_chunks(recording)
    damaged = flip_a_bit(recording[: chunks[6][1]], chunks[2])
    with pytest.raises(RecordingError, match=rf"damaged at byte {chunks[2][0] + 9}, before its end.*--output"):
        _finish(tmp_path, damaged)
    assert (tmp_path / "run.mcap.active").read_bytes() == damaged


def test_a_complete_file_is_left_alone(recording: bytes, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(recording)
    assert salvage_in_place(path).was_complete
    assert path.read_bytes() == recording


def test_a_salvaged_file_salvaged_again_says_what_it_lost_still(recording: bytes, tmp_path: Path) -> None:
    chunks = find_chunks(recording)
    first = _copy(tmp_path, flip_a_bit(recording, chunks[2]))
    (sentence,) = first.lost
    again = _copy(tmp_path, first.path.read_bytes()[:-3])
    assert sentence in open_run(again.path).status.lost


def test_nothing_is_overwritten(recording: bytes, tmp_path: Path) -> None:
    cut = recording[:-9]
    source = tmp_path / "run.mcap.active"
    source.write_bytes(cut)
    (tmp_path / "run.mcap").write_bytes(b"mine")
    with pytest.raises(RecordingExistsError, match="not overwritten"):
        salvage_in_place(source)
    with pytest.raises(RecordingExistsError, match="not overwritten"):
        salvage_copy(source, tmp_path / "run.mcap")
    assert (tmp_path / "run.mcap").read_bytes() == b"mine"
    assert source.read_bytes() == cut


def test_another_programs_recording_is_salvaged_too(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=200, compression=CompressionType.ZSTD)
        writer.start()
        channel = writer.register_channel("/imu", "json", writer.register_schema("Imu", "jsonschema", b"{}"))
        for i in range(50):
            writer.add_message(channel, i, b"{}", i)
        writer.finish()
    whole = path.read_bytes()
    salvaged = _copy(tmp_path, whole[: find_chunks(whole)[-1][0] + 20])
    assert [message[1] for message in _read(salvaged.path)] == list(range(sum(_count_by_chunk(whole)[:-1])))
    assert salvaged.is_closed
