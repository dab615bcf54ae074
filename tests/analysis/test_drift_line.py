"""Where each cycle lies on the line along which the cable changes: signed, so that even wear is a straight line."""

from dataclasses import replace

import numpy as np
import pytest
from drifting_cables import MODE, N_MARKERS, DriftingCable, make_cable

from bench.analysis import describe_drift, gather_shapes, measure_along_change, measure_distances

RMS = float(np.sqrt(np.mean(MODE**2)))


def measure(cable: DriftingCable, n: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the distances (C,) and the positions on the line, both in metres."""
    reference = np.arange(n) < 10
    shapes = gather_shapes(cable.row, n, cable.phase, cable.position_m, np.ones(len(cable.row), dtype=bool), reference)
    distances = measure_distances(shapes, reference)
    found = describe_drift(distances.watched_m)
    return distances.distance_m, measure_along_change(shapes, reference, distances, found.fitted)


@pytest.mark.parametrize(("n", "jitter_m", "hidden"), [(24, 0.0, 0.0), (60, 1e-4, 0.1)])
def test_the_interval_of_even_wear_holds_the_truth(n: int, jitter_m: float, hidden: float) -> None:
    """Seeds that nothing was chosen on; of 20 at least 17, when 19 are expected."""
    held = 0
    for seed in range(500, 520):
        change_m = np.linspace(0, 1.5e-3, n) + np.random.default_rng(seed).normal(0, jitter_m, n)
        distance_m, along_m = measure(make_cable(change_m, per_cycle=40, hidden=hidden, seed=seed), n)
        assert along_m is not None
        assert np.all(along_m[:3] < 0) or jitter_m
        assert np.abs(np.abs(along_m) - distance_m)[20:].max() < 2e-4
        found = describe_drift(along_m)
        assert found.changes == []
        held += abs(found.slope - RMS * 1.5e-3 / (n - 1)) < 2 * found.slope_sigma
    assert held >= 17


def test_a_cable_that_only_scatters_more_has_no_line() -> None:
    """It is found to change, for the distances rise, but each cycle goes its own way."""
    for seed in range(5):
        cable = make_cable(np.zeros(60), seed=seed)
        way = np.random.default_rng(seed).normal(0, 1e-3, (60, N_MARKERS, 3)) * (np.arange(60) >= 30)[:, None, None]
        distance_m, along_m = measure(replace(cable, position_m=cable.position_m + way[cable.row]), 60)
        assert distance_m[30:].min() > 5e-4
        assert along_m is None


def test_a_second_change_in_another_direction_leaves_the_distances() -> None:
    cable = make_cable(np.where(np.arange(60) < 25, 0.0, 2e-3))
    cable.position_m[cable.row >= 40, :, 2] += 4e-3
    assert measure(cable, 60)[1] is None


def test_one_bad_cycle_does_not_turn_the_line() -> None:
    cable = make_cable(np.linspace(0, 2e-3, 60))
    clear = measure(cable, 60)[1]
    cable.position_m[cable.row == 30, :, 2] += 0.1
    along_m = measure(cable, 60)[1]
    assert clear is not None
    assert along_m is not None
    assert np.delete(np.abs(along_m - clear), 30).max() < 5e-5


def test_a_cycle_that_was_not_seen_where_the_cable_changes_has_no_position() -> None:
    cable = make_cable(np.where(np.arange(60) < 30, 0.0, 2e-3))
    cable.position_m[(cable.row == 40)[:, None] & (np.abs(MODE) > 1.0)] = np.nan
    along_m = measure(cable, 60)[1]
    assert along_m is not None
    assert np.flatnonzero(np.isnan(along_m)).tolist() == [40]


def test_a_reference_of_which_too_little_was_seen_leaves_the_distances() -> None:
    cable = make_cable(np.where(np.arange(60) < 30, 0.0, 2e-3))
    cable.position_m[(cable.row < 7)[:, None] & (np.abs(MODE) > 1.0)] = np.nan
    assert measure(cable, 60)[1] is None
