"""A simulated cable that gets softer: its tables agree with the shape that is solved for each stiffness."""

import numpy as np
import pytest
from scene_watch import make_config

from bench.simulation.cable import PlaceTable
from bench.simulation.path import JointPath
from bench.simulation.program import PathProgram
from bench.simulation.scene import Scene, make_cable
from bench.simulation.wear import LEVELS, WearTable

N_CYCLES = 200
PLACES = np.array([0.0, 0.21, 0.5, 0.83])
PATH = JointPath()


@pytest.fixture(scope="module")
def config():
    plain = make_config()
    changes = {"half_stiffness_after_cycles": N_CYCLES}
    return plain.model_copy(update={"simulation": plain.simulation.model_copy(update=changes)})


@pytest.fixture(scope="module")
def scene(config):
    return Scene(config, PathProgram(path=PATH))


@pytest.mark.parametrize("cycles_driven", [0.0, 31.5, 123.0, 200.0, 5000.0])
def test_between_the_levels_the_cable_is_where_the_solved_one_is(config, scene, cycles_driven):
    solved = make_cable(config, PATH, min(cycles_driven / N_CYCLES, 1.0))
    arc_length_m = np.array(config.cable.arc_length_m)
    points = scene._true.at_many(PLACES, np.full(4, cycles_driven))[:, : len(arc_length_m)]
    np.testing.assert_allclose(points, solved.points(arc_length_m).at_many(PLACES), atol=5e-6)
    one = scene._true.at(PLACES[1], cycles_driven)[: len(arc_length_m)]
    np.testing.assert_allclose(one, points[1], atol=1e-12)
    curvature = scene.curvature(arc_length_m).at_many(PLACES, np.full(4, cycles_driven))
    np.testing.assert_allclose(curvature, solved.curvature(arc_length_m).at_many(PLACES), atol=2e-3)


def test_a_worn_cable_bends_tighter_beside_its_clamp(config, scene):
    clamp = scene.curvature(np.array([0.0]))
    new, half, worn = (abs(clamp.at(0.25, cycles)[0]) for cycles in (0, N_CYCLES / 2, N_CYCLES))
    assert new < half < worn


def test_a_cable_that_does_not_wear_is_the_same_after_any_number_of_cycles():
    table = PlaceTable(np.sin(2 * np.pi * np.linspace(0, 1, 33))[:, None])
    same = WearTable([table], 0)
    assert same.at(0.3, 1e6) == table.at(0.3)
    np.testing.assert_array_equal(same.at_many(PLACES, np.arange(4.0)), table.at_many(PLACES))
    assert LEVELS[0] == 0.0
    assert LEVELS[-1] == 1.0


def test_the_cable_goes_on_wearing_when_its_program_starts_anew():
    program = PathProgram(cycle_s=1.0, path=PATH)
    now = 0
    for granted in (3, 2):
        program.play()
        for _ in range(450):
            now += 8_000_000
            program.tick(now, granted)
        program.stop()
        program.tick(now, granted)
    motion = program.motion_at(now)
    assert (motion.cycle_count, motion.cycles_driven) == (2, 5.0)
