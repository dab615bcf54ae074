from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest
from recording_examples import make_frame, make_state, write_run

from bench.recording import POINTS, ROBOT, Run, open_run
from bench.recording.container.chunks import Data, read_offsets
from bench.recording.container.contents import Chunk, DamagedError
from bench.recording.files.run_files import RunFiles
from bench.recording.reading import batches
from bench.recording.reading.gathering import MESSAGE_HEAD
from bench.recording.reading.in_turn import work_in_turn

N_RECORDS = 60


def test_work_is_finished_one_by_one_in_order_by_whoever_prepared_it() -> None:
    is_free = threading.Lock()

    def prepare(item: int) -> tuple[int, int]:
        time.sleep(0.002 * (item % 3))  # later ones are ready earlier
        return item, threading.get_ident()

    def finish(prepared: tuple[int, int]) -> int:
        assert is_free.acquire(blocking=False)
        assert prepared[1] == threading.get_ident()
        is_free.release()
        return prepared[0]

    assert list(work_in_turn(range(20), prepare, finish)) == list(range(20))


def test_what_is_raised_in_one_turn_ends_all_of_them() -> None:
    finished = []

    def finish(item: int) -> None:
        if item == 3:
            raise MemoryError("no room")
        finished.append(item)

    with pytest.raises(MemoryError, match="no room"):
        list(work_in_turn(range(100), int, finish))
    assert finished == [0, 1, 2]


def _write_small_chunks(path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    monkeypatch.setattr("bench.recording.writing.writer.CHUNK_BYTES", 3000)
    records = [record for i in range(N_RECORDS) for record in (make_state(i), make_frame(i, n_points=i % 5))]
    return open_run(write_run(path, records))


def test_batches_of_any_size_read_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = _write_small_chunks(tmp_path / "run.mcap", monkeypatch)
    whole.load([ROBOT, POINTS])
    for size in (1, 7000, 20_000):  # every chunk alone, some, many
        with monkeypatch.context() as patch:
            patch.setattr(batches, "BATCH_BYTES", size)
            run = open_run(whole.path)
            run.load([ROBOT, POINTS])
        for topic in (ROBOT, POINTS):
            assert run[topic].keys() == whole[topic].keys()
            for name, column in whole[topic].items():
                np.testing.assert_array_equal(run[topic][name], column)


@pytest.mark.parametrize("n_others", [0, 1, 5])
def test_of_a_batch_only_the_damaged_chunks_are_lost_and_each_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, n_others: int
) -> None:
    run = _write_small_chunks(tmp_path / "run.mcap", monkeypatch)
    container = run._container
    container.chunks = [chunk for chunk in container.chunks if chunk.index][: n_others + 2]
    n_expected = sum(run.topics.values())
    unpacked, unread = container.chunks[0], container.chunks[-1]
    (robot,) = [key for key, channel in container.channels.items() if channel.topic == ROBOT]
    original = batches.read_chunk

    def spoil(files: RunFiles, chunk: Chunk) -> Data:
        if chunk is unpacked:
            raise DamagedError("it does not unpack")
        data = bytearray(original(files, chunk))
        if chunk is unread:
            last = read_offsets(files, chunk, bytes(data), [robot])[robot][-1]
            data[last + MESSAGE_HEAD.itemsize] = 9  # no CDR
        return bytes(data)

    monkeypatch.setattr(batches, "read_chunk", spoil)
    run.load([ROBOT, POINTS])
    assert len(container.damage) == 2
    for chunk, words in ((unpacked, "it does not unpack"), (unread, "not little-endian CDR")):
        assert any(f"byte {chunk.offset} " in one and words in one for one in container.damage)
        n_expected -= sum(chunk.counts.values())
    assert sum(run.topics.values()) == n_expected
    assert len(run[ROBOT].sequence) == sum(chunk.counts.get(robot, 0) for chunk in container.chunks)


def test_an_index_that_names_messages_of_the_next_chunk_is_not_believed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = _write_small_chunks(tmp_path / "run.mcap", monkeypatch)
    whole = run[ROBOT].sequence.tolist()
    original = batches.read_index
    first = next(chunk for chunk in run._container.chunks if chunk.index)

    def shift(files: RunFiles, chunk: Chunk, wanted: list[int]) -> dict[int, np.ndarray]:
        found = original(files, chunk, wanted)
        return {key: places + first.unpacked_size for key, places in found.items()} if chunk is first else found

    monkeypatch.setattr(batches, "read_index", shift)
    again = Run([run.path], run._container)
    assert again[ROBOT].sequence.tolist() == whole
    assert again.status.complete


@pytest.mark.parametrize("widths", [[0] * 30 + [9] * 30, [9] * 3 + [0] * 57, [1] * 55 + [200] * 5, [0] * 60])
def test_points_find_room_however_their_number_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, widths: list[int]
) -> None:
    monkeypatch.setattr("bench.recording.writing.writer.CHUNK_BYTES", 3000)
    monkeypatch.setattr(batches, "BATCH_BYTES", 6000)
    frames = [make_frame(i, n_points=n) for i, n in enumerate(widths)]
    points = open_run(write_run(tmp_path / "run.mcap", frames))[POINTS]
    assert np.diff(points.offsets).tolist() == widths
    np.testing.assert_array_equal(points.points_m, np.concatenate([frame.points_m for frame in frames]))
    np.testing.assert_array_equal(points.residual_m, np.concatenate([frame.residual_m for frame in frames]))
