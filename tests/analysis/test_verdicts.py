"""Gaps are found in the sequence, and every cycle gets its verdict with the reasons."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_examples import PERIOD_NS, T0_NS, from_lists, make_robot

from bench.analysis import Gaps, find_cycles, find_gaps, judge_cycles
from bench.model import Verdict

NO_GAPS = find_gaps(np.arange(3), np.zeros(3, dtype=np.int64), T0_NS + np.arange(3))


def frames_over(table) -> np.ndarray:
    return np.arange(int(table.start_ns[0]) - 5_000_000, int(table.end_ns[-1]) + 5_000_000, 5_000_000)


@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
@settings(max_examples=40, deadline=None)
def test_every_missing_record_is_counted_whatever_the_step_of_the_sequence(seed: int, step: int) -> None:
    rng = np.random.default_rng(seed)
    kept = np.sort(rng.permutation(400)[:380])
    gaps = find_gaps(7 + kept * step, np.zeros(380, dtype=np.int64), kept * 10)
    inside = kept[-1] - kept[0] + 1 - 380
    assert gaps.total == inside
    assert np.all(gaps.end_ns - gaps.start_ns == (gaps.n_missed + 1) * 10)


def test_a_new_segment_is_a_gap_of_unknown_size() -> None:
    gaps = find_gaps(np.array([5, 6, 7, 1, 2]), np.array([0, 0, 0, 1, 1]), np.arange(5) * 10)
    assert (gaps.start_ns.tolist(), gaps.end_ns.tolist(), gaps.total) == ([20], [30], 0)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_a_gap_touches_the_intervals_it_overlaps_and_no_others(seed: int) -> None:
    rng = np.random.default_rng(seed)
    edges = np.sort(rng.integers(0, 1_000, 20)).reshape(10, 2)
    gaps = Gaps(edges[::2, 0], edges[::2, 1], np.ones(5, dtype=np.int64))
    start = rng.integers(0, 1_000, 30)
    end = start + rng.integers(1, 100, 30)
    overlaps = ((gaps.start_ns < end[:, None]) & (gaps.end_ns > start[:, None])).any(axis=1)
    assert gaps.touch(start, end).tolist() == overlaps.tolist()


def test_cycles_without_a_fault_are_ok() -> None:
    table = find_cycles(make_robot(4))
    judged = judge_cycles(table, frames_over(table), NO_GAPS, NO_GAPS, 1.1)
    assert judged.verdict == [Verdict.OK] * 4
    assert judged.reasons == {}


def test_each_fault_has_its_verdict_and_the_gravest_wins() -> None:
    count = [0] * 5 + [0] * 50 + [1] * 50 + [2] * 80 + [3] * 50 + [4] * 20
    running = [0] * 5 + [1] * 50 + [1] * 50 + [1] * 80 + [1] * 50 + [1] * 15 + [0] * 5
    table = find_cycles(from_lists(count, running))
    at = T0_NS + 80 * PERIOD_NS
    gap = Gaps(np.array([at]), np.array([at + PERIOD_NS]), np.array([1]))
    late = T0_NS + 240 * PERIOD_NS
    robot_gap = Gaps(np.array([late]), np.array([late + PERIOD_NS]), np.array([1]))
    judged = judge_cycles(table, frames_over(table), gap, robot_gap, 1.1)
    assert judged.verdict == [Verdict.OK, Verdict.GAP, Verdict.SLOW, Verdict.OK, Verdict.INTERRUPTED]
    assert judged.reasons[1] == ["tracker frames are missing"]
    assert "1.1 times" in judged.reasons[2][0]
    assert judged.reasons[4] == ["was not completed", "robot samples are missing"]


def test_a_cycle_that_was_slow_on_purpose_says_so_and_only_where_it_was_slow() -> None:
    table = find_cycles(from_lists([0] * 155 + [1] * 50 + [2] * 50 + [3] * 5, [0] * 5 + [1] * 250 + [0] * 5))
    words = {0: "driven slowly", 1: "driven slowly"}
    judged = judge_cycles(table, frames_over(table), NO_GAPS, NO_GAPS, 1.1, slowed=words)
    assert judged.verdict == [Verdict.SLOW, Verdict.OK, Verdict.OK]
    assert judged.reasons.keys() == {0}
    assert judged.reasons[0][-1] == "driven slowly"


def test_cycles_that_the_frames_do_not_cover_are_gaps() -> None:
    table = find_cycles(make_robot(3))
    frames = frames_over(table)
    early = judge_cycles(table, frames[frames < table.end_ns[1]], NO_GAPS, None, 1.1)
    assert early.verdict == [Verdict.OK, Verdict.OK, Verdict.GAP]
    none = judge_cycles(table, frames[:0], NO_GAPS, None, 1.1)
    assert none.verdict == [Verdict.GAP] * 3


def test_a_cycle_in_which_the_robot_was_stopped_is_interrupted_though_it_was_driven_to_its_end() -> None:
    table = find_cycles(make_robot(4))
    judged = judge_cycles(table, frames_over(table), NO_GAPS, NO_GAPS, 1.1, {2: "Protective stop in cycle 2."})
    assert judged.verdict == [Verdict.OK, Verdict.OK, Verdict.INTERRUPTED, Verdict.OK]
    assert judged.reasons[2] == ["was interrupted, and driven to its end later", "Protective stop in cycle 2"]
