import numpy as np
import pytest
from scene_watch import PATH, Watch, make_config, make_default_cable

from bench.config import SimulationConfig
from bench.simulation.path import JointPath
from bench.simulation.scene import make_cable
from bench.simulation.sight import Occlusion, _distance_of_segments


@pytest.fixture(scope="module")
def cable():
    return make_default_cable()


def test_markers_are_missed_as_often_as_configured(cable):
    watch = Watch(make_config(miss_probability=0.2, anchor={"kind": "none"}), cable)
    watch.expose(500)
    hidden = np.mean([row[3] < 0 for row in watch.truth])
    assert hidden == pytest.approx(0.2, abs=0.02)


def test_the_static_marker_is_missed_too(cable):
    watch = Watch(make_config(miss_probability=0.5, arc_length=[0.1, 0.2]), cable)
    counts = {len(e.points_m) - int((row[3] >= 0).sum()) for e, row in zip(watch.expose(50), watch.truth, strict=True)}
    assert counts == {0, 1}


def test_a_frame_may_be_empty(cable):
    exposure = Watch(make_config(miss_probability=1.0), cable).expose(1)[0]
    assert exposure.points_m.shape == (0, 3)
    assert exposure.ids.shape == (0,)


def runs_of_true(hidden):
    """Return the lengths of the stretches in which each column (n, m) is True, the last unfinished ones left out."""
    edges = np.diff(np.concatenate([np.zeros((1, hidden.shape[1]), dtype=int), hidden.astype(int)]), axis=0)
    lengths = []
    for column in edges.T:
        starts, stops = np.flatnonzero(column == 1), np.flatnonzero(column == -1)
        lengths.extend((stops - starts[: len(stops)]).tolist())
    return np.array(lengths)


def test_bursts_hide_a_marker_for_5_to_50_frames_and_begin_as_often_as_configured():
    occlusion = Occlusion(SimulationConfig(burst_probability=0.002), 60, np.random.default_rng(5))
    hidden = np.array([occlusion.step() for _ in range(5000)])
    lengths = runs_of_true(hidden)
    # A second burst may begin as the first one ends; that is rare.
    assert np.mean(lengths <= 50) > 0.99
    assert lengths.min() == 5
    assert np.median(lengths) == pytest.approx(27.5, abs=2)
    n_free = np.count_nonzero(~hidden)
    assert len(lengths) / n_free == pytest.approx(0.002, rel=0.1)


def test_single_misses_and_bursts_come_beside_each_other():
    occlusion = Occlusion(
        SimulationConfig(miss_probability=0.03, burst_probability=0.001), 60, np.random.default_rng(6)
    )
    lengths = runs_of_true(np.array([occlusion.step() for _ in range(5000)]))
    assert np.count_nonzero(lengths == 1) > 10 * np.count_nonzero(lengths == 2)
    assert np.count_nonzero(lengths >= 10) > 100


def test_without_a_chance_nothing_is_hidden():
    occlusion = Occlusion(SimulationConfig(), 5, np.random.default_rng(6))
    assert not np.any([occlusion.step() for _ in range(50)])


def test_after_a_burst_a_marker_has_a_new_number(cable):
    watch = Watch(make_config(burst_probability=0.01), cable)
    numbers = {}
    for exposure, row in zip(watch.expose(300), watch.truth, strict=True):
        for marker, index in enumerate(row[3]):
            if index >= 0:
                numbers.setdefault(marker, []).append(int(exposure.ids[index]))
    assert all(sorted(set(ids)) for ids in numbers.values())
    assert sum(len(set(ids)) > 1 for ids in numbers.values()) > 5


# Behind the arm


def shadow_of(cable, n_cameras, path=PATH, **settings):
    return Watch(make_config(camera_count=n_cameras, **settings), cable, path)


def hidden_shares(watch):
    watch.expose(120)
    return np.mean([row[3] < 0 for row in watch.truth], axis=0)


def test_the_arm_hides_the_markers_near_it_and_the_more_the_fewer_cameras_there_are(cable):
    shares = [hidden_shares(shadow_of(cable, n)) for n in (2, 4, 8)]
    assert shares[0].max() > shares[1].max() > 0.05
    np.testing.assert_array_equal(shares[2], 0.0)
    assert np.argmax(shares[1]) >= 7
    for share in shares:
        np.testing.assert_array_equal(share[:4], 0.0)


def test_what_the_arm_hides_depends_on_the_place_of_the_path_alone(cable):
    watch = shadow_of(cable, 4)
    watch.expose(300)
    cycles = [{}, {}]
    for _, _, motion, source in watch.truth:
        if motion.cycle_running and motion.cycle_count < 2:
            cycles[motion.cycle_count][round(motion.place, 9)] = (source < 0).tolist()
    common = cycles[0].keys() & cycles[1].keys()
    assert len(common) > 50
    assert all(cycles[0][place] == cycles[1][place] for place in common)
    assert any(any(hidden) for hidden in cycles[0].values())


def test_a_body_behind_the_arm_is_filled_in_and_then_lost_with_its_last_pose(cable):
    watch = shadow_of(cable, 2, flange_body="bracket")
    exposures = watch.expose(200)
    n_filled, last = 0, None
    for exposure in exposures:
        (body,) = exposure.bodies
        flags = exposure.flags[(exposure.ids >> 16) == body.body_id].tolist()
        if body.tracking_valid:
            assert len(flags) == 4
            assert flags.count(0x0B) <= 1
            n_filled += 0x0B in flags
            last = body
        else:
            assert flags == []
            assert last is None or body.position_m == last.position_m
    assert n_filled > 0
    assert 10 < sum(not exposure.bodies[0].tracking_valid for exposure in exposures) < 190


def test_one_camera_is_refused():
    with pytest.raises(ValueError, match="two lines of sight"):
        make_config(camera_count=1)


def test_a_swinging_arm_casts_a_shadow_too(cable):
    path = JointPath(1.0, cable.layout.swing)
    watch = shadow_of(make_cable(make_config(), path), 3, path)
    assert hidden_shares(watch).max() > 0.05


def test_the_distance_of_segments_is_the_smallest_between_their_points():
    rng = np.random.default_rng(4)
    p, u, q, v = rng.normal(size=(4, 200, 3))
    along = np.linspace(0.0, 1.0, 201)
    a = p[:, None, None] + along[None, :, None, None] * u[:, None, None]
    b = q[:, None, None] + along[None, None, :, None] * v[:, None, None]
    brute = np.linalg.norm(a - b, axis=3).min(axis=(1, 2))
    found = _distance_of_segments(p, u, q, v)
    assert (found <= brute + 1e-9).all()
    np.testing.assert_allclose(found, brute, atol=0.02)


def test_parallel_segments_and_points_have_a_distance():
    zero, x, y = np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 2.0, 0.0])
    assert _distance_of_segments(zero, x, y, x) == pytest.approx(2.0)
    assert _distance_of_segments(zero, x, y, zero) == pytest.approx(2.0)
    assert _distance_of_segments(zero, x, 3.0 * x, x) == pytest.approx(2.0)
