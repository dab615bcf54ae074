"""The compiled loops of the sorting by tracks do what their Python does, and bridge what is hidden."""

from collections.abc import Callable

import numpy as np
import pytest
from cable_examples import Floats
from motion_examples import CABLE, move_cable, record

from bench.analysis.kernels import motion_bridges, point_links, track_fits
from bench.analysis.sorting.marker_motion import learn_motion
from bench.analysis.sorting.point_tracks import leave_out_twins, link_tracks, measure_gates

Loop = Callable[..., object]
TIME_S = np.arange(0, 0.4, 0.02)


def both_ways(loop: Loop, *given: object, out: tuple[int, ...] = ()) -> list[list[object]]:
    """Return what the loop and its plain Python give: results first, then the arrays that it wrote."""
    found = []
    for way in (loop, loop.py_func):  # type: ignore[attr-defined]
        arrays = [one.copy() if isinstance(one, np.ndarray) else one for one in given]
        result = way(*arrays)
        results = list(result) if isinstance(result, tuple) else [result]
        found.append([*results, *(arrays[index] for index in out)])
    return found


def agree(loop: Loop, *given: object, out: tuple[int, ...] = ()) -> list[object]:
    compiled, plain = both_ways(loop, *given, out=out)
    for one, other in zip(compiled, plain, strict=True):
        if one is not None:
            assert np.allclose(np.asarray(one, dtype=float), np.asarray(other, dtype=float), atol=1e-9, equal_nan=True)
    return compiled


def test_linking_agrees_with_its_python() -> None:
    frames = record(1, TIME_S, ghosts=2.0).frames
    points, offsets = frames.points_m.astype(np.float64), frames.offsets
    agree(point_links.find_twins, np.concatenate([frames.points_m] * 2), np.append(offsets, 2 * offsets[-1]))
    agree(point_links.measure_turns, points, offsets, TIME_S, np.arange(2, 10), 2, 3.0)
    tracks = agree(point_links.link_points, points, offsets, TIME_S, 20.0, 2e-3, 3.0, 0.05)[0]
    assert np.max(np.asarray(tracks)) < len(points) / 3


def test_a_point_that_is_thrown_round_ever_more_sharply_stays_one_track() -> None:
    time_s = np.arange(0, 0.3, 0.01)
    turning = np.clip((time_s - 0.05) / 0.1, 0.0, 1.0) * 60.0
    points = np.zeros((len(time_s), 3))
    points[:, 0] = np.cumsum(np.cumsum(turning) * 0.01) * 0.01
    given = points, np.arange(len(points) + 1), time_s
    assert np.all(point_links.link_points(*given, 20.0, 1e-3, 5.0, 0.05) == 0)
    sudden = points.copy()
    sudden[20:, 1] += 0.02  # no cable: from one frame to the next, without a sharper and sharper turn before
    assert point_links.link_points(sudden, *given[1:], 20.0, 1e-3, 5.0, 0.05)[20] == 1


def filtered(seen: np.ndarray, place_m: Floats) -> tuple[Floats, Floats]:
    variance = np.full(len(place_m), 1e-8)
    onward = agree(motion_bridges.filter_motion, place_m, variance, seen, TIME_S, 0.5, 1.0, True)[0]
    back = agree(motion_bridges.filter_motion, place_m, variance, seen, TIME_S, 0.5, 1.0, False)[0]
    return np.asarray(onward), np.asarray(back)


