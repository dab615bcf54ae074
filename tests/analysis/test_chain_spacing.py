"""Markers that do not sit where the configuration says are measured in the take; another cable's spacings are told."""

from dataclasses import replace

import numpy as np
import pytest
from cable_examples import ARC_LENGTH_M, Floats, Scene, bend_cable, make_scene

from bench.analysis import SortSettings, calibrate_spacing, sort_by_chain

CABLE = SortSettings(ARC_LENGTH_M, stretch=0.06, shorten=0.3, tolerance_m=0.004, length_m=ARC_LENGTH_M[-1] + 0.05)
N_FRAMES = 300


def make_take(place_m: Floats, further_m: Floats | None = None, seed: int = 1) -> tuple[Scene, Floats]:
    """Return a swinging cable with 5 % of its markers hidden, and its anchor."""
    markers = bend_cable(0.6 + 0.25 * np.cos(np.linspace(0, 20, N_FRAMES)), place_m)
    scene = make_scene(np.random.default_rng(seed), markers, further_m, 0.05, 2e-4)
    return scene, np.zeros((N_FRAMES, 3))


def test_places_that_are_off_are_measured_and_the_gates_narrowed() -> None:
    true_m = np.array(ARC_LENGTH_M) + np.random.default_rng(2).uniform(-0.004, 0.004, len(ARC_LENGTH_M))
    scene, anchor = make_take(true_m)
    found = calibrate_spacing(scene.frames(anchor), CABLE)
    assert found.places is not None
    assert np.array(found.settings.arc_length_m) == pytest.approx(true_m, abs=1e-3)
    assert found.settings.arc_length_m == tuple(found.places.arc_length_m.tolist())
    assert found.settings.tolerance_m < CABLE.tolerance_m
    assert found.settings.stretch < CABLE.stretch
    assert found.settings.length_m == CABLE.length_m


def test_a_marker_further_off_than_the_tolerance_is_named() -> None:
    true_m = np.array(ARC_LENGTH_M)
    true_m[3] += 0.009
    scene, anchor = make_take(true_m)
    (note,) = calibrate_spacing(scene.frames(anchor), CABLE).warnings
    assert "1 of 8 markers" in note
    assert "marker 3 at 0.489" in note
    assert note in sort_by_chain(scene.frames(anchor), CABLE).warnings


def test_spacings_beyond_all_gates_are_found_with_wider_ones() -> None:
    true_m = np.array(ARC_LENGTH_M) + np.array([0, 0, 0.014, 0, 0, -0.006, 0.01, 0])
    scene, anchor = make_take(true_m)
    found = sort_by_chain(scene.frames(anchor), replace(CABLE, stretch=0.02))
    assert (found.source == scene.source).all(axis=1).mean() > 0.97
    assert any("3 of 8 markers" in note for note in found.warnings)


def test_what_is_as_configured_needs_no_note() -> None:
    scene, anchor = make_take(np.array(ARC_LENGTH_M))
    assert calibrate_spacing(scene.frames(anchor), CABLE).warnings == []


@pytest.mark.parametrize("scale", [1e-3, 0.55, 1.6])
def test_spacings_of_another_cable_are_told_and_change_nothing(scale: float) -> None:
    scene, anchor = make_take(np.array(ARC_LENGTH_M))
    wrong = replace(CABLE, arc_length_m=tuple(scale * s for s in ARC_LENGTH_M))
    found = calibrate_spacing(scene.frames(anchor), wrong)
    assert found.places is None
    assert found.settings is wrong
    assert "check that marker_arc_length_m is this cable's" in found.warnings[0]


def test_a_second_cable_in_view_is_told() -> None:
    place_m = np.array(ARC_LENGTH_M)
    other = bend_cable(np.full(N_FRAMES, 0.8), place_m) + np.array([0.0, 0.0, 0.4])
    scene, anchor = make_take(place_m, other)
    found = calibrate_spacing(scene.frames(anchor), CABLE)
    assert found.places is not None
    assert any("8.0 points of each frame are left over" in note for note in found.warnings)


def test_where_nothing_can_be_measured_all_stays_as_configured() -> None:
    scene, anchor = make_take(np.array(ARC_LENGTH_M))
    frames = scene.frames(anchor)
    for short in (frames.take(np.arange(5)), replace(frames, anchor_m=None), frames.take(np.arange(0))):
        found = calibrate_spacing(short, CABLE)
        assert found.settings is CABLE
        assert found.warnings == []
    unseen = calibrate_spacing(replace(frames, usable=np.zeros(len(frames.points_m), dtype=bool)), CABLE)
    assert unseen.warnings == []


def test_spacings_that_count_from_the_other_end_are_told() -> None:
    uneven_m = np.array([0.05, 0.20, 0.27, 0.43, 0.49, 0.66, 0.72, 0.95])
    scene, anchor = make_take(uneven_m)
    length_m = 1.08
    turned = tuple((length_m - uneven_m[::-1]).tolist())
    found = sort_by_chain(scene.frames(anchor), replace(CABLE, arc_length_m=turned, length_m=length_m))
    assert any("must count from the anchor" in text for text in found.warnings)
    right = sort_by_chain(scene.frames(anchor), replace(CABLE, arc_length_m=tuple(uneven_m), length_m=length_m))
    assert right.warnings == []
