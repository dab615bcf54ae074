import threading

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.simulation.device_clock import DeviceClock
from bench.simulation.scheduler import Scheduler
from bench.timing import ManualClock, RunClock

START = 1_700_000_000_000_000_000


def run_all(scheduler, clock, until_ns):
    scheduler.call_at(until_ns, lambda _: scheduler.stop())
    scheduler.run()


@given(st.lists(st.integers(0, 10**9), max_size=30))
@settings(max_examples=50, deadline=None)
def test_actions_run_in_the_order_in_which_they_are_due(delays):
    clock = ManualClock(START)
    scheduler, ran = Scheduler(clock), []
    for delay in delays:
        scheduler.call_at(START + delay, ran.append)
    run_all(scheduler, clock, START + 10**9 + 1)
    assert ran == sorted(START + delay for delay in delays)


def test_actions_that_are_due_together_run_in_the_order_in_which_they_were_asked_for():
    clock = ManualClock(START)
    scheduler, ran = Scheduler(clock), []
    for name in "abcde":
        scheduler.call_at(START + 5, lambda _, name=name: ran.append(name))
    run_all(scheduler, clock, START + 6)
    assert "".join(ran) == "abcde"


def test_an_action_is_told_when_it_was_due_however_late_it_runs():
    clock = ManualClock(START)
    scheduler, told = Scheduler(clock), []
    scheduler.call_at(START + 1_000, told.append)
    clock.advance_ns(7_000)
    run_all(scheduler, clock, START + 8_000)
    assert told == [START + 1_000]
    assert scheduler.largest_lag_ns == 6_000


def test_a_late_machine_skips_nothing():
    clock = ManualClock(START)
    scheduler, ticks = Scheduler(clock), []

    def tick(due_ns):
        ticks.append(due_ns)
        clock.advance_ns(3_000)
        if len(ticks) < 50:
            scheduler.call_at(due_ns + 1_000, tick)
        else:
            scheduler.stop()

    scheduler.call_at(START, tick)
    scheduler.run()
    assert ticks == [START + 1_000 * i for i in range(50)]


def test_another_thread_may_ask_and_stop():
    clock = RunClock.start()
    scheduler, ran = Scheduler(clock), threading.Event()
    thread = threading.Thread(target=scheduler.run)
    thread.start()
    scheduler.call_at(clock.now_ns(), lambda _: ran.set())
    assert ran.wait(30)
    scheduler.stop()
    thread.join(30)
    assert not thread.is_alive()


def test_a_fault_in_an_action_is_not_swallowed():
    scheduler = Scheduler(ManualClock(START))
    scheduler.call_at(START, lambda _: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        scheduler.run()


@given(
    st.integers(0, 10**15),
    st.sampled_from([1e9, 3_312_787.0, 10_000_000.0]),
    st.floats(-500, 500),
    st.integers(0, 30 * 86_400 * 10**9),
)
@settings(max_examples=100, deadline=None)
def test_a_device_clock_leads_to_its_ticks_and_back(origin, frequency, ppm, elapsed_ns):
    clock = DeviceClock(START, origin, frequency, ppm)
    ticks = clock.ticks_at(START + elapsed_ns)
    assert abs(clock.host_ns_at(ticks) - START - elapsed_ns) <= 0.5e9 / frequency * 1.001 + 1


def test_a_device_clock_gains_its_drift():
    clock = DeviceClock(START, 0, 1e9, 25.0)
    assert clock.ticks_at(START + 10**12) == 10**12 + 25 * 10**6
