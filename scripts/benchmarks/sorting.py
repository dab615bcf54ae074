"""How many frames are sorted exactly, and how fast, on motions that no method was tuned on; peers in the same run.

The motions are `bench.simulation.made_motions.HELD_OUT`. Ours are never told the truth. The peers, which cannot find a
marker again that they lost, are told it every second, and trackpy's tracks are labeled by it: the best that could be
made of them.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from bench.analysis import PointFrames, SortSettings, sort_automatically, sort_by_chain, sort_by_paper
from bench.analysis.sorting.phase_learning import learn_cycle
from bench.analysis.sorting.phase_sorting import sort_by_template
from bench.simulation.made_motions import HELD_OUT
from bench.simulation.made_takes import HARD, USUAL, Conditions, MadeTake, make_take
from benchmarks.table import Row, ratio_row

Floats = npt.NDArray[np.float64]
Sources = npt.NDArray[np.int16]
Method = Callable[[MadeTake, Conditions], Sources]

N_CYCLES = 20
PEER_FRAMES = {
    "Hungarian + velocity, told each second": 2000,
    "trackpy, labeled by the truth": 2000,
    "pycpd, told each second": 2000,
}
"""Peers are given the beginning only, for they are slow."""
GATE_M = 0.03
"""Of the peers: 30 mm, a third of the distance between two markers."""
TOLD_FRAMES = 100
"""After so many the peers are told again where all markers are."""
FRAMES_TIMED = 400_000
WANTED_PER_S = 250_000


def measure_sorting() -> list[Row]:
    """Score all methods on crossing motion, ours on harder takes, and time the long run."""
    rows = [*_compare_with_peers(), _timed_row()]
    for name, kind, conditions, wanted in (
        ("uneven spacings", "uneven loop", USUAL, 0.9995),
        ("10 % misses, 4 ghosts, 80 % near", "loop", HARD, 0.995),
        ("25 markers at 40 mm", "dense", USUAL, 0.99),
    ):
        takes = [make_take(motion, N_CYCLES, conditions, seed=1) for motion in HELD_OUT[kind]]
        ours, paper = (_score(takes, conditions, method) for method in (_automatically, _by_paper))
        rows.append(
            Row(f"sorting, {name}: frames exact", _share(ours), f"{_share(paper)} (paper)", f"{wanted:.2%} wanted")
        )
    return rows


def _compare_with_peers() -> list[Row]:
    takes = [make_take(motion, N_CYCLES, USUAL, seed=1) for motion in HELD_OUT["loop"]]
    ours = _score(takes, USUAL, _automatically)
    rows = []
    for name, method in {"paper": _by_paper, "chain": _by_chain, **PEERS}.items():
        n_frames = PEER_FRAMES.get(name)
        peer = _score(takes[:1] if n_frames else takes, USUAL, method, n_frames)
        cells = [f"{_share(score)}, {score[2]:,.3g}/s" for score in (ours, peer)]
        what = "sorting, crossing, 5 % misses, 2 ghosts: exact (wrong)"
        rows.append(Row(what, cells[0], f"{cells[1]} ({name})", f"{ours[2] / peer[2]:.3g}"))
    return rows


def _timed_row() -> Row:
    """Sort 400 000 frames by the cycle's template; what is learnt before counts apart."""
    take = _repeat(make_take(HELD_OUT["loop"][0], N_CYCLES, USUAL, seed=1), FRAMES_TIMED)
    frames, cable = _frames_of(take), _settings_of(take, USUAL)
    begin = time.process_time()
    template = learn_cycle(frames, cable)
    learnt_s = time.process_time() - begin
    if template is None:
        raise SystemExit("The made cycles could not be learnt.")
    begin = time.process_time()
    sort_by_template(frames, cable, template)
    rate = len(frames) / (time.process_time() - begin)
    return ratio_row(f"sorting, 400 000 frames, learnt in {learnt_s:.2g} s: frames/s", rate, WANTED_PER_S, "limit")


def _score(
    takes: list[MadeTake], conditions: Conditions, method: Method, n_frames: int | None = None
) -> tuple[float, float, float]:
    """Return the shares of exact frames and of those with a wrong label, and frames a second of CPU time, compiled."""
    method(_first(takes[0], 200), conditions)
    scores, took_s, n_sorted = [], 0.0, 0
    for take in takes:
        part = take if n_frames is None else _first(take, n_frames)
        begin = time.process_time()
        source = method(part, conditions)
        took_s += time.process_time() - begin
        n_sorted += len(source)
        scores.append(part.score(source))
    exact, wrong = np.mean(scores, axis=0)
    return float(exact), float(wrong), n_sorted / took_s


def _share(score: tuple[float, float, float]) -> str:
    return f"{score[0]:.2%} ({score[1]:.2%})"


def _frames_of(take: MadeTake) -> PointFrames:
    usable = np.ones(len(take.points_m), dtype=bool)
    known = (take.time_ns, take.end_m, take.end_sigma_m, take.cycle, take.phase)
    return PointFrames(take.points_m, take.offsets, usable, take.anchor_m, *known)


def _settings_of(take: MadeTake, conditions: Conditions) -> SortSettings:
    return SortSettings(take.arc_length_m, tolerance_m=0.004, length_m=take.length_m, noise_m=conditions.noise_m)


