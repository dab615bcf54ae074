"""The times in a chunk's head have no checksum. One that lies must not hide what the chunk holds."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from recording_examples import T0_NS, make_frame, make_state, write_run

from bench.recording import POINTS, ROBOT, open_run, salvage_copy

MS = 1_000_000
N_RECORDS = 60
LIES = {
    "a year later": lambda start, end: (start + 365 * 86_400_000 * MS, end + 365 * 86_400_000 * MS),
    "before the first": lambda start, end: (1, 2),
    "ends before it begins": lambda start, end: (end, start),
    "nothing but its first message": lambda start, end: (start, start),
    "nothing but its last message": lambda start, end: (end, end),
    "nothing": lambda start, end: (0, 0),
    "all of time": lambda start, end: (0, 2**64 - 1),
}


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> bytes:
    """Return a finished file of many chunks, a state and a frame every 10 ms."""
    monkeypatch.setattr("bench.recording.writing.writer.CHUNK_BYTES", 3000)
    some = [r for i in range(N_RECORDS) for r in (make_state(5 * i), make_frame(i, n_points=2))]
    return write_run(tmp_path / "run.mcap", some).read_bytes()


def _tell_other_times(data: bytes, chunk: int, lie: str) -> tuple[bytes, int, int]:
    """Return the file with other times in the head of one of its chunks, and the times that stood there."""
    changed, offset, seen = bytearray(data), 8, -1
    while True:
        opcode, length = struct.unpack_from("<BQ", changed, offset)
        seen += opcode == 6
        if seen == chunk:
            break
        offset += 9 + length
    start, end = struct.unpack_from("<QQ", changed, offset + 9)
    struct.pack_into("<QQ", changed, offset + 9, *LIES[lie](start, end))
    return bytes(changed), start, end


@pytest.mark.parametrize("is_cut", [False, True], ids=["finished", "unfinished"])
@pytest.mark.parametrize("lie", LIES)
def test_a_chunk_whose_head_lies_about_its_times_is_found_where_its_messages_are(
    recording: bytes, tmp_path: Path, lie: str, is_cut: bool
) -> None:
    data, start_ns, end_ns = _tell_other_times(recording, 3, lie)
    path = tmp_path / "lying.mcap"
    path.write_bytes(data[: -len(data) // 50] if is_cut else data)
    run = open_run(path)
    times = run[ROBOT].log_time_ns
    assert times.tolist() == [T0_NS + 10 * MS * i for i in range(N_RECORDS)]
    inside = run.read([ROBOT, POINTS], start_ns, end_ns + 1)
    expected = times[(times >= start_ns) & (times <= end_ns)]
    assert len(expected) >= 3
    assert inside[ROBOT].log_time_ns.tolist() == expected.tolist()
    assert inside[POINTS].log_time_ns.tolist() == expected.tolist()
    assert len(run.read([ROBOT], times[-1] + 1)[ROBOT].sequence) == 0
    parts = [part[ROBOT].log_time_ns for part in run.stream([ROBOT], part_bytes=1)]
    assert np.concatenate(parts).tolist() == times.tolist()


def test_a_salvaged_copy_tells_the_true_times_in_its_summary(recording: bytes, tmp_path: Path) -> None:
    data, start_ns, end_ns = _tell_other_times(recording, 3, "a year later")
    path = tmp_path / "lying.mcap"
    path.write_bytes(data)
    with salvage_copy(path, tmp_path / "good.mcap").path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[3]
    assert (chunk.message_start_time, chunk.message_end_time) == (start_ns, end_ns)
    assert open_run(tmp_path / "good.mcap").span_ns[1] < T0_NS + 3600_000 * MS
