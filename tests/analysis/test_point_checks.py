"""Points that are none, points listed twice, and lengths in another unit are told before anything is sorted."""

import numpy as np
import pytest
from cable_examples import ARC_LENGTH_M, make_scene, swing_cable

from bench.analysis import check_points
from bench.errors import AnalysisError


def make_points() -> tuple[np.ndarray, np.ndarray]:
    scene = make_scene(np.random.default_rng(3), swing_cable(30), miss_probability=0.1, noise_m=2e-4)
    return scene.points_m, scene.offsets


def test_good_points_are_all_kept_without_a_word() -> None:
    points, offsets = make_points()
    found = check_points(points, offsets, ARC_LENGTH_M)
    assert found.good.all()
    assert found.warnings == []


def test_points_without_a_place_are_left_out_and_counted() -> None:
    points, offsets = make_points()
    points[offsets[4]] = np.nan
    points[offsets[4] + 1, 2] = np.inf
    points[offsets[9]] = -np.inf
    found = check_points(points, offsets, ARC_LENGTH_M)
    assert np.flatnonzero(~found.good).tolist() == [offsets[4], offsets[4] + 1, offsets[9]]
    assert found.warnings == [
        "3 points in 2 frames have no finite place, first in frame 4 of the recording: they are left out."
    ]


def test_of_points_listed_twice_the_first_is_kept() -> None:
    points, offsets = make_points()
    points[offsets[7] + 2] = points[offsets[7]]
    points[offsets[8]] = points[offsets[7]]  # of another frame: not the same
    found = check_points(points, offsets, ARC_LENGTH_M)
    assert np.flatnonzero(~found.good).tolist() == [offsets[7] + 2]
    assert "1 points in 1 frames are listed twice" in found.warnings[0]


@pytest.mark.parametrize("factor", [1000.0, 1e-3])
def test_lengths_in_another_unit_are_refused_with_the_factor(factor: float) -> None:
    points, offsets = make_points()
    with pytest.raises(AnalysisError, match=r"(9|1\d)\d\d times apart"):
        check_points((points * factor).astype(np.float32), offsets, ARC_LENGTH_M)


def test_empty_takes_and_single_points_have_no_unit() -> None:
    none = np.zeros((0, 3), dtype=np.float32)
    assert check_points(none, np.zeros(3, dtype=np.int64), ARC_LENGTH_M).warnings == []
    assert check_points(np.ones((1, 3), dtype=np.float32), np.array([0, 1, 1]), ARC_LENGTH_M).good.tolist() == [True]
