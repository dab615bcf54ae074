import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.simulation.path import JointPath, place_at_phase
from bench.simulation.program import PathProgram

MS = 1_000_000
START = 1_700_000_000_000_000_000
PATH = JointPath()


class Ticker:
    """Ticks a program every 2 ms and remembers the time."""

    def __init__(self, program, tick_ms=2.0):
        self.program = program
        self.now = START
        self.step = round(tick_ms * MS)
        program.tick(self.now, 0)

    def run(self, ms, granted=0, speed=1.0):
        seen = []
        for _ in range(round(ms * MS / self.step)):
            self.now += self.step
            self.program.tick(self.now, granted, speed)
            seen.append(self.program.motion_at(self.now))
        return seen


@pytest.fixture
def ticker():
    return Ticker(PathProgram("bend_test.urp", cycle_s=0.2, path=PATH))


def test_a_new_program_is_stopped_at_the_start_of_its_path(ticker):
    motion = ticker.program.motion_at(START)
    assert ticker.program.state == "STOPPED"
    assert (motion.cycle_count, motion.cycle_running, motion.phase, motion.place) == (0, 0, 0.0, 0.0)
    assert motion.q_rad == pytest.approx(PATH.at(0.0).q_rad)
    assert motion.qd_rad_s == (0.0,) * 6


def test_motion_can_be_asked_for_before_the_first_tick():
    assert PathProgram(path=PATH).motion_at(START).cycle_running == 0


def test_no_cycle_begins_without_a_grant(ticker):
    ticker.program.play()
    assert all(m.cycle_running == 0 for m in ticker.run(500, granted=0))


def test_no_cycle_begins_while_the_program_is_stopped(ticker):
    assert all(m.cycle_running == 0 for m in ticker.run(500, granted=3))


def test_each_grant_gives_one_cycle_that_is_counted_once(ticker):
    ticker.program.play()
    seen = ticker.run(400, granted=1)
    assert [m.cycle_count for m in seen][-1] == 1
    assert np.sum(np.diff([m.cycle_running for m in seen]) == 1) == 1
    seen = ticker.run(900, granted=3)
    assert [m.cycle_count for m in seen][-1] == 3
    assert np.max(np.diff([m.cycle_count for m in seen])) == 1


def test_the_program_is_seen_waiting_between_two_cycles(ticker):
    ticker.program.play()
    seen = ticker.run(700, granted=3)
    counts, running = np.array([(m.cycle_count, m.cycle_running) for m in seen]).T
    for change in np.flatnonzero(np.diff(counts)):
        assert running[change] == 1
        assert running[change + 1] == 0


def test_a_cycle_lasts_as_long_as_it_should(ticker):
    ticker.program.play()
    running = np.array([m.cycle_running for m in ticker.run(400, granted=1)])
    assert running.sum() * 2 == 200


def test_the_phase_passes_evenly_and_the_place_by_the_time_law(ticker):
    ticker.program.play()
    seen = [m for m in ticker.run(400, granted=1) if m.cycle_running]
    np.testing.assert_allclose([m.phase for m in seen], np.arange(100) / 100, atol=1e-12)
    np.testing.assert_allclose([m.place for m in seen], [place_at_phase(m.phase) for m in seen])


def test_motion_between_ticks_is_that_of_finer_ticks():
    coarse = PathProgram(cycle_s=0.2, path=PATH)
    fine = Ticker(PathProgram(cycle_s=0.2, path=PATH), tick_ms=1.0)
    coarse.play()
    fine.program.play()
    for step in range(3):
        coarse.tick(START + step * MS, 1)
        fine.now = START + step * MS
        fine.program.tick(fine.now, 1)
    for motion in fine.run(150, granted=1):
        assert coarse.motion_at(START + MS + round(motion.phase * 200) * MS) == motion
        assert motion.cycle_running == 1


def test_motion_asked_for_after_the_end_stays_at_the_end_until_the_next_tick(ticker):
    ticker.program.play()
    ticker.run(100, granted=1)
    motion = ticker.program.motion_at(ticker.now + 10**10)
    assert (motion.cycle_running, motion.cycle_count, motion.phase) == (1, 0, 1.0)
    assert motion.tcp_speed == pytest.approx((0.0,) * 6)


def test_speeds_are_the_derivatives_of_the_positions(ticker):
    ticker.program.play()
    ticker.run(80, granted=1, speed=0.7)
    before, here, after = (ticker.program.motion_at(ticker.now + d) for d in (0, MS, 2 * MS))
    q_speed = (np.array(after.q_rad) - before.q_rad) / 2e-3
    tcp_speed = (np.array(after.tcp_pose) - before.tcp_pose) / 2e-3
    np.testing.assert_allclose(here.qd_rad_s, q_speed, rtol=2e-3, atol=1e-3)
    np.testing.assert_allclose(here.tcp_speed[:3], tcp_speed[:3], rtol=2e-3, atol=1e-3)


