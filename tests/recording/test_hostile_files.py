"""Files made to hurt: whatever they claim, memory stays bounded and nothing is written but the file asked for."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import Writer
from recording_examples import make_state, write_run

from bench.errors import RecordingError
from bench.recording import ROBOT, open_run, salvage_copy, salvage_in_place

BOUND = 64 << 20
BOMB = bytes(400 << 20)


@pytest.fixture
def recording(tmp_path: Path) -> bytes:
    return write_run(tmp_path / "whole.mcap", [make_state(0)]).read_bytes()


@contextmanager
def _bounded_memory() -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < BOUND
    finally:
        tracemalloc.stop()


def _record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def _chunk(packed: bytes, claimed: int, compression: bytes, checksum: int = 0) -> bytes:
    head = struct.pack("<QQQII", 0, 1, claimed, checksum, len(compression)) + compression
    return _record(6, head + struct.pack("<Q", len(packed)) + packed)


def _without_end(recording: bytes) -> bytes:
    """Return the recording up to the end of its data."""
    offset = 8
    while recording[offset] != 15:
        offset += 9 + struct.unpack_from("<Q", recording, offset + 1)[0]
    return recording[:offset]


@pytest.mark.parametrize("claimed", [1000, 2**40])
@pytest.mark.parametrize("compression", [b"lz4", b"zstd"])
def test_a_chunk_that_unpacks_to_far_more_than_it_claims_is_refused(
    recording: bytes, tmp_path: Path, compression: bytes, claimed: int
) -> None:
    packed = lz4.frame.compress(BOMB) if compression == b"lz4" else zstandard.compress(BOMB)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(_without_end(recording) + _chunk(packed, claimed, compression))
    with _bounded_memory():
        run = open_run(path)
        assert len(run[ROBOT].sequence) == 1
        assert not run.status.complete
        salvaged = salvage_copy(path, tmp_path / "good.mcap")
    assert any("chunk" in text for text in salvaged.lost)
    assert len(open_run(tmp_path / "good.mcap")[ROBOT].sequence) == 1


@pytest.mark.parametrize("claimed", [0, 1000, 999, 1001, 2**28])
def test_a_checksum_makes_no_chunk_believed_that_unpacks_to_another_size(
    recording: bytes, tmp_path: Path, claimed: int
) -> None:
    packed = lz4.frame.compress(BOMB if claimed < 1001 else BOMB[:1000])
    path = tmp_path / "bomb.mcap"
    path.write_bytes(_without_end(recording) + _chunk(packed, claimed, b"lz4", checksum=zlib.crc32(BOMB[:1000])))
    before = _peak_bytes()
    run = open_run(path)
    assert len(run[ROBOT].sequence) == 1
    assert "does not unpack" in run.status.lost or "checksum" in run.status.lost
    assert _peak_bytes() - before < BOUND


def _peak_bytes() -> int:
    """Return the most memory that was ever in use: what is allocated and never touched is not."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line for line in lines if line.startswith("VmHWM")).split()[1])


@pytest.mark.parametrize("opcode", [1, 3, 4, 5, 6, 7, 9, 12, 0x90])
@pytest.mark.parametrize("length", [2**31, 2**40, 2**63, 2**64 - 1])
def test_a_record_of_a_lying_length_is_refused(recording: bytes, tmp_path: Path, opcode: int, length: int) -> None:
    path = tmp_path / "liar.mcap"
    path.write_bytes(_without_end(recording) + struct.pack("<BQ", opcode, length) + bytes(100))
    with _bounded_memory():
        assert len(open_run(path)[ROBOT].sequence) == 1
        assert salvage_copy(path, tmp_path / "good.mcap").lost


@pytest.mark.parametrize("opcode", [3, 4, 12])
def test_a_flood_of_broken_records_is_passed_over_to_a_limit(
    recording: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, opcode: int
) -> None:
    monkeypatch.setattr("bench.recording.container.scanning.MOST_NOTES", 2000)
    path = tmp_path / "flood.mcap"
    path.write_bytes(_without_end(recording) + _record(opcode, b"\xff") * 3000)
    with _bounded_memory():
        run = open_run(path)
        assert len(run[ROBOT].sequence) == 1
        assert "more than 2000 records stand outside of chunks" in str(run.status)


def test_damage_is_named_part_by_part_to_a_limit(recording: bytes, tmp_path: Path) -> None:
    path = tmp_path / "flood.mcap"
    path.write_bytes(_without_end(recording) + _chunk(b"", 2**40, b"lz4") * 3000)
    with _bounded_memory():
        lost = open_run(path).status.lost
        assert lost.count("impossible lengths") == 1000
        assert "and more" in lost


def test_an_attachments_name_is_never_a_path(recording: bytes, tmp_path: Path) -> None:
    folder = tmp_path / "inner"
    folder.mkdir()
    path = folder / "named.mcap.active"
    names = ["../../outside.txt", "/tmp/outside.txt", "C:\\outside.txt", "\0", "a" * 5000]
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for name in names:
            writer.add_attachment(1, 1, name, "text/plain", b"harm")
        channel = writer.register_channel("/imu", "json", writer.register_schema("Imu", "jsonschema", b"{}"))
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    path.write_bytes(path.read_bytes()[:-9])
    before = set(tmp_path.rglob("*"))
    salvage_copy(path, folder / "good.mcap")
    salvage_in_place(path)
    assert set(tmp_path.rglob("*")) - before == {folder / "good.mcap", folder / "named.mcap"}
    for good in ("good.mcap", "named.mcap"):
        with (folder / good).open("rb") as stream:
            assert [one.name for one in make_reader(stream).iter_attachments()] == names


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"\0" * 16 + b"\xff\xff\xff\xff" + b"program.urp",
        b"\0" * 16 + b"\x0b\0\0\0program.urp" + b"\0\0\0\0" + b"\xff" * 8 + b"content",
        b"\0" * 16 + b"\x02\0\0\0\xff\xfe" + b"\0\0\0\0" + b"\0" * 12,
    ],
)
def test_an_attachment_with_lying_lengths_is_not_read(recording: bytes, tmp_path: Path, body: bytes) -> None:
    path = tmp_path / "lying.mcap"
    path.write_bytes(_without_end(recording) + _record(9, body))
    with _bounded_memory(), pytest.raises(RecordingError, match="no attachment"):
        open_run(path).read_attachment("program.urp")


def test_a_file_of_nothing_but_damage_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "damage.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + b"\xff" * (3 << 20) + b"\x03\0\0\0lz4" * 1000)
    with _bounded_memory(), pytest.raises(RecordingError):
        open_run(path)
    with _bounded_memory(), pytest.raises(RecordingError, match="could be kept"):
        salvage_copy(path, tmp_path / "good.mcap")
    assert not list(tmp_path.glob("good*"))
