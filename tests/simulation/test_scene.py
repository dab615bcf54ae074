from itertools import combinations

import numpy as np
import pytest
from scene_watch import ARC_LENGTH, MS, PATH, START, Watch, make_config, make_default_cable
from scipy.spatial.transform import Rotation

from bench.config import RobotConfig
from bench.errors import ConfigError
from bench.simulation.cable import Cable
from bench.simulation.kinematics import flange_transforms
from bench.simulation.layout import Layout
from bench.simulation.path import JointPath
from bench.simulation.program import PathProgram
from bench.simulation.scene import Scene, make_cable, make_path


@pytest.fixture(scope="module")
def cable():
    return make_default_cable()


def test_the_markers_are_on_the_cable_and_the_static_one_on_the_pole(cable):
    watch = Watch(make_config(noise_mm=0.0), cable)
    exposure = watch.expose(30)[-1]
    source = watch.truth[-1][3]
    true_m = cable.points([*ARC_LENGTH, 0.0]).at(watch.place())
    assert exposure.points_m.shape == (11, 3)
    assert exposure.points_m.dtype == np.float32
    np.testing.assert_allclose(exposure.points_m[source], true_m[:10], atol=1e-6)
    (static,) = set(range(11)) - set(source.tolist())
    np.testing.assert_allclose(exposure.points_m[static], true_m[10], atol=1e-6)


def test_every_source_points_at_its_own_marker(cable):
    watch = Watch(make_config(noise_mm=0.05, miss_probability=0.2, ghost_count=3), cable)
    table = cable.points(ARC_LENGTH)
    for index, exposure in enumerate(watch.expose(200)):
        _, _, motion, source = watch.truth[index]
        found = source >= 0
        assert len(set(source[found].tolist())) == found.sum()
        distance = np.linalg.norm(exposure.points_m[source[found]] - table.at(motion.place)[found], axis=1)
        assert distance.max() < 0.0004


def test_all_points_are_unlabeled_unless_a_rigid_body_has_them(cable):
    loose = Watch(make_config(ghost_count=2), cable).expose(1)[0]
    assert set(loose.flags.tolist()) == {0x12}
    assert len(loose.flags) == 13
    assert loose.bodies == ()


def test_a_rigid_body_anchor_has_its_centre_of_gravity_on_the_pole(cable):
    watch = Watch(make_config(anchor={"kind": "rigid_body", "name": "pole"}, noise_mm=0.0), cable)
    exposure = watch.expose(3)[-1]
    labeled = exposure.flags == 0x0A
    assert sorted(exposure.ids[labeled].tolist()) == [0x10001, 0x10002, 0x10003, 0x10004]
    clamp = cable.points([0.0]).at(0.0)[0]
    np.testing.assert_allclose(exposure.points_m[labeled].mean(axis=0), clamp, atol=1e-6)
    np.testing.assert_allclose(exposure.bodies[0].position_m, clamp, atol=1e-9)
    assert len(exposure.points_m) == 14
    assert watch.scene.bodies[1][0] == "pole"


def test_a_bodys_markers_are_where_its_pose_and_its_offsets_say(cable):
    config = make_config({"kind": "rigid_body", "name": "pole"}, {"kind": "rigid_body", "name": "tool"}, noise_mm=0.0)
    watch = Watch(config, cable)
    exposure = watch.expose(40)[-1]
    assert [body.body_id for body in exposure.bodies] == [1, 2]
    for body in exposure.bodies:
        offsets = watch.scene.bodies[body.body_id][1]
        expected = Rotation.from_quat(body.quaternion_xyzw).apply(offsets) + body.position_m
        for member in range(4):
            (index,) = np.flatnonzero(exposure.ids == (body.body_id << 16 | member + 1))
            np.testing.assert_allclose(exposure.points_m[index], expected[member], atol=2e-6)


def test_a_bodys_pose_is_the_best_fit_to_its_noisy_markers(cable):
    config = make_config(flange_body="bracket", noise_mm=0.2, anchor={"kind": "rigid_body", "name": "pole"})
    watch = Watch(config, cable)
    for exposure in watch.expose(20):
        for body in exposure.bodies:
            _, offsets = watch.scene.bodies[body.body_id]
            members = [int(np.flatnonzero(exposure.ids == (body.body_id << 16 | m + 1))[0]) for m in range(4)]
            seen = exposure.points_m[members].astype(np.float64)
            turn, _ = Rotation.align_vectors(seen - seen.mean(axis=0), offsets)
            np.testing.assert_allclose(body.position_m, seen.mean(axis=0), atol=1e-6)
            off = (turn.inv() * Rotation.from_quat(body.quaternion_xyzw)).magnitude()
            assert off < 1e-4  # the noise itself turns it by some 3e-3
            left = np.linalg.norm(turn.apply(offsets) + seen.mean(axis=0) - seen, axis=1).mean()
            assert body.mean_error_m == pytest.approx(left, abs=2e-6)


