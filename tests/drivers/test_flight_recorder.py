from __future__ import annotations

import pytest

from bench.drivers.flight import N_PACKETS, FlightRecorder
from bench.errors import LinkLostError
from bench.timing import ManualClock


def packets_in(path):
    """Return (stamp, direction, bytes) of each packet in a file."""
    rows = [line.split(" ") for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return [(int(stamp), direction, bytes.fromhex(data)) for stamp, direction, data in rows]


def test_the_last_packets_are_written_in_order_with_their_times_and_directions(tmp_path):
    clock = ManualClock(5)
    flight = FlightRecorder("robot", clock, tmp_path / "runs" / "bend-1.2")
    for number in range(N_PACKETS + 3):
        flight.note_received(bytes([number]), number)
    flight.note_sent(b"")
    clock.advance_ns(2)
    assert flight.trace(True, b"question") == b"question"
    assert flight.trace(False, b"answer") == b"answer"
    error = flight.keep(LinkLostError("The link broke.", hint="Look at the cable."))
    path = tmp_path / "runs" / "bend-1.2.robot-packets-1.txt"
    assert error.hint == f"Look at the cable. The last {N_PACKETS} packets of the link are in {path}."
    received = [(number, "<", bytes([number])) for number in range(6, N_PACKETS + 3)]
    assert packets_in(path) == [*received, (5, ">", b""), (7, ">", b"question"), (7, "<", b"answer")]
    assert path.read_text(encoding="utf-8").startswith("# The link broke. Look at the cable.\n")


def test_no_file_is_overwritten_and_a_link_that_comes_and_goes_ends_to_make_them(tmp_path):
    (tmp_path / "x.robot-packets-2.txt").write_text("somebody's")
    flight = FlightRecorder("robot", ManualClock(), tmp_path / "x")
    flight.note_sent(b"1")
    said = [flight.write("again") for _ in range(30)]
    assert len(list(tmp_path.iterdir())) == 20
    assert said[0].endswith("x.robot-packets-1.txt.")
    assert said[1].endswith("x.robot-packets-3.txt.")
    assert said[19:] == [""] * 11
    assert (tmp_path / "x.robot-packets-2.txt").read_text() == "somebody's"


@pytest.mark.parametrize("case", ["no place", "no packet", "no folder"])
def test_without_a_file_nothing_is_promised(tmp_path, case, caplog):
    (tmp_path / "file").touch()
    stem = None if case == "no place" else tmp_path / ("file" if case == "no folder" else "") / "x"
    flight = FlightRecorder("tracker", ManualClock(), stem)
    if case != "no packet":
        flight.note_sent(b"1")
    assert flight.keep(LinkLostError("The link broke.", hint="Look.")).hint == "Look."
    assert ("cannot be written" in caplog.text) == (case == "no folder")
    assert not list(tmp_path.glob("*.txt"))
