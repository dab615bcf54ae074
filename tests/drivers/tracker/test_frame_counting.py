"""Gaps, late frames, duplicates and new counts."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from bench.drivers.tracker.counting import REORDER_FRAMES, FrameCounter, Place


def place_all(numbers: list[int]) -> tuple[FrameCounter, list[tuple[Place, int]]]:
    counter = FrameCounter()
    return counter, [counter.place(number, 1000 + 10 * number) for number in numbers]


def test_frames_in_order_are_all_next() -> None:
    counter, places = place_all([5, 6, 7])
    assert places == [(Place.NEXT, 0)] * 3
    assert counter.missed == 0


def test_a_gap_counts_the_frames_that_did_not_come() -> None:
    counter, places = place_all([5, 9])
    assert places[1] == (Place.NEXT, 3)
    assert counter.missed == 3


def test_a_late_frame_corrects_the_count() -> None:
    counter, places = place_all([5, 7, 6, 8])
    assert places == [(Place.NEXT, 0), (Place.NEXT, 1), (Place.LATE, -1), (Place.NEXT, 0)]
    assert counter.missed == 0


def test_a_late_frame_from_before_the_first_corrects_nothing() -> None:
    counter, places = place_all([5, 4, 6])
    assert places[1] == (Place.LATE, 0)
    assert counter.missed == 0


def test_a_frame_that_comes_twice_is_a_duplicate() -> None:
    _, places = place_all([5, 6, 6, 5])
    assert places[2:] == [(Place.DUPLICATE, 0)] * 2


def test_a_late_frame_that_comes_twice_is_a_duplicate() -> None:
    counter, places = place_all([5, 7, 6, 6])
    assert places[3] == (Place.DUPLICATE, 0)
    assert counter.missed == 0


def test_a_number_that_falls_far_back_is_a_new_count() -> None:
    counter, places = place_all([5000, 1, 2])
    assert places[1:] == [(Place.RESTART, 0), (Place.NEXT, 0)]
    assert counter.missed == 0


def test_a_number_that_falls_back_while_the_clock_goes_on_is_a_new_count() -> None:
    counter = FrameCounter()
    counter.place(50, 1000)
    assert counter.place(3, 1010) == (Place.RESTART, 0)
    assert counter.place(4, 1020) == (Place.NEXT, 0)


def test_a_jump_of_a_million_frames_keeps_little_in_memory() -> None:
    counter, places = place_all([1, 1_000_001])
    assert places[1] == (Place.NEXT, 999_999)
    assert counter.place(1_000_000 - REORDER_FRAMES + 1, 1000) == (Place.LATE, -1)
    assert counter.place(2, 1020)[0] is Place.RESTART


def test_a_number_that_goes_on_while_the_clock_begins_anew_is_a_new_count() -> None:
    counter, _ = place_all([5, 6, 7])
    assert counter.place(8, 3) == (Place.RESTART, 0)
    assert counter.place(9, 13) == (Place.NEXT, 0)


def test_a_leap_is_a_loss_only_if_the_clock_went_on_as_long() -> None:
    for ticks_per_frame, place in ((10, (Place.NEXT, 4_992)), (0.01, (Place.RESTART, 0)), (100, (Place.RESTART, 0))):
        counter, _ = place_all([5, 6, 7])
        assert counter.place(5_000, 1_070 + round(4_993 * ticks_per_frame)) == place


def test_stamps_that_fall_back_a_little_or_stand_still_are_no_new_count() -> None:
    counter, _ = place_all([5, 6, 7])
    assert [counter.place(8, 1_065), counter.place(9, 1_065), counter.place(10, 1_100)] == [(Place.NEXT, 0)] * 3


def test_after_a_silence_no_frame_is_late() -> None:
    counter, _ = place_all([105, 107])
    assert counter.place(106, 10, after_silence=True) == (Place.RESTART, 0)
    counter, _ = place_all([105, 107])
    assert counter.place(107, 2_070, after_silence=True) == (Place.DUPLICATE, 0)


@settings(deadline=None, max_examples=200)
@given(st.data())
def test_whatever_the_order_each_frame_counts_once(data: st.DataObject) -> None:
    n = data.draw(st.integers(2, 60))
    kept = data.draw(st.sets(st.integers(1, n), min_size=1))
    jitter = data.draw(st.lists(st.integers(0, 20), min_size=n, max_size=n))
    order = sorted({0} | kept, key=lambda i: (i + jitter[i - 1]) if i else -1)
    twice = [number for number in order for _ in range(1 + (number % 3 == 0))]
    counter, places = place_all(twice)
    assert counter.missed == max(order) - len(order) + 1
    assert counter.missed == sum(change for _, change in places)
    assert sum(place is not Place.DUPLICATE for place, _ in places) == len(order)