def flange_in_lab(watch):
    layout, motion = watch.cable.layout, watch.truth[-1][2]
    turn = Rotation.from_matrix(layout.lab_rotation) * Rotation.from_rotvec(motion.tcp_pose[3:])
    return layout.base_to_lab(np.array(motion.tcp_pose[:3])), turn


@pytest.mark.parametrize("swings", [False, True])
def test_the_flanges_body_follows_the_tcp_pose_at_its_mount(cable, swings):
    path = JointPath(1.0, cable.layout.swing) if swings else PATH
    config = make_config(flange_body="bracket", noise_mm=0.0)
    watch = Watch(config, make_cable(config, path) if swings else cable, path)
    mount = watch.scene.facts()["flange_body"]
    assert mount["name"] == "bracket"
    assert 0.03 < np.linalg.norm(mount["shift_m"]) < 0.08
    for _ in range(12):
        (body,) = watch.expose(8)[-1].bodies
        position, turn = flange_in_lab(watch)
        np.testing.assert_allclose(body.position_m, position + turn.apply(mount["shift_m"]), atol=1e-6)
        expected = turn * Rotation.from_quat(mount["quaternion_xyzw"])
        assert (expected.inv() * Rotation.from_quat(body.quaternion_xyzw)).magnitude() < 1e-5


def test_the_body_of_the_cables_end_may_be_the_flanges(cable):
    end = {"kind": "rigid_body", "name": "tool"}
    watch = Watch(make_config(end=end, flange_body="tool", noise_mm=0.0), cable)
    (body,) = watch.expose(30)[-1].bodies
    np.testing.assert_allclose(body.position_m, flange_in_lab(watch)[0], atol=1e-6)
    assert watch.scene.facts()["flange_body"] == {
        "name": "tool",
        "shift_m": [0.0, 0.0, 0.0],
        "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0],
    }


def test_the_flanges_body_cannot_be_that_of_the_pole(cable):
    with pytest.raises(ConfigError, match="Two places have the rigid body 'pole'"):
        Watch(make_config({"kind": "rigid_body", "name": "pole"}, flange_body="pole"), cable)


def test_the_bodies_can_be_told_apart_by_the_distances_of_their_markers(cable):
    ends = {"kind": "rigid_body", "name": "pole"}, {"kind": "rigid_body", "name": "tool"}
    scene = Watch(make_config(*ends, flange_body="bracket"), cable).scene
    sides = [np.linalg.norm(a - b) for _, body in scene.bodies.values() for a, b in combinations(body, 2)]
    assert len(sides) == 18
    assert np.diff(np.sort(sides)).min() > 0.002


def test_the_facts_map_the_robots_base_to_the_lab(cable):
    facts = Watch(make_config(), cable).scene.facts()
    base = facts["base_to_lab"]
    points = np.random.default_rng(2).normal(size=(5, 3))
    ours = points @ np.reshape(base["rotation"], (3, 3)).T + base["shift_m"]
    np.testing.assert_allclose(ours, cable.layout.base_to_lab(points), atol=1e-12)
    assert facts["flange_body"] is None


def test_markers_sit_off_their_place_and_off_the_centreline_as_configured_and_stay_there(cable):
    arc_length = np.linspace(0.02, 1.18, 60).tolist()
    config = make_config(arc_length=arc_length, noise_mm=0.0, placement_sd_mm=1.0, mounting_sd_mm=2.0)
    watch = Watch(config, cable)
    facts = watch.scene.facts()
    true_arc, side, above = (np.array(facts[f"marker_{key}_m"]) for key in ("arc_length", "side", "above"))
    assert np.std(true_arc - arc_length) == pytest.approx(1e-3, rel=0.35)
    assert np.std(np.concatenate([side, above])) == pytest.approx(2e-3, rel=0.25)
    assert (np.diff(true_arc) > 0.0).all()
    on_cable = cable.points(true_arc)
    for _ in range(5):
        seen = watch.expose(15)[-1]
        off = seen.points_m[watch.truth[-1][3]] - on_cable.at(watch.place())
        np.testing.assert_allclose(np.linalg.norm(off, axis=1), np.hypot(side, above), atol=2e-5)
    elsewhere = Watch(config, cable).scene.facts()
    assert elsewhere == facts


