"""The transform between paired points, whatever a minority of wrong pairs says."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bench.analysis import fit_rigid
from bench.errors import AnalysisError


def make_pairs(rng: np.random.Generator, n: int = 60, noise_m: float = 2e-4):
    turn, shift = Rotation.random(rng=rng), rng.normal(size=3)
    source = rng.uniform(-0.5, 0.5, (n, 3))
    return turn, shift, source, turn.apply(source) + shift + rng.normal(scale=noise_m, size=(n, 3))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_a_third_of_wrong_pairs_does_not_move_the_transform(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, shift, source, target = make_pairs(rng)
    target[:20] = rng.uniform(-3, 3, (20, 3))
    found = fit_rigid(source, target)
    assert not found.used[:20].any()
    assert found.used[20:].mean() > 0.9
    assert np.abs(found.transform.apply(source) - turn.apply(source) - shift).max() < 1e-3


def test_the_covariance_is_honest() -> None:
    scores = []
    for seed in range(60):
        turn, shift, source, target = make_pairs(np.random.default_rng(seed), n=30)
        found = fit_rigid(source, target)
        away = (turn * Rotation.from_matrix(found.transform.rotation).inv()).as_rotvec()
        scores.append(np.concatenate([away, shift - found.transform.shift_m]) / np.sqrt(np.diag(found.covariance)))
    assert 0.75 < np.mean(np.square(scores)) < 1.3


def test_pairs_count_by_their_weight_and_unknown_ones_not_at_all() -> None:
    rng = np.random.default_rng(1)
    turn, shift, source, target = make_pairs(rng)
    target[:30] += rng.normal(scale=5e-3, size=(30, 3))
    target[59] = np.nan
    weight = np.where(np.arange(60) < 30, 1e-4, 1.0)
    found = fit_rigid(source, target, weight)
    assert np.abs(found.transform.apply(source) - turn.apply(source) - shift).max() < 5e-4
    assert np.isnan(found.residual_m[59])
    assert not found.used[59]


def test_points_without_noise_give_the_transform_to_rounding() -> None:
    _turn, _shift, source, target = make_pairs(np.random.default_rng(2), noise_m=0.0)
    found = fit_rigid(source, target)
    assert found.used.all()
    assert np.abs(found.transform.apply(source) - target).max() < 1e-12


@pytest.mark.parametrize("directions", [1, 0])
def test_points_on_a_line_or_in_one_place_are_refused(directions: int) -> None:
    rng = np.random.default_rng(3)
    source = rng.uniform(-0.5, 0.5, (50, 1)) * directions * np.array([1.0, 2.0, 3.0]) + 0.2
    with pytest.raises(AnalysisError, match="three directions"):
        fit_rigid(source, source + rng.normal(scale=1e-4, size=(50, 3)))


def test_two_pairs_are_refused() -> None:
    with pytest.raises(AnalysisError, match="2 pairs of points"):
        fit_rigid(np.eye(3)[:2], np.eye(3)[:2])
