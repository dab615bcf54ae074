"""Exchanged markers fold the chain back; no cable does."""

import numpy as np
from curve_examples import make_circle, make_rods

from bench.analysis import find_folds
from bench.analysis.kernels.folding import find_sharpest_turns


def test_exchanged_neighbours_are_a_fold_and_sharply_bent_cables_are_none() -> None:
    assert not find_folds(make_rods(0.005, 6).markers_m).any()
    for known in (make_rods(0.005, 10), make_rods(0.1, 16), make_circle()):
        assert not find_folds(known.markers_m).any()
        exchanged = known.markers_m.copy()
        exchanged[:, [2, 3]] = exchanged[:, [3, 2]]
        assert find_folds(exchanged).all()


def test_hidden_markers_are_passed_over_and_too_few_tell_nothing() -> None:
    known = make_circle()
    markers = np.repeat(known.markers_m, 4, axis=0)
    markers[0, 3] = np.nan
    markers[1, 2:] = np.nan
    markers[2, [2, 4]] = markers[2, [4, 2]]
    markers[2, 3] = np.nan
    markers[3, 4] = markers[3, 5]
    assert find_folds(markers).tolist() == [False, False, True, False]
    assert find_folds(markers[:0]).shape == (0,)


def test_plain_python_and_the_compiled_kernel_agree() -> None:
    markers = np.random.default_rng(401).normal(size=(5, 6, 3)).astype(np.float32)
    markers[1, 2], markers[2], markers[3, 1] = np.nan, np.nan, markers[3, 0]
    turns = np.zeros((2, 5))
    find_sharpest_turns(markers, turns[0])
    find_sharpest_turns.py_func(markers, turns[1])
    assert np.allclose(*turns)
    assert turns[0, 2] == 0.0
