import numpy as np
import pytest

from bench.errors import ConfigError
from bench.simulation.cable import Cable, PlaceTable
from bench.simulation.kinematics import flange_transforms
from bench.simulation.layout import Layout
from bench.simulation.path import JointPath

PLACES = np.random.default_rng(7).random(40)


def make_cable(length_m=1.2, stiffness=0.02, anchor=None):
    layout = Layout(length_m, anchor)
    return Cable(layout, JointPath(layout.path_amplitude), weight_n_per_m=1.5, stiffness_nm2=stiffness)


@pytest.fixture(scope="module")
def cable():
    return make_cable()


def flange_in_lab(cable, place):
    transform = flange_transforms(np.array(cable.path.at(place).q_rad))
    return cable.layout.base_to_lab(transform[:3, 3]), cable.layout.lab_rotation @ transform[:3, :3]


@pytest.mark.parametrize(("length_m", "stiffness"), [(0.6, 0.02), (1.2, 0.005), (1.2, 0.02), (2.0, 0.1), (3.0, 0.02)])
def test_at_every_place_the_cable_ends_on_the_flange(length_m, stiffness):
    cable = make_cable(length_m, stiffness)
    table = cable.points([0.0, cable.length_m])
    for place in PLACES:
        pole, end = table.at(place)
        np.testing.assert_allclose(end, flange_in_lab(cable, place)[0], atol=1e-5)
        np.testing.assert_allclose(pole, cable.layout.plane_to_lab(np.array(cable.layout.pole_in_plane_m)), atol=1e-9)


def test_a_cable_whose_plane_swings_is_held_by_the_flange_in_space():
    layout = Layout(1.2)
    cable = Cable(layout, JointPath(1.0, layout.swing), weight_n_per_m=1.5, stiffness_nm2=0.02)
    table = cable.points([0.0, cable.length_m - 0.001, cable.length_m])
    ends = []
    for place in PLACES:
        pole, before, end = table.at(place)
        position, turn = flange_in_lab(cable, place)
        np.testing.assert_allclose(end, position, atol=2e-6)
        np.testing.assert_allclose(pole, layout.plane_to_lab(np.array(layout.pole_in_plane_m)), atol=1e-9)
        assert (end - before) @ turn[:, 2] == pytest.approx(-np.linalg.norm(end - before), rel=1e-4)
        ends.append(end)
    assert np.linalg.svd(ends - np.mean(ends, axis=0))[1].min() / np.sqrt(len(PLACES)) > 0.03


def test_the_axes_across_the_cable_are_normal_to_it_and_to_each_other(cable):
    arc_length = np.array([0.0, 0.3, 0.9, 1.2])
    side, above = (np.asarray(axis[5]) for axis in cable.axes_along_path(arc_length))
    before, after = np.array([0.0, 0.001, 0.001, 0.001]), np.array([0.001, 0.001, 0.001, 0.0])
    tangent = cable.points_along_path(arc_length + after)[5] - cable.points_along_path(arc_length - before)[5]
    for axis in (side, above):
        np.testing.assert_allclose(np.linalg.norm(axis, axis=1), 1.0)
        assert np.abs((axis * tangent).sum(axis=1)).max() < 1e-4
    np.testing.assert_allclose((side * above).sum(axis=1), 0.0, atol=1e-12)
    assert (above @ cable.layout.up > 0.0).all()


def test_the_cable_enters_the_flange_against_the_tool_axis(cable):
    table = cable.points([cable.length_m - 0.001, cable.length_m])
    for place in PLACES[:10]:
        before, end = table.at(place)
        direction = (end - before) / np.linalg.norm(end - before)
        tool_axis = flange_in_lab(cable, place)[1][:, 2]
        assert direction @ tool_axis == pytest.approx(-1.0, abs=1e-4)


def test_the_flange_quaternions_turn_as_the_flange_does(cable):
    from scipy.spatial.transform import Rotation

    quaternions = PlaceTable(cable.flange_quaternions())
    for place in PLACES[:10]:
        turn = Rotation.from_quat(quaternions.at(place)).as_matrix()
        np.testing.assert_allclose(turn, flange_in_lab(cable, place)[1], atol=1e-5)


def test_arc_length_along_the_points_is_what_was_asked_for(cable):
    arc_length = np.linspace(0.0, cable.length_m, 1201)
    points = cable.points(arc_length).at(0.37)
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() == pytest.approx(cable.length_m, rel=3e-4)


def test_curvature_is_that_of_the_points(cable):
    h = 0.002
    middle = np.linspace(0.02, cable.length_m - 0.02, 60)
    for place in PLACES[:5]:
        a, b, c = (cable.points(middle + d).at(place) for d in (-h, 0.0, h))
        second = (a - 2 * b + c) / h**2
        np.testing.assert_allclose(np.abs(cable.curvature(middle).at(place)), np.linalg.norm(second, axis=1), atol=0.06)


def test_the_bend_radius_varies_clearly_during_the_path(cable):
    table = cable.curvature(np.linspace(0.0, cable.length_m, 301))
    smallest_mm = [1e3 / np.abs(table.at(place)).max() for place in np.linspace(0.0, 1.0, 50)]
    assert 70 < min(smallest_mm) < 120
    assert 200 < max(smallest_mm) < 300


def test_the_cable_hangs_below_its_ends_and_above_the_floor():
    cable = make_cable(3.0)
    heights = cable.points(np.linspace(0.0, 3.0, 50)).at(0.3)[:, 1]
    assert 0.2 < heights.min() < heights[0] - 0.5


def test_gravity_pulls_along_the_lab_frames_y_axis(cable):
    up = cable.layout.lab_rotation @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(up, [0.0, 1.0, 0.0], atol=1e-12)
    assert np.linalg.det(cable.layout.lab_rotation) == pytest.approx(1.0)


def test_a_configured_anchor_position_shifts_the_lab_frame():
    cable = make_cable(anchor=(0.1, 0.9, -0.3))
    np.testing.assert_allclose(cable.points([0.0]).at(0.2)[0], [0.1, 0.9, -0.3], atol=1e-9)


def test_many_places_give_what_each_of_them_gives(cable):
    table = cable.points([0.1, 0.5])
    np.testing.assert_allclose(table.at_many(PLACES), [table.at(place) for place in PLACES])


def test_the_path_ends_in_the_shape_it_began_with(cable):
    table = cable.points([0.3, 0.6, 0.9])
    np.testing.assert_allclose(table.at(1.0), table.at(0.0), atol=1e-9)


@pytest.mark.parametrize("length_m", [0.1, 20.0])
def test_a_length_beyond_the_layout_is_refused(length_m):
    with pytest.raises(ConfigError, match=r"length_m = .* does not fit the simulated bench"):
        make_cable(length_m)


def test_a_cable_without_a_stable_shape_is_refused(monkeypatch):
    monkeypatch.setattr("bench.simulation.elastica.Elastica.is_stable", lambda *_: False)
    with pytest.raises(ConfigError, match="snaps into another shape"):
        make_cable()
