"""What every `TrackerStream` must do, whatever tracker is behind it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from bench.model import ClockSample, TrackerFrame

N_FRAMES = 25


def frames_of(tracker, count):
    tracker.sink.wait_for(lambda: sum(isinstance(record, TrackerFrame) for record in tracker.sink.records) >= count)
    return tracker.sink.of(TrackerFrame)[:count]


def test_it_names_itself(tracker):
    info = tracker.stream.open(tracker.sink)
    assert info.device == "tracker"
    assert info.kind
    assert info.address
    assert info.version


def test_frames_arrive_in_order_with_a_capture_before_each_arrival(tracker):
    tracker.stream.open(tracker.sink)
    frames = frames_of(tracker, N_FRAMES)
    assert all(earlier.frame_number < later.frame_number for earlier, later in pairwise(frames))
    assert all(earlier.device_ticks < later.device_ticks for earlier, later in pairwise(frames))
    assert all(earlier.arrival_ns <= later.arrival_ns for earlier, later in pairwise(frames))


def test_every_point_has_an_identifier_and_flags(tracker):
    tracker.stream.open(tracker.sink)
    for frame in frames_of(tracker, N_FRAMES):
        assert frame.points_m.shape == (len(frame.ids), 3)
        assert len(frame.flags) == len(frame.ids)
        assert np.isfinite(frame.points_m).all()


def test_its_clock_is_told_beside_ours(tracker):
    info = tracker.stream.open(tracker.sink)
    assert float(info.detail["clock_hz"]) > 0
    if info.kind == "qualisys":  # its clock cannot be asked: arrivals map it
        return
    tracker.sink.wait_for(lambda: any(isinstance(record, ClockSample) for record in tracker.sink.records))
    assert tracker.sink.of(ClockSample)[0].ticks_per_s > 0


def test_it_can_be_closed_twice_and_opened_again(tracker):
    tracker.stream.close()
    tracker.stream.open(tracker.sink)
    frames_of(tracker, 3)
    tracker.stream.close()
    tracker.stream.close()
    n_frames = len(tracker.sink.of(TrackerFrame))
    tracker.stream.open(tracker.sink)
    frames_of(tracker, n_frames + 3)
