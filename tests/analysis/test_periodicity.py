"""Cycles of a take are found where its motion repeats, and not where it does not."""

from pathlib import Path

import numpy as np
import pytest

from bench.analysis import CycleTable, find_repeated_cycles
from bench.drivers.takes.read import read_take
from bench.simulation.made_motions import HELD_OUT, Motion
from bench.simulation.made_takes import HARD, USUAL, Conditions, MadeTake, make_take

REPEATING = [motions[0] for kind, motions in HELD_OUT.items() if kind != "not repeating"]
BY_NAME = {"ids": lambda motion: motion.name}


def cycles_of(take: MadeTake, time_ns: np.ndarray | None = None) -> CycleTable | None:
    return find_repeated_cycles(take.points_m, take.offsets, take.time_ns if time_ns is None else time_ns)


def choose_frames(take: MadeTake, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points and offsets of chosen frames, each with noise of its own."""
    index = np.concatenate([np.arange(take.offsets[f], take.offsets[f + 1]) for f in frames])
    count = np.diff(take.offsets)[frames]
    noise = np.random.default_rng(1).normal(0, 3e-4, (len(index), 3))
    return (take.points_m[index] + noise).astype(np.float32), np.concatenate([[0], np.cumsum(count)])


@pytest.mark.parametrize("motion", REPEATING, **BY_NAME)
@pytest.mark.parametrize("conditions", [USUAL, HARD], ids=["usual", "hard"])
def test_every_cycle_is_found_with_its_start(motion: Motion, conditions: Conditions) -> None:
    """On motions that nothing was chosen by."""
    table = cycles_of(make_take(motion, 8.6, conditions, seed=21))
    assert table is not None
    assert table.complete.tolist() == [True] * 8 + [False]
    start = (table.start_ns - table.start_ns[0]) * 1e-9 / motion.cycle_s
    assert np.abs(start - np.arange(9)).mean() < 0.01
    assert np.abs(start - np.arange(9)).max() < 0.03
    assert (table.end_ns[:-1] == table.start_ns[1:]).all()


def test_motions_that_do_not_repeat_have_no_cycles_but_one_that_nearly_does() -> None:
    """Made of waves without a common measure; one of them is nearly all one wave."""
    found = [
        motion.name
        for motion in HELD_OUT["not repeating"]
        for n_cycles in (4.3, 12.4)
        if cycles_of(make_take(motion, n_cycles, USUAL, seed=22)) is not None
    ]
    assert found in ([], ["not repeating 151"])


def test_cycles_that_differ_in_length_have_each_its_own_start() -> None:
    motion = HELD_OUT["swing"][1]
    take = make_take(motion, 12.0, USUAL, seed=23)
    length = 1 + 0.04 * np.random.default_rng(23).uniform(-1, 1, 13)
    ends_s = motion.cycle_s * np.concatenate([[0.0], np.cumsum(length)])
    cycles = (take.time_ns - take.time_ns[0]) * 1e-9 / motion.cycle_s
    time_ns = take.time_ns[0] + (np.interp(cycles, np.arange(14), ends_s) * 1e9).astype(np.int64)
    table = cycles_of(take, time_ns)
    assert table is not None
    assert np.abs((table.start_ns - time_ns[0]) * 1e-9 - ends_s[:12]).max() < 0.025 * motion.cycle_s


def test_a_cycle_begins_where_motion_begins_after_the_rest() -> None:
    """The take begins in a rest and ends in the middle of a cycle; each cycle rests for a third of its time."""
    motion = HELD_OUT["swing"][0]
    take = make_take(motion, 6.0, Conditions(jitter_m=0.0), seed=24)
    per_cycle = motion.cycle_s * 100
    pieces = [np.full(60, round(0.3 * per_cycle))]
    for cycle in range(6):
        begin = round((cycle + 0.3) * per_cycle)
        stop = min(round((cycle + 1.3) * per_cycle), len(take.time_ns))
        pieces += [np.arange(begin, stop), np.full(round(per_cycle / 2), stop - 1)]
    frames = np.concatenate(pieces[:-1])[: -round(0.1 * per_cycle)]
    points, offsets = choose_frames(take, frames)
    table = find_repeated_cycles(points, offsets, take.time_ns[0] + 10_000_000 * np.arange(len(frames)))
    assert table is not None
    assert table.complete.tolist() == [True] * 5 + [False]
    begun_s = (table.start_ns - take.time_ns[0]) * 1e-9
    assert begun_s == pytest.approx(0.6 + 1.5 * motion.cycle_s * np.arange(6), abs=0.03 * 1.5 * motion.cycle_s)


def test_a_take_that_begins_in_motion_has_a_first_cycle_that_is_not_whole() -> None:
    motion = HELD_OUT["swing"][0]
    take = make_take(motion, 7.0, Conditions(jitter_m=0.0), seed=25)
    per_cycle = round(motion.cycle_s * 100)
    pieces = [np.arange(round(0.4 * per_cycle), per_cycle), np.full(100, per_cycle)]
    for cycle in range(1, 6):
        stop = (cycle + 1) * per_cycle
        pieces += [np.arange(cycle * per_cycle, stop), np.full(100, stop)]
    points, offsets = choose_frames(take, np.concatenate(pieces))
    table = find_repeated_cycles(points, offsets, take.time_ns[0] + 10_000_000 * np.arange(len(offsets) - 1))
    assert table is not None
    assert table.complete.tolist() == [False] + [True] * 5
    assert table.seen.tolist() == [False] + [True] * 5
    assert table.start_ns[0] == take.time_ns[0]
    usual_s = motion.cycle_s + 1.0
    assert table.duration_s == pytest.approx([0.6 * motion.cycle_s + 1.0] + [usual_s] * 5, abs=0.03 * usual_s)


@pytest.mark.parametrize("n_frames", [0, 1, 2, 40, 400])
def test_noise_frames_without_points_and_a_take_of_hardly_anything_have_no_cycles(n_frames: int) -> None:
    rng = np.random.default_rng(n_frames)
    time_ns = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(n_frames)
    offsets = 5 * np.arange(n_frames + 1)
    still = np.tile(rng.normal(size=(5, 3)), (n_frames, 1))
    noisy = still + rng.normal(0, 1e-4, still.shape)
    for points in (still, noisy, np.full_like(still, np.nan)):
        assert find_repeated_cycles(points.astype(np.float32), offsets, time_ns) is None
    assert find_repeated_cycles(np.zeros((0, 3), dtype=np.float32), 0 * offsets, time_ns) is None


def test_frames_without_points_in_between_hide_no_cycle() -> None:
    take = make_take(HELD_OUT["swing"][0], 8.0, USUAL, seed=26)
    count = np.diff(take.offsets)
    empty = (np.arange(len(count)) % 50) < 6
    kept = np.repeat(~empty, count)
    offsets = np.concatenate([[0], np.cumsum(np.where(empty, 0, count))])
    table = find_repeated_cycles(take.points_m[kept], offsets, take.time_ns)
    assert table is not None
    assert table.complete.sum() == 8


@pytest.mark.parametrize("name", ["cable_a_clean.csv", "cable_a_hard.csv"])
def test_a_real_cable_whose_motion_does_not_repeat_has_no_cycles(shared_data: Path, name: str) -> None:
    frames = list(read_take(shared_data / "cable" / name).frames)
    points = np.concatenate([frame.points_m for frame in frames])
    offsets = np.cumsum([0, *(len(frame.points_m) for frame in frames)])
    assert find_repeated_cycles(points, offsets, np.array([frame.capture_ns for frame in frames])) is None
