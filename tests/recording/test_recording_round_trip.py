from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_examples import (
    clock_samples,
    cycle_events,
    log_entries,
    make_frame,
    make_state,
    one_of_each,
    records,
    robot_states,
    state_changes,
    tracker_frames,
    write_run,
)

from bench.model import Record, TrackerFrame
from bench.recording import BODIES, CLOCK, CYCLE, FRAME, LOG, POINTS, ROBOT, STATE, Columns, Run, open_run

JAVASCRIPT = Path(__file__).parent / "javascript"
_MODERATE = settings(max_examples=25, deadline=None)


def _round_trip(some: Iterable[Record]) -> Run:
    with tempfile.TemporaryDirectory() as folder:
        run = open_run(write_run(Path(folder) / "run.mcap", some))
        run.load(run.topics)
        run.load([POINTS, BODIES])
        return run


def _assert_fields_equal(columns: Columns, some: list[Any]) -> None:
    for name in type(some[0]).__dataclass_fields__:
        expected = np.array([getattr(record, name) for record in some], columns[name].dtype)
        np.testing.assert_array_equal(columns[name], expected, err_msg=name)


@_MODERATE
@given(st.lists(robot_states, min_size=1, max_size=5))
def test_robot_states_come_back_bit_by_bit(states: list[Any]) -> None:
    columns = _round_trip(states)[ROBOT]
    _assert_fields_equal(columns, states)
    assert columns.q_rad.shape == (len(states), 6)
    assert columns.log_time_ns.tolist() == [max(s.arrival_ns, 0) for s in states]
    assert columns.publish_time_ns.tolist() == [max(s.capture_ns, 0) for s in states]


@_MODERATE
@given(st.lists(tracker_frames(), min_size=1, max_size=6))
def test_tracker_frames_come_back_bit_by_bit(frames: list[TrackerFrame]) -> None:
    run = _round_trip(frames)
    points, bodies = run[POINTS], run[BODIES]
    for name in ("arrival_ns", "capture_ns", "frame_number", "device_ticks", "stamp", "segment"):
        assert points[name].tolist() == run[FRAME][name].tolist() == [int(getattr(f, name)) for f in frames]
    for i, frame in enumerate(frames):
        mine = slice(points.offsets[i], points.offsets[i + 1])
        assert points.points_m[mine].tobytes() == frame.points_m.tobytes()
        assert points.residual_m[mine].tobytes() == frame.residual_m.tobytes()
        np.testing.assert_array_equal(points.ids[mine], frame.ids)
        np.testing.assert_array_equal(points.flags[mine], frame.flags)
        theirs = slice(bodies.offsets[i], bodies.offsets[i + 1])
        assert bodies.body_id[theirs].tolist() == [b.body_id for b in frame.bodies]
        assert (bodies.frame_index[theirs] == i).all()
        assert bodies.tracking_valid[theirs].tolist() == [b.tracking_valid for b in frame.bodies]
        np.testing.assert_array_equal(
            bodies.position_m[theirs].ravel(), [x for b in frame.bodies for x in b.position_m]
        )
        np.testing.assert_array_equal(bodies.mean_error_m[theirs], [b.mean_error_m for b in frame.bodies])


@_MODERATE
@given(st.lists(clock_samples, min_size=1, max_size=5), st.lists(cycle_events, min_size=1, max_size=5))
def test_clock_samples_and_cycle_events_come_back(samples: list[Any], events: list[Any]) -> None:
    run = _round_trip([*samples, *events])
    _assert_fields_equal(run[CLOCK], samples)
    _assert_fields_equal(run[CYCLE], events)


@_MODERATE
@given(st.lists(state_changes, min_size=1, max_size=5), st.lists(log_entries, min_size=1, max_size=5))
def test_texts_come_back(changes: list[Any], entries: list[Any]) -> None:
    run = _round_trip([*changes, *entries])
    _assert_fields_equal(run[STATE], changes)
    _assert_fields_equal(run[LOG], entries)


@_MODERATE
@given(st.lists(records, max_size=12))
def test_any_mixture_adds_up(some: list[Any]) -> None:
    run = _round_trip(some)
    assert run.status.complete
    frames = [record for record in some if isinstance(record, TrackerFrame)]
    assert run.topics.get(POINTS, 0) == run.topics.get(FRAME, 0) == len(frames)
    assert len(run[BODIES].body_id) == sum(len(frame.bodies) for frame in frames)
    for topic, total in run.totals.items():
        assert total.received == total.written == run.topics.get(topic, 0)
        assert total.dropped == 0


def test_a_run_without_records_has_empty_columns_of_the_right_kind(tmp_path: Path) -> None:
    run = open_run(write_run(tmp_path / "empty.mcap", []))
    assert run.topics == {}
    assert run[ROBOT].q_rad.shape == (0, 6)
    assert run[POINTS].points_m.shape == (0, 3)
    assert run[POINTS].offsets.tolist() == [0]
    assert run[BODIES].quaternion_xyzw.shape == (0, 4)
    assert run[LOG].text.tolist() == []


def test_a_frame_without_points_keeps_its_place(tmp_path: Path) -> None:
    frames = [make_frame(0, 2), make_frame(1, 0), make_frame(2, 3)]
    assert open_run(write_run(tmp_path / "run.mcap", frames))[POINTS].offsets.tolist() == [0, 2, 2, 5]


def test_many_chunks_are_put_together_in_order(tmp_path: Path) -> None:
    frames = [make_frame(i, n_points=300, n_bodies=3) for i in range(400)]
    run = open_run(write_run(tmp_path / "run.mcap", [r for i, f in enumerate(frames) for r in (f, make_state(i))]))
    assert run[POINTS].points_m.tobytes() == b"".join(f.points_m.tobytes() for f in frames)
    assert run[ROBOT].sequence.tolist() == list(range(400))
    assert run[BODIES].frame_index.tolist() == [i for i in range(400) for _ in range(3)]


def test_columns_can_be_had_by_name_and_as_attributes(tmp_path: Path) -> None:
    columns = open_run(write_run(tmp_path / "run.mcap", one_of_each()))[ROBOT]
    assert columns.q_rad is columns["q_rad"]
    assert "q_rad" in dir(columns)
    assert "q_rad float64[1, 6]" in repr(columns)
    assert getattr(columns, "nonsense", None) is None
