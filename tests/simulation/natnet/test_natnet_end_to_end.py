"""The client against the simulated tracker over loopback, twenty times as fast as real time."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from natnet_bench import DRIFT_PPM, PATIENCE_S, TICKS_PER_S, SimulatedTracker, running_tracker

from bench.config import TrackerConfig
from bench.drivers.tracker import make_tracker
from bench.errors import BenchError, LinkLostError
from bench.model import ClockSample, LogEntry, Record, Severity, StampKind, TrackerFrame
from bench.timing import estimate_echo_map

HOST = "127.0.32.21"
SPEED = 20.0


class Recording:
    """Collects records until there are enough."""

    def __init__(self) -> None:
        self.frames: list[TrackerFrame] = []
        self.samples: list[ClockSample] = []
        self.log: list[LogEntry] = []
        self.missed: list[tuple[str, int]] = []
        self.loss: list[BenchError] = []
        self._changed = threading.Condition()

    def put(self, record: Record) -> None:
        with self._changed:
            if isinstance(record, TrackerFrame):
                self.frames.append(record)
            elif isinstance(record, ClockSample):
                self.samples.append(record)
            elif isinstance(record, LogEntry):
                self.log.append(record)
            self._changed.notify_all()

    def lose(self, error: BenchError) -> None:
        with self._changed:
            self.loss.append(error)
            self._changed.notify_all()

    def wait(self, *, n_frames: int = 0, n_samples: int = 0, lost: bool = False) -> None:
        with self._changed:
            enough = self._changed.wait_for(
                lambda: len(self.frames) >= n_frames and len(self.samples) >= n_samples and len(self.loss) >= lost,
                timeout=PATIENCE_S,
            )
        assert enough


def record(tracker: SimulatedTracker, *, n_frames: int = 0, n_samples: int = 0) -> Recording:
    recording = Recording()
    host, port = tracker.server.address
    client = make_tracker(
        TrackerConfig(host=host, command_port=port),
        tracker.clock,
        on_missed=lambda topic, n: recording.missed.append((topic, n)),
        on_lost=recording.lose,
    )
    info = client.open(recording.put)
    assert info.rate_hz == 100.0
    assert info.bodies == {4: "clamp"}
    try:
        recording.wait(n_frames=n_frames, n_samples=n_samples)
    finally:
        client.close()
    return recording


@pytest.fixture(scope="module")
def long_recording() -> tuple[SimulatedTracker, Recording]:
    with running_tracker(HOST, SPEED) as tracker:
        recording = record(tracker, n_frames=1000, n_samples=20)
    return tracker, recording


def test_all_frames_arrive_bit_for_bit(long_recording: tuple[SimulatedTracker, Recording]) -> None:
    tracker, recording = long_recording
    numbers = [frame.frame_number for frame in recording.frames]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert recording.missed == []
    assert tracker.server.n_unsent == 0
    for frame in recording.frames:
        shown = tracker.scene.exposures[frame.frame_number]
        assert np.array_equal(frame.points_m, shown.points_m)
        assert np.array_equal(frame.ids, shown.ids)
        assert np.array_equal(frame.flags, shown.flags)
        assert np.array_equal(frame.residual_m, shown.residual_m)
        assert frame.bodies[0].position_m == (1.0, 2.0, 3.0)
        assert frame.stamp is StampKind.MID_EXPOSURE
        assert frame.segment == 0


def test_nothing_is_worth_a_warning(long_recording: tuple[SimulatedTracker, Recording]) -> None:
    _, recording = long_recording
    # on a busy machine the kernel begins to stamp arrivals some packets late, of which the log has an information
    assert [entry for entry in recording.log if entry.severity >= Severity.WARN] == []
    assert recording.loss == []


def test_the_echoes_give_the_clocks_offset_and_drift(long_recording: tuple[SimulatedTracker, Recording]) -> None:
    tracker, recording = long_recording
    columns = [(s.send_ns, s.device_ticks, s.receive_ns) for s in recording.samples]
    send_ns, ticks, receive_ns = np.array(columns, dtype=np.int64).T
    assert {s.ticks_per_s for s in recording.samples} == {TICKS_PER_S}
    assert (receive_ns > send_ns).all()
    for asked, tick, answered in columns:
        assert asked <= tracker.tracker_clock.host_ns_at(tick) + 1000
        assert tracker.tracker_clock.host_ns_at(tick) <= answered + 1000
    found = estimate_echo_map(send_ns, ticks, receive_ns, 1e9 / TICKS_PER_S)
    middle = int(ticks[len(ticks) // 2])
    error_ns = found.to_host_ns(middle) - tracker.tracker_clock.host_ns_at(middle)
    assert abs(error_ns) <= (receive_ns - send_ns).max()
    span_ns = float(np.ptp(send_ns))
    # What the drift can be off by: the worst round trip over the span; on a quiet machine some ppm.
    assert found.drift_ppm == pytest.approx(-DRIFT_PPM, abs=float((receive_ns - send_ns).max()) / span_ns * 2e6)


def test_capture_times_follow_the_exposures(long_recording: tuple[SimulatedTracker, Recording]) -> None:
    tracker, recording = long_recording
    worst_round_trip_ns = max(s.receive_ns - s.send_ns for s in recording.samples)
    for frame in recording.frames[500:]:
        assert abs(frame.capture_ns - tracker.scene.host_ns[frame.frame_number]) <= 2 * worst_round_trip_ns


def test_a_server_that_stops_is_a_lost_link() -> None:
    with running_tracker(HOST) as tracker:
        recording = Recording()
        host, port = tracker.server.address
        client = make_tracker(TrackerConfig(host=host, command_port=port), tracker.clock, on_lost=recording.lose)
        client.open(recording.put)
        try:
            recording.wait(n_frames=5)
            tracker.server.close()
            recording.wait(lost=True)
        finally:
            client.close()
    assert isinstance(recording.loss[0], LinkLostError)
    assert recording.loss[0].exit_code == 3
    assert [entry.severity for entry in recording.log] == [Severity.ERROR]


@pytest.mark.parametrize("version", ["3.0", "3.1", "4.0", "4.2", "4.3"])
def test_every_version_is_recorded(version: str) -> None:
    with running_tracker(HOST, SPEED, natnet_version=version) as tracker:
        recording = record(tracker, n_frames=20)
        frame = recording.frames[-1]
        assert np.array_equal(frame.points_m, tracker.scene.exposures[frame.frame_number].points_m)


def test_usb_cameras_are_recorded_by_the_time_of_reception() -> None:
    with running_tracker(HOST, SPEED, usb_cameras=True) as tracker:
        recording = record(tracker, n_frames=20)
        frame = recording.frames[-1]
        assert frame.stamp is StampKind.DATA_RECEIVED
        exposed_ns = tracker.scene.host_ns[frame.frame_number]
        late_ns = tracker.tracker_clock.host_ns_at(frame.device_ticks) - exposed_ns
        assert late_ns == pytest.approx(4_600_000, abs=1_000_000)


def test_what_a_bad_network_does_to_the_frames_is_counted_to_the_frame() -> None:
    faults = {"frame_loss_probability": 0.05, "frame_duplicate_probability": 0.03, "frame_reorder_probability": 0.03}
    with running_tracker(HOST, 5.0, **faults) as tracker:
        recording = record(tracker, n_frames=600)
        delivery = tracker.server.delivery
        assert delivery.n_lost > 10
        assert delivery.n_doubled > 5
        assert delivery.n_held > 5
    numbers = [frame.frame_number for frame in recording.frames]
    assert len(set(numbers)) == len(numbers)
    assert numbers != sorted(numbers)
    assert sum(n for _, n in recording.missed) == max(numbers) - min(numbers) + 1 - len(numbers)


def test_natnet_2_is_recorded_without_the_clocks_answers() -> None:
    with running_tracker(HOST, 5.0, natnet_version="2.10") as tracker:
        recording = record(tracker, n_frames=50)
    assert recording.samples == []
    for frame in recording.frames:
        assert np.array_equal(frame.points_m, tracker.scene.exposures[frame.frame_number].points_m)