def test_a_usual_cycle_moves_the_flange_at_a_cobots_speed():
    program = PathProgram(cycle_s=2.0, path=PATH)
    ticker = Ticker(program, tick_ms=8.0)
    program.play()
    speeds = [np.linalg.norm(m.tcp_speed[:3]) for m in ticker.run(2100, granted=1)]
    assert 0.5 < max(speeds) < 0.8


def test_a_pause_holds_the_pose_and_does_not_advance_the_path(ticker):
    ticker.program.play()
    ticker.run(100, granted=1)
    ticker.program.pause()
    held = ticker.run(300, granted=1)
    assert ticker.program.state == "PAUSED"
    assert len({m.q_rad for m in held}) == 1
    assert held[-1].qd_rad_s == (0.0,) * 6
    assert ticker.program.motion_at(ticker.now + 50 * MS) == held[-1]
    ticker.program.play()
    running = [m.cycle_running for m in ticker.run(400, granted=1)]
    assert held[-1].phase + (sum(running) - 1) * 0.01 == pytest.approx(1.0, abs=0.011)


def test_a_pause_while_waiting_keeps_the_next_cycle_from_beginning(ticker):
    ticker.program.play()
    ticker.run(20, granted=0)
    ticker.program.pause()
    assert all(m.cycle_running == 0 for m in ticker.run(300, granted=1))
    ticker.program.play()
    assert ticker.run(300, granted=1)[-1].cycle_count == 1


def test_half_the_speed_takes_twice_the_time(ticker):
    ticker.program.play()
    assert sum(m.cycle_running for m in ticker.run(600, granted=1, speed=0.5)) * 2 == 400


def test_play_after_a_pause_keeps_the_count_and_after_a_stop_restarts_it(ticker):
    ticker.program.play()
    ticker.run(300, granted=1)
    ticker.program.pause()
    ticker.run(10, granted=1)
    ticker.program.play()
    assert ticker.run(10, granted=1)[-1].cycle_count == 1
    ticker.program.stop()
    assert ticker.run(10, granted=1)[-1].cycle_count == 1
    ticker.program.play()
    assert ticker.run(10, granted=0)[-1].cycle_count == 0


def test_a_cycle_that_is_stopped_half_way_is_never_counted_and_the_robot_stays(ticker):
    ticker.program.play()
    ticker.run(100, granted=1)
    ticker.program.stop()
    seen = ticker.run(500, granted=1)
    assert {(m.cycle_count, m.cycle_running, m.place) for m in seen} == {(0, 0, seen[0].place)}
    assert 0.2 < seen[0].place < 0.8


def test_after_a_stop_half_way_the_robot_returns_without_a_jump_before_it_counts(ticker):
    ticker.program.play()
    ticker.run(80, granted=1)
    ticker.program.stop()
    ticker.run(20)
    ticker.program.play()
    seen = ticker.run(1000, granted=1)
    steps = np.abs(np.diff([m.q_rad for m in seen], axis=0)).max()
    assert steps < 0.1
    first = next(i for i, m in enumerate(seen) if m.cycle_running)
    assert seen[first].place == 0.0
    assert seen[-1].cycle_count == 1


def test_stop_and_play_between_two_ticks_is_a_restart(ticker):
    ticker.program.play()
    ticker.run(300, granted=1)
    ticker.program.stop()
    ticker.program.play()
    assert ticker.run(4, granted=0)[-1].cycle_count == 0


def test_a_pause_of_a_stopped_program_changes_nothing(ticker):
    ticker.program.pause()
    assert ticker.program.state == "STOPPED"


def test_the_dashboard_may_call_from_another_thread_at_any_time(ticker):
    program, done = ticker.program, threading.Event()

    def meddle():
        for _ in range(300):
            program.play()
            program.pause()
            program.play()
            program.stop()
        done.set()

    thread = threading.Thread(target=meddle)
    thread.start()
    granted = 0
    while not done.is_set():
        granted += 1
        ticker.run(10, granted=granted)
    thread.join()
    program.play()
    assert ticker.run(600, granted=10**6)[-1].cycle_count >= 1


@given(
    st.lists(st.tuples(st.integers(1, 60 * MS), st.floats(0.05, 1.0), st.booleans()), min_size=1, max_size=60),
)
@settings(max_examples=60, deadline=None)
def test_whatever_the_ticks_the_count_never_skips_and_the_phase_stays_in_range(ticks):
    program = PathProgram(cycle_s=0.05, path=PATH)
    program.play()
    now, count = START, 0
    for step, speed, paused in ticks:
        now += step
        program.pause() if paused else program.play()
        program.tick(now, 10, speed)
        motion = program.motion_at(now + step // 2)
        assert motion.cycle_count in (count, count + 1)
        assert 0.0 <= motion.phase <= 1.0
        count = motion.cycle_count
