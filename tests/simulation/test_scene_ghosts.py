import numpy as np
import pytest
from scene_watch import Watch, make_config, make_default_cable

from bench.simulation.ghosts import Ghosts, draw_reflections


@pytest.fixture(scope="module")
def cable():
    return make_default_cable()


def test_the_number_of_ghosts_is_constant(cable):
    counts = {len(e.points_m) for e in Watch(make_config(ghost_count=4), cable).expose(60)}
    assert counts == {15}


def test_ghosts_stand_still_for_four_frames_and_some_for_longer():
    ghosts = Ghosts(50, 0.5, np.random.default_rng(8))
    ages, lives = np.zeros(50, dtype=int), []
    for _ in range(400):
        before = ghosts.positions_m.copy()
        born = ghosts.step(np.zeros((3, 3)))
        assert set(np.flatnonzero((ghosts.positions_m != before).any(axis=1)).tolist()) == set(born.tolist())
        lives.extend(ages[born][ages[born] > 0].tolist())
        ages[born] = 0
        ages += 1
    assert (np.min(lives), np.median(lives)) == (4, 4)
    assert np.mean(np.array(lives) > 10) == pytest.approx(0.25, abs=0.02)


CABLE_M = np.array([[0.0, 1.0, 0.0], [0.1, 1.0, 0.0]])


def distances(near_share):
    ghosts = Ghosts(8000, near_share, np.random.default_rng(9))
    ghosts.step(CABLE_M)
    return np.linalg.norm(ghosts.positions_m[:, None] - CABLE_M, axis=2).min(axis=1)


@pytest.mark.parametrize("near_share", [0.05, 0.5, 1.0])
def test_as_many_ghosts_as_configured_are_born_near_the_cable(near_share):
    assert np.mean(distances(near_share) <= 0.25) == pytest.approx(near_share, abs=0.02)


def test_the_ghosts_of_real_recordings_are_2_m_away_at_the_median():
    found = distances(0.05)
    assert np.median(found) == pytest.approx(2.0, abs=0.1)
    assert np.mean(found < 0.25) == pytest.approx(0.05, abs=0.01)


def test_the_near_share_is_taken_from_the_configuration(cable):
    watch = Watch(make_config(ghost_count=40, ghost_near_share=0.0), cable)
    (exposure,) = watch.expose(1)
    on_cable = exposure.points_m[watch.truth[0][3]]
    ghosts = np.delete(exposure.points_m, watch.truth[0][3], axis=0)
    assert len(ghosts) == 41  # the static marker is among them
    nearest = np.sort(np.linalg.norm(ghosts[:, None] - on_cable, axis=2).min(axis=1))
    assert np.median(nearest) > 1.0


def test_a_reflection_is_seen_in_every_frame_under_one_number_and_may_jitter(cable):
    settings = {"noise_mm": 0.02, "miss_probability": 0.3, "burst_probability": 0.05, "ghost_count": 2}
    watch = Watch(make_config(reflection_count=1, reflection_jitter_mm=3.0, **settings), cable)
    exposures = watch.expose(300)
    (number,) = set.intersection(*(set(exposure.ids.tolist()) for exposure in exposures))
    seen = np.array([e.points_m[np.flatnonzero(e.ids == number)[0]] for e in exposures])
    np.testing.assert_allclose(np.std(seen, axis=0), 3e-3, rtol=0.2)
    assert {int(e.flags[np.flatnonzero(e.ids == number)[0]]) for e in exposures} == {0x12}
    for exposure, row in zip(exposures, watch.truth, strict=True):
        assert number not in exposure.ids[row[3][row[3] >= 0]]


def test_reflections_are_drawn_anew_by_each_seed_and_none_is_nothing():
    rng = np.random.default_rng(3)
    assert draw_reflections(0, CABLE_M, rng).shape == (0, 3)
    first, second = draw_reflections(4, CABLE_M, rng), draw_reflections(4, CABLE_M, rng)
    assert first.shape == (4, 3)
    assert not np.array_equal(first, second)
