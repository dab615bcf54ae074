"""Where exactly a disk is too full and a package too late: on both sides of each limit."""

from __future__ import annotations

import pytest

from bench.config import PolicyConfig
from bench.errors import DiskFullError
from bench.run.conditions import ConditionKind
from bench.run.guards import DiskGuard, LinkGuard
from bench.run.inbox import ConditionCleared, ConditionRaised, Event
from bench.timing import ManualClock

MB = 1_000_000
SECOND = 1_000_000_000


class Disk:
    """A disk guard with a disk of its own."""

    def __init__(self, free: int) -> None:
        self.free, self.written = free, 0
        self.told: list[Event] = []
        self.clock = ManualClock()
        policy = PolicyConfig(free_space_mb=200.0)
        self.guard = DiskGuard(policy, self.clock, self.told.append, lambda: self.free, lambda: self.written)

    def look(self, n_completed: int = 0, n_cycles: int = 100) -> None:
        self.clock.advance_ns(SECOND)
        self.guard.poll(n_completed, n_cycles)


@pytest.mark.parametrize(("free", "is_told"), [(200 * MB, False), (200 * MB - 1, True)])
def test_the_reserve_is_the_limit_to_the_byte(free: int, is_told: bool) -> None:
    disk = Disk(free)
    disk.look()
    assert bool(disk.told) is is_told


@pytest.mark.parametrize(("free", "is_told"), [(290 * MB, False), (290 * MB - 1, True)])
def test_what_the_rest_of_the_run_will_take_is_foretold_without_the_first_cycle(free: int, is_told: bool) -> None:
    disk = Disk(10_000 * MB)
    disk.look()
    disk.written = 5 * MB
    disk.look(n_completed=1)  # it may have been driven slowly
    disk.free, disk.written = free, 14 * MB
    disk.look(n_completed=10)  # 1 MB a cycle: the other 90 take 90 MB
    assert bool(disk.told) is is_told


def test_what_is_told_of_a_disk_names_limit_and_value_and_is_taken_back() -> None:
    disk = Disk(150 * MB)
    disk.look(n_completed=1)
    [raised] = disk.told
    assert isinstance(raised, ConditionRaised)
    error = raised.condition.to_error()
    assert isinstance(error, DiskFullError)
    assert str(error) == (
        "The disk has 150 MB free; 200 MB are needed for the other 99 cycles and a reserve of 200 MB. "
        "Free some space on the disk of the run file."
    )
    disk.free = 300 * MB
    disk.look(n_completed=1)
    assert disk.told[1:] == [ConditionCleared(ConditionKind.DISK_LOW)]


def lags(lag_ms: list[float], speed: float = 1.0) -> list[Event]:
    """Return what is told of packages, 100 a second, with these lags."""
    told: list[Event] = []
    clock = ManualClock()
    clock.speed = speed
    guard = LinkGuard(PolicyConfig(clock_residual_ms=250.0), clock, told.append)
    for number, lag in enumerate(lag_ms):
        guard.update_lag(round(lag * 1e6), number * SECOND // 100)
    return told


@pytest.mark.parametrize(("lag_ms", "is_told"), [(250.0, False), (250.1, True)])
def test_packages_may_be_as_late_as_the_policy_says(lag_ms: float, is_told: bool) -> None:
    assert bool(lags([lag_ms] * 120)) is is_told


def test_one_package_in_time_within_a_second_is_enough() -> None:
    assert lags(([400.0] * 99 + [1.0]) * 5) == []


def test_late_packages_are_told_once_and_taken_back_when_they_come_in_time() -> None:
    raised, cleared = lags([400.0] * 320 + [1.0] * 220)
    assert isinstance(raised, ConditionRaised)
    assert raised.condition.text == "The robot's packages come 400 ms late, more than 250 ms."
    assert cleared == ConditionCleared(ConditionKind.CLOCK_RESIDUAL)


def test_at_a_speed_late_packages_are_this_machines() -> None:
    assert lags([4000.0] * 500, speed=4.0) == []
