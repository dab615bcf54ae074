"""A run file is followed while it is written: every record once, whatever part of it is there at each look."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_examples import make_frame, make_state, one_of_each, open_writer

from bench.recording import CYCLE, FRAME, POINTS, ROBOT, TOPICS, RunFollower, open_run


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    writer = open_writer(tmp_path / "a.mcap")
    for i in range(40):
        writer.put(make_frame(i, n_points=400))
        writer.put(make_state(i))
    writer.put_all(one_of_each())
    return writer.close(exit_status="success", reason="all cycles are done")


def test_each_record_comes_once_wherever_the_file_ends_at_each_look(tmp_path: Path, finished: Path) -> None:
    data, growing = finished.read_bytes(), tmp_path / "b.mcap.active"
    follower = RunFollower(tmp_path / "b.mcap")
    assert follower.read() is None
    rng, states, frames = np.random.default_rng(7), [], []
    cuts = sorted({*rng.integers(0, len(data), 60).tolist(), 1, 9, len(data)})
    for cut in cuts:
        growing.write_bytes(data[:cut])
        part = follower.read()
        if part is not None:
            states += part[ROBOT]["sequence"].tolist()
            frames += part[FRAME].frame_number.tolist()
            assert len(part[POINTS].offsets) == len(part[FRAME].frame_number) + 1
    whole = open_run(finished)
    assert states == whole[ROBOT]["sequence"].tolist()
    assert frames == whole[FRAME].frame_number.tolist()
    assert follower.is_finished


def test_the_final_name_is_followed_and_the_run_still_read_by_the_old_one(tmp_path: Path, finished: Path) -> None:
    active = tmp_path / "c.mcap.active"
    finished.rename(active)
    follower = RunFollower(active)
    part = follower.read()
    assert part is not None
    active.rename(tmp_path / "c.mcap")
    assert len(part[CYCLE].cycle_index) == len(follower.recent()[CYCLE].cycle_index) > 0
    assert follower.read() is None
    assert follower.is_finished


def test_messages_come_undecoded_and_as_an_independent_reader_has_them(finished: Path) -> None:
    from mcap.reader import make_reader

    with finished.open("rb") as stream:
        expected = [
            (channel.topic, message.log_time, message.publish_time, message.sequence, message.data)
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False)
        ]
    assert [tuple(message) for message in open_run(finished).messages(TOPICS)] == expected
