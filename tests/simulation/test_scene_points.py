import numpy as np
import pytest
from scene_watch import Watch, make_config, make_default_cable

from bench.simulation.points import OCCLUDED, Points


@pytest.fixture(scope="module")
def cable():
    return make_default_cable()


def test_a_marker_keeps_its_number_while_it_is_seen_and_gets_a_new_one_after_a_gap(cable):
    watch = Watch(make_config(miss_probability=0.3), cable)
    exposures = watch.expose(100)
    before = {}
    ever = set()
    for exposure, (_, _, _, source) in zip(exposures, watch.truth, strict=True):
        now = {i: int(exposure.ids[s]) for i, s in enumerate(source) if s >= 0}
        for marker, number in now.items():
            if marker in before:
                assert number == before[marker]
            else:
                assert number not in ever
        ever |= set(now.values())
        before = now


def list_ids(cable, **settings):
    pole = {"kind": "rigid_body", "name": "pole"}
    watch = Watch(make_config(pole, ghost_count=3, reflection_count=1, **settings), cable)
    return watch, [exposure.ids.tolist() for exposure in watch.expose(60)]


def test_frames_list_bodies_first_and_then_ascending_numbers_whatever_is_born_or_dies(cable):
    _, frames = list_ids(cable, miss_probability=0.2)
    for ids in frames:
        assert ids[:4] == [0x10001, 0x10002, 0x10003, 0x10004]
        assert ids[4:] == sorted(ids[4:])
        assert len(set(ids)) == len(ids)
    assert len({tuple(ids) for ids in frames}) > 50


def test_numbers_tell_nothing_about_the_place_on_the_cable(cable):
    watch = Watch(make_config(), cable)
    exposure = watch.expose(1)[0]
    along = exposure.ids[watch.truth[0][3]].tolist()
    assert along not in (sorted(along), sorted(along, reverse=True))


def test_without_gaps_and_ghosts_every_frame_has_the_same_order(cable):
    watch = Watch(make_config(), cable)
    watch.expose(20)
    assert len({tuple(row[3].tolist()) for row in watch.truth}) == 1


def test_shuffled_frames_have_another_order_each(cable):
    watch, frames = list_ids(cable, order="shuffle")
    assert len({tuple(row[3].tolist()) for row in watch.truth}) > 50
    assert any(ids[0] < 0x10000 for ids in frames)


def test_a_loose_point_never_gets_the_number_of_a_bodys_marker():
    points = Points(3, 0, 0, [1], shuffles=False, rng=np.random.default_rng(1))
    given = []
    for _ in range(6000):
        points.renew(np.arange(3))
        given.extend(points.ids[:3].tolist())
    assert len(set(given)) == 18_000
    assert not {0x10001, 0x10002, 0x10003, 0x10004} & set(given)
    assert 0x10000 + 15 not in given


def test_hidden_markers_of_a_body_are_filled_in_unless_it_is_lost():
    points = Points(2, 0, 0, [1, 2], shuffles=False, rng=np.random.default_rng(1))
    hidden = np.array([True, False, False, False, True, True, False, False])
    points.hide_members(hidden, np.array([False, True]))
    order = points.order()
    assert points.ids[order].tolist()[:4] == [0x10001, 0x10002, 0x10003, 0x10004]
    assert len(order) == 6
    assert points.flags[order].tolist() == [0x0A | OCCLUDED, 0x0A, 0x0A, 0x0A, 0x12, 0x12]