def test_a_marker_never_changes_place_with_its_neighbour(cable):
    arc_length = np.linspace(0.02, 1.18, 60).tolist()
    scene = Watch(make_config(arc_length=arc_length, placement_sd_mm=20.0), cable).scene
    true_arc = scene.facts()["marker_arc_length_m"]
    assert (np.diff(true_arc) > 0.003).all()
    assert true_arc[0] > 0.0
    assert true_arc[-1] < 1.2


def test_a_program_called_calibrate_swings_the_cables_plane():
    robot = {"kind": "ur", "host": "127.0.0.21", "program": "calibrate.urp"}
    config = make_config().model_copy(update={"robot": RobotConfig(**robot)})
    assert make_path(config).swing is not None
    bend_test = make_config().model_copy(update={"robot": RobotConfig(**robot | {"program": "bend_test.urp"})})
    assert make_path(bend_test).swing is None
    assert make_path(make_config()).swing is None


def test_the_end_body_rides_on_the_flange(cable):
    watch = Watch(make_config(end={"kind": "rigid_body", "name": "tool"}, noise_mm=0.0), cable)
    positions = []
    for _ in range(5):
        (body,) = watch.expose(10)[-1].bodies
        motion = watch.truth[-1][2]
        flange = flange_transforms(np.array(motion.q_rad))[:3, 3]
        np.testing.assert_allclose(body.position_m, cable.layout.base_to_lab(flange), atol=1e-5)
        positions.append(body.position_m)
    assert np.ptp(positions, axis=0).max() > 0.02


def test_without_an_anchor_only_the_cables_markers_are_seen(cable):
    assert len(Watch(make_config({"kind": "none"}), cable).expose(1)[0].points_m) == 10


def test_the_same_seed_gives_the_same_frames_and_another_one_others(cable):
    settings = {"miss_probability": 0.1, "ghost_count": 2}
    first, second = (Watch(make_config(seed=5, **settings), cable).expose(50) for _ in range(2))
    other = Watch(make_config(seed=6, **settings), cable).expose(50)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.points_m, b.points_m)
        np.testing.assert_array_equal(a.ids, b.ids)
    assert [e.points_m.tolist() for e in first] != [e.points_m.tolist() for e in other]


def test_noise_has_the_configured_standard_deviation(cable):
    watch = Watch(make_config(noise_mm=0.3), cable)
    table = cable.points(ARC_LENGTH)
    seen = zip(watch.expose(200), watch.truth, strict=True)
    errors = [e.points_m[row[3]] - table.at(row[2].place) for e, row in seen]
    np.testing.assert_allclose(np.std(errors, axis=(0, 1)), 3e-4, rtol=0.05)


def test_the_truth_gives_frame_time_and_motion_of_each_exposure(cable):
    watch = Watch(make_config(), cable)
    watch.expose(5)
    assert [row[0] for row in watch.truth] == [1000, 1001, 1002, 1003, 1004]
    assert watch.truth[2][1] == START + 33 * MS
    assert watch.truth[4][2] == watch.program.motion_at(START + 53 * MS)


def test_a_scene_solves_its_own_cable():
    config = make_config()
    scene = Scene(config, PathProgram(path=PATH))
    assert isinstance(scene.cable, Cable)
    assert scene.cable.layout == Layout(1.2)


def test_a_static_end_on_a_moving_flange_is_refused(cable):
    with pytest.raises(ConfigError, match="moves with the robot"):
        Watch(make_config(end={"kind": "static_marker"}), cable)


def test_two_bodies_with_one_name_are_refused(cable):
    with pytest.raises(ConfigError, match="Two places have the rigid body 'pole'"):
        Watch(make_config({"kind": "rigid_body", "name": "pole"}, {"kind": "rigid_body", "name": "pole"}), cable)


def test_a_marker_on_the_static_one_is_refused(cable):
    with pytest.raises(ConfigError, match="lies on the pole's static marker"):
        Watch(make_config(arc_length=[0.0, 0.1, 0.2]), cable)