def test_a_bridge_joins_place_and_speed_on_both_sides() -> None:
    place = np.stack([0.3 * TIME_S, 1.0 - 2.0 * TIME_S**2, np.sin(TIME_S)], axis=1)
    seen = np.ones(len(TIME_S), dtype=bool)
    seen[8:13] = False
    onward, back = filtered(seen, place)
    bridge = (TIME_S, TIME_S[10], 0.5)
    sides = {"both": (7, 13), "before": (7, -1), "after": (-1, 13)}
    off, variance = {}, {}
    for name, (before, after) in sides.items():
        found = agree(motion_bridges.bridge_motion, onward, back, before, after, *bridge, np.zeros(3), out=(7,))
        variance[name], off[name] = float(np.asarray(found[0])), np.abs(np.asarray(found[1]) - place[10]).max()
    assert off["both"] < 1e-4
    assert variance["both"] < variance["before"] / 4
    assert variance["both"] < variance["after"] / 4
    nothing = agree(motion_bridges.bridge_motion, onward, back, -1, -1, *bridge, np.zeros(3), out=(7,))
    assert np.isinf(np.asarray(nothing[0], dtype=float))
    before, after = agree(motion_bridges.find_neighbours_in_time, seen)
    parted = place + np.where(np.arange(len(place)) < 15, 0.0, 0.01)[:, None]
    ways = filtered(seen, parted)
    steps = agree(
        motion_bridges.measure_steps, *ways, parted, np.full(len(place), 1e-8), np.asarray(before), seen, TIME_S, 0.5
    )[0]
    assert np.argmax(np.asarray(steps)) == 15
    assert (np.asarray(before)[10], np.asarray(after)[10], np.asarray(before)[0]) == (7, 13, -1)


def test_fitting_agrees_with_its_python() -> None:
    recording = record(2, TIME_S, miss=0.1, ghosts=2.0)
    frames = leave_out_twins(recording.frames)
    tracks = link_tracks(frames, measure_gates(frames, np.arange(len(frames))))
    source = np.where(recording.source >= 0, tracks.offsets[:-1, None] + recording.source, -1).T.astype(np.int64)
    source[3, 5:9] = -1
    source = np.ascontiguousarray(source)
    motion = learn_motion(tracks, source, CABLE, is_alone=False)
    place = np.ascontiguousarray(move_cable(TIME_S).transpose(1, 0, 2))
    variance, weight = np.full(source.shape, 1e-6), np.zeros(len(source))
    weight[[2, 4]] = 0.5
    followed = agree(track_fits.follow_neighbours, tracks.points_m, source, place, variance, weight, 3)
    base, spread, apart = (np.asarray(part) for part in followed)
    onward, back = filtered(source[3] >= 0, apart)
    before, after = (np.asarray(part) for part in agree(motion_bridges.find_neighbours_in_time, source[3] >= 0))
    bridge, bounds = (
        (onward, back, before, after, TIME_S, 0.5),
        (
            5.0,
            *(np.ascontiguousarray(part) for part in (motion.chord_rate_m2_s, motion.chord_noise_m2, motion.longest_m)),
        ),
    )
    own = (tracks.points_m, source, 3)
    agree(track_fits.estimate_places, *own, *bridge, base, spread, 1e-8, place[3], variance[3], out=(12, 13))
    jumps = agree(track_fits.measure_jumps, apart, before, after, source[3] >= 0, TIME_S, spread + 1e-8, 0.5)[0]
    assert np.all(np.asarray(jumps) >= 0)
    free = np.ones(len(tracks.points_m), dtype=bool)
    free[source[source >= 0]] = False
    listed = (tracks.points_m, tracks.offsets, tracks.track, free, source, 3, before, after, TIME_S)
    agree(track_fits.fit_free_tracks, *listed, place[3], variance[3], 1e-8, *bounds, len(tracks))
    rows = np.arange(len(TIME_S))
    scores = agree(track_fits.fit_labeled, *own, rows, rows, *bridge, base, spread, 1e-8, *bounds)[0]
    assert np.nanmedian(np.asarray(scores)) > 0
    agree(track_fits.count_close, tracks.points_m, tracks.offsets, free, source, rows, 0.02)
    chosen = np.arange(len(tracks))[:4]
    empty = np.full(source.shape, -1)
    given = (chosen, chosen % 2, tracks.begins, tracks.members, tracks.row, 0.5, empty)
    agree(track_fits.label_tracks, *given, out=(6,))


@pytest.mark.parametrize("apart_m", [0.0, 0.004, 0.05])
def test_the_farther_off_the_less_likely(apart_m: float) -> None:
    near, far = (
        np.asarray(agree(track_fits._log_density, square, 1e-6, 3)[0], dtype=float)
        for square in (apart_m**2, (apart_m + 0.001) ** 2)
    )
    assert near >= far
