"""Host time: pinned once, scaled exactly, shared as text."""

import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.errors import ConfigError
from bench.timing import ManualClock, RunClock, patience_ns

NANOSECONDS = st.integers(0, 4_000_000_000_000_000_000)
SPEEDS = st.floats(0.01, 1000.0, allow_nan=False)


@given(NANOSECONDS, NANOSECONDS, SPEEDS)
def test_a_clock_sent_as_text_is_the_same_clock(monotonic_ns: int, utc_ns: int, speed: float) -> None:
    clock = RunClock(monotonic_ns, utc_ns, speed)
    assert RunClock.from_text(clock.to_text()) == clock


@pytest.mark.parametrize("text", ["", "1:2", "1:2:3:4", "a:2:1.0", "1:2:fast"])
def test_a_text_that_is_no_clock_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="is no clock"):
        RunClock.from_text(text)


@given(NANOSECONDS, NANOSECONDS, st.lists(st.integers(0, 10**15), min_size=2, max_size=20), SPEEDS)
@settings(deadline=None)
def test_time_never_goes_back_and_passes_at_its_speed(
    monotonic_ns: int, utc_ns: int, elapsed: list[int], speed: float
) -> None:
    clock = RunClock(monotonic_ns, utc_ns, speed)
    times = [clock.at_monotonic_ns(monotonic_ns + one) for one in sorted(elapsed)]
    assert times == sorted(times)
    expected = [utc_ns + one * speed for one in sorted(elapsed)]
    assert times == pytest.approx(expected, abs=1024 + 1e-12 * max(elapsed) * speed)


@given(NANOSECONDS, NANOSECONDS, st.integers(-(10**15), 10**15))
def test_at_real_speed_not_a_nanosecond_is_rounded_away(monotonic_ns: int, utc_ns: int, elapsed: int) -> None:
    assert RunClock(monotonic_ns, utc_ns).at_monotonic_ns(monotonic_ns + elapsed) == utc_ns + elapsed


def test_a_clock_that_starts_now_says_the_machines_time() -> None:
    before = time.time_ns()
    now = RunClock.start().now_ns()
    assert before - 10**9 <= now <= time.time_ns() + 10**9


def test_waiting_ends_when_the_deadline_is_reached_and_not_before() -> None:
    clock = RunClock.start(speed=100.0)
    deadline = clock.now_ns() + 200_000_000
    clock.sleep_until_ns(deadline)
    assert clock.now_ns() >= deadline
    clock.sleep_until_ns(deadline)  # in the past: returns at once


def test_a_manual_clock_moves_when_told_and_waits_by_moving() -> None:
    clock = ManualClock(1_000)
    clock.advance_ns(5)
    assert clock.now_ns() == 1_005
    clock.sleep_until_ns(2_000)
    clock.sleep_until_ns(1_500)
    assert clock.now_ns() == 2_000


@given(st.floats(0, 1e6), SPEEDS)
def test_patience_lasts_as_long_on_the_machine_whatever_the_speed(seconds: float, speed: float) -> None:
    clock = RunClock(0, 0, speed)
    assert patience_ns(clock, seconds) / clock.speed == pytest.approx(seconds * 1e9, rel=1e-9, abs=1e3)
