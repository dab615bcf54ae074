"""How far a cycle's shape is from the first ones: in millimetres, whatever was hidden, and fair to the first ones."""

import numpy as np
import pytest
from drifting_cables import MODE, DriftingCable, make_cable

from bench.analysis import CycleShapes, ShapeDistances, gather_shapes, measure_distances

N = 60


def reference(n_cycles: int = N, n: int = 12) -> np.ndarray:
    return np.arange(n_cycles) < n


def gather(cable: DriftingCable, trusted: np.ndarray | None = None, n_cycles: int = N) -> CycleShapes:
    trusted = np.ones(len(cable.row), dtype=bool) if trusted is None else trusted
    return gather_shapes(cable.row, n_cycles, cable.phase, cable.position_m, trusted, reference(n_cycles))


def measure(cable: DriftingCable, n_cycles: int = N) -> ShapeDistances:
    return measure_distances(gather(cable, n_cycles=n_cycles), reference(n_cycles))


@pytest.mark.parametrize("hidden", [0.0, 0.2])
def test_a_change_is_measured_in_metres(hidden: float) -> None:
    distances = measure(make_cable(np.where(np.arange(N) < 30, 0.0, 2e-3), hidden=hidden))
    expected = 2e-3 * np.sqrt(np.mean(MODE**2))
    assert np.median(distances.distance_m[30:]) == pytest.approx(expected, rel=0.02)
    assert np.median(distances.distance_m[:30]) < 3e-5


def test_motion_inside_a_bin_and_frames_at_other_phases_are_no_distance() -> None:
    """The markers go 60 mm in a phase bin; what is left is the frames' noise in the bins."""
    distances = measure(make_cable(np.zeros(N)))
    assert distances.watched_m.max() < 3e-4


def test_reference_cycles_are_no_nearer_to_the_reference_than_others() -> None:
    shares = []
    for seed in range(8):
        watched = measure(make_cable(np.zeros(N), seed=seed)).watched_m
        shares.append(watched[:12].mean() / watched[12:].mean())
    assert np.mean(shares) == pytest.approx(1.0, abs=0.02)


def test_more_hidden_markers_are_no_change() -> None:
    clear, hidden = make_cable(np.zeros(N), seed=1), make_cable(np.zeros(N), hidden=0.4, seed=2)
    late = clear.row >= 30
    position = np.where(late[:, None, None], hidden.position_m, clear.position_m)
    watched = measure(DriftingCable(clear.row, np.where(late, hidden.phase, clear.phase), position)).watched_m
    assert watched[30:].mean() == pytest.approx(watched[:30].mean(), rel=0.05)


def test_a_cycle_of_which_too_little_was_seen_has_no_distance() -> None:
    cable = make_cable(np.zeros(N))
    cable.position_m[cable.row == 20] = np.nan
    cable.position_m[(cable.row == 21) & (cable.phase > 0.3)] = np.nan
    trusted = cable.row != 22
    distances = measure_distances(gather(cable, trusted), reference())
    assert np.flatnonzero(np.isnan(distances.watched_m)).tolist() == [20, 21, 22]
    assert np.isfinite(distances.usual_m)


def test_a_cable_of_which_nothing_was_seen_has_no_distances() -> None:
    cable = make_cable(np.zeros(N), hidden=1.1)
    distances = measure(cable)
    assert np.isnan(distances.distance_m).all()
    assert np.isnan(distances.usual_m)
    nothing = gather(cable, np.zeros(len(cable.row), dtype=bool))
    assert np.isnan(nothing.offset_m).all()


def test_a_marker_that_is_never_seen_in_one_part_of_the_path_leaves_the_others() -> None:
    cable = make_cable(np.where(np.arange(N) < 30, 0.0, 2e-3))
    cable.position_m[(cable.phase > 0.4) & (cable.phase < 0.6), 2] = np.nan
    assert np.median(measure(cable).distance_m[30:]) == pytest.approx(2e-3 * np.sqrt(np.mean(MODE**2)), rel=0.05)


def test_short_cycles_have_fewer_bins() -> None:
    assert gather(make_cable(np.zeros(N), per_cycle=200)).n_bins == 20
    assert gather(make_cable(np.zeros(N), per_cycle=12)).n_bins == 3
    assert gather(make_cable(np.zeros(N), per_cycle=1)).n_bins == 1
