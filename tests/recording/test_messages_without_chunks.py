"""Files whose messages stand outside of chunks, as other programs may write them, are read and salvaged like any."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from damaged_bytes import write_again
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from recording_examples import make_frame, make_state, one_of_each, write_run

from bench.errors import RecordingError, RecordingUnfinishedError
from bench.recording import ROBOT, TOPICS, Run, open_run, salvage_copy, salvage_in_place
from bench.recording.container import scanning

N_RECORDS = 20
DATA_END = b"\x0f\x04\0\0\0\0\0\0\0"
Messages = list[tuple[int, int, int, int, bytes]]


@pytest.fixture
def original(tmp_path: Path) -> Run:
    some = [record for i in range(N_RECORDS) for record in (make_state(i), make_frame(i, n_points=i % 4, n_bodies=1))]
    return open_run(write_run(tmp_path / "run.mcap", [*some, *one_of_each()]))


@pytest.fixture
def loose(original: Run, tmp_path: Path) -> Path:
    """Return the same recording without chunks."""
    return write_again(original.path, tmp_path / "loose.mcap", use_chunking=False)


def _stream(path: Path) -> Messages:
    """Read the messages with MCAP's own library, record by record."""
    with path.open("rb") as stream:
        found = [record for record in StreamReader(stream, validate_crcs=True).records if isinstance(record, Message)]
    return [(m.channel_id, m.log_time, m.publish_time, m.sequence, m.data) for m in found]


@pytest.mark.parametrize("loose_bytes", [1, 1000, scanning.LOOSE_BYTES])
def test_messages_without_chunks_are_read_the_same(
    original: Run, loose: Path, monkeypatch: pytest.MonkeyPatch, loose_bytes: int
) -> None:
    monkeypatch.setattr(scanning, "LOOSE_BYTES", loose_bytes)
    run = open_run(loose)
    assert run.status.complete
    assert run.topics == original.topics
    assert run.span_ns == original.span_ns
    for topic in TOPICS:
        for name, column in original[topic].items():
            np.testing.assert_array_equal(run[topic][name], column, err_msg=name)
    middle = sum(original.span_ns) // 2
    parts = [run.read([ROBOT], 0, middle)[ROBOT], run.read([ROBOT], middle)[ROBOT]]
    assert [n for part in parts for n in part.sequence.tolist()] == run[ROBOT].sequence.tolist()


def test_messages_without_chunks_are_salvaged_into_chunks_up_to_a_cut(loose: Path, tmp_path: Path) -> None:
    data, whole = loose.read_bytes(), _stream(loose)
    kept, end_size = [], len(data) - data.index(DATA_END)
    for cut in range(len(data) // 4, len(data), len(data) // 16):
        loose.write_bytes(data[:cut])
        good = tmp_path / "good.mcap"
        good.unlink(missing_ok=True)
        salvaged = salvage_copy(loose, good)
        assert salvaged.lost or len(data) - cut < end_size
        found = _stream(good)
        assert found == whole[: len(found)]
        with good.open("rb") as stream:
            assert sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages()) == len(found)
        run = open_run(good)
        assert sum(run.topics.values()) == len(found)
        assert len(run[ROBOT].sequence) == run.topics.get(ROBOT, 0)
        kept.append(len(found))
    assert kept == sorted(kept)
    assert kept[0] < len(whole) == kept[-1]


def test_messages_without_chunks_are_not_finished_in_place(loose: Path) -> None:
    cut = loose.with_name("cut.mcap.active")
    cut.write_bytes(loose.read_bytes()[:-50])
    with pytest.raises(RecordingError, match="holds messages outside of chunks"):
        salvage_in_place(cut)


def test_a_message_too_short_for_its_head_is_the_end_of_what_is_read(loose: Path) -> None:
    data = loose.read_bytes()
    data = data[: data.index(DATA_END)]  # where the data ends
    loose.write_bytes(data + b"\x05\x03\0\0\0\0\0\0\0abc")
    run = open_run(loose)
    assert "impossible length" in run.status.text
    assert len(run[ROBOT].sequence) == N_RECORDS + 1
    loose.write_bytes(data[:8] + b"\x05\x03\0\0\0\0\0\0\0abc")
    with pytest.raises(RecordingUnfinishedError):
        open_run(loose)
