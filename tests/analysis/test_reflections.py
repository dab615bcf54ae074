"""What stands still while the cable moves is left out, and never a marker of the cable."""

from dataclasses import replace

import numpy as np
import pytest
from cable_examples import ARC_LENGTH_M, Floats, Scene, make_scene, swing_cable

from bench.analysis import SortSettings, find_reflections, sort_by_chain

CABLE = SortSettings(ARC_LENGTH_M, stretch=0.02, shorten=0.25, tolerance_m=0.004)
N_FRAMES = 600


def place_beside(cable_m: Floats, marker: int, aside_m: float) -> Floats:
    """Return a still point (F, 1, 3) beside the place where a marker is in the middle of the take."""
    place = cable_m[len(cable_m) // 2, marker] + np.array([0.0, 0.0, aside_m])
    return np.broadcast_to(place, (len(cable_m), 1, 3))


def make_take(cable_m: Floats, further_m: Floats, seed: int = 1) -> Scene:
    return make_scene(np.random.default_rng(seed), cable_m, further_m, 0.05, 2e-4)


def list_lost(scene: Scene, usable: np.ndarray) -> int:
    row, marker = np.nonzero(scene.source >= 0)
    return int((~usable[scene.offsets[row] + scene.source[row, marker]]).sum())


@pytest.mark.parametrize("aside_m", [0.0, 0.008, 0.3])
def test_a_reflection_is_left_out_and_a_marker_that_passes_by_is_not(aside_m: float) -> None:
    cable_m = swing_cable(N_FRAMES)
    scene = make_take(cable_m, place_beside(cable_m, 5, aside_m))
    frames = scene.frames(np.zeros((N_FRAMES, 3)))
    found = find_reflections(frames, CABLE)
    assert found.place_m == pytest.approx(place_beside(cable_m, 5, aside_m)[:1, 0], abs=2e-4)
    shown = scene.offsets[:-1] + scene.extra_source[:, 0]
    assert found.usable[shown].mean() < 0.03
    assert list_lost(scene, found.usable) < 10
    sorted_m = [sort_by_chain(replace(frames, usable=usable), CABLE) for usable in (frames.usable, found.usable)]
    exact = [float((each.source == scene.source).all(axis=1).mean()) for each in sorted_m]
    assert exact[1] >= exact[0]
    assert exact[1] > 0.97


def test_each_of_two_reflections_is_one_place() -> None:
    cable_m = swing_cable(N_FRAMES)
    still = np.concatenate([place_beside(cable_m, 2, 0.05), place_beside(cable_m, 6, -0.04)], axis=1)
    scene = make_take(cable_m, still)
    assert len(find_reflections(scene.frames(np.zeros((N_FRAMES, 3))), CABLE).place_m) == 2


def test_while_everything_rests_nothing_is_a_reflection() -> None:
    cable_m = np.broadcast_to(swing_cable(1), (N_FRAMES, len(ARC_LENGTH_M), 3))
    scene = make_take(cable_m, place_beside(cable_m, 5, 0.05))
    found = find_reflections(scene.frames(np.zeros((N_FRAMES, 3))), CABLE)
    assert len(found.place_m) == 0
    assert found.usable.all()


def test_a_cable_that_rests_for_most_of_the_take_keeps_its_markers() -> None:
    cable_m = np.concatenate([swing_cable(150), np.broadcast_to(swing_cable(150)[-1], (450, len(ARC_LENGTH_M), 3))])
    scene = make_take(cable_m, place_beside(cable_m, 5, 0.05))
    found = find_reflections(scene.frames(np.zeros((N_FRAMES, 3))), CABLE)
    assert len(found.place_m) == 1
    assert list_lost(scene, found.usable) == 0


def test_where_the_chain_fits_nothing_all_points_stay() -> None:
    cable_m = swing_cable(N_FRAMES)
    scene = make_take(cable_m, place_beside(cable_m, 5, 0.05))
    wrong = replace(CABLE, arc_length_m=tuple(1.6 * s for s in ARC_LENGTH_M))
    assert find_reflections(scene.frames(np.zeros((N_FRAMES, 3))), wrong).usable.all()