def _automatically(take: MadeTake, conditions: Conditions) -> Sources:
    return sort_automatically(_frames_of(take), _settings_of(take, conditions)).source


def _by_paper(take: MadeTake, conditions: Conditions) -> Sources:
    return sort_by_paper(_frames_of(take), _settings_of(take, conditions)).source


def _by_chain(take: MadeTake, conditions: Conditions) -> Sources:
    return sort_by_chain(_frames_of(take), _settings_of(take, conditions)).source


def _by_hungarian(take: MadeTake, _: Conditions) -> Sources:
    """Assign points to where constant speed puts the markers, all at once."""
    now = speed = np.zeros_like(take.marker_m[0])
    source = np.full(take.source.shape, -1, dtype=np.int16)
    for frame, points in enumerate(_points(take)):
        if frame % TOLD_FRAMES == 0:
            now = take.marker_m[max(frame - 1, 0)]
            speed = take.marker_m[frame] - now
        expected = now + speed
        distance = np.linalg.norm(expected[:, None] - points, axis=2)
        marker, point = linear_sum_assignment(np.minimum(distance, GATE_M))
        near = distance[marker, point] < GATE_M
        source[frame, marker[near]] = point[near]
        found = expected.copy()
        found[marker[near]] = points[point[near]]
        now, speed = found, found - now
    return source


def _by_pycpd(take: MadeTake, _: Conditions) -> Sources:
    """Register the markers of one frame to the points of the next, with outliers."""
    from pycpd import DeformableRegistration

    now, source = take.marker_m[0].copy(), np.full(take.source.shape, -1, dtype=np.int16)
    for frame, points in enumerate(_points(take)):
        if frame % TOLD_FRAMES == 0:
            now = take.marker_m[frame].copy()
        known = {"alpha": 2.0, "beta": 0.3, "w": 0.1, "sigma2": 0.01**2, "max_iterations": 20}  # the best of eight
        registration = DeformableRegistration(X=points, Y=now, **known)
        now, _ = registration.register()
        point = registration.P.argmax(axis=1)
        near = np.linalg.norm(points[point] - now, axis=1) < GATE_M
        near &= registration.P.argmax(axis=0)[point] == np.arange(len(now))
        source[frame, near], now[near] = point[near], points[point[near]]
    return source


def _by_trackpy(take: MadeTake, _: Conditions) -> Sources:
    """Link points into tracks; each gets the label that it mostly has in truth."""
    import trackpy

    trackpy.quiet()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        linked = list(trackpy.link_iter(_points(take), search_range=GATE_M, memory=20, adaptive_stop=0.005))
    track = [np.asarray(ids) for _, ids in linked]
    votes = np.zeros((max(int(ids.max(initial=0)) for ids in track) + 1, take.source.shape[1] + 1), dtype=np.int64)
    for frame, ids in enumerate(track):
        label = np.full(len(ids), -1)
        seen = take.source[frame] >= 0
        label[take.source[frame][seen]] = np.flatnonzero(seen)
        np.add.at(votes, (ids, label), 1)
    marker = np.where(votes.argmax(axis=1) < take.source.shape[1], votes.argmax(axis=1), -1)
    source = np.full(take.source.shape, -1, dtype=np.int16)
    for frame, ids in enumerate(track):
        point = np.flatnonzero(marker[ids] >= 0)
        source[frame, marker[ids][point]] = point
    return source


PEERS: dict[str, Method] = {
    "Hungarian + velocity, told each second": _by_hungarian,
    "trackpy, labeled by the truth": _by_trackpy,
    "pycpd, told each second": _by_pycpd,
}


def _points(take: MadeTake) -> list[Floats]:
    return [part.astype(np.float64) for part in np.split(take.points_m, take.offsets[1:-1])]


def _first(take: MadeTake, n_frames: int) -> MadeTake:
    """Return the beginning of a take."""
    frames, points = slice(0, n_frames), slice(0, take.offsets[n_frames])
    cut = {name: getattr(take, name)[frames] for name in _BY_FRAME}
    return replace(take, points_m=take.points_m[points], offsets=take.offsets[: n_frames + 1], **cut)


def _repeat(take: MadeTake, n_frames: int) -> MadeTake:
    """Return the whole cycles of a take again and again, `n_frames` in all; the cable shifts a little in between."""
    times = -(-n_frames // len(take.time_ns))
    tiled = {name: np.concatenate([getattr(take, name)] * times)[:n_frames] for name in _BY_FRAME}
    turn = np.repeat(np.arange(times), len(take.time_ns))[:n_frames]
    step_ns = int(take.time_ns[1] - take.time_ns[0])
    tiled["time_ns"] = take.time_ns[0] + step_ns * np.arange(n_frames)
    tiled["cycle"] = tiled["cycle"] + turn * (int(take.cycle.max()) + 1)
    counts = np.tile(np.diff(take.offsets), times)[:n_frames]
    offsets = np.concatenate([[0], np.cumsum(counts)])
    return replace(take, points_m=np.tile(take.points_m, (times, 1))[: offsets[-1]], offsets=offsets, **tiled)


_BY_FRAME = ("time_ns", "cycle", "phase", "anchor_m", "end_m", "end_sigma_m", "source", "marker_m")
