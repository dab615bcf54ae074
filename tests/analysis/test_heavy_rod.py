"""The heavy rod: other solvers' rods come back, in space too; it says what it cannot, and raises the alarm."""

from dataclasses import replace

import numpy as np
import pytest
from curve_examples import Known, make_rods
from rod_examples import LENGTH_M, STIFFNESS, Solved, bend_in_space, hang_rod, hold_both, know

from bench.analysis import ClampedEnds, CurveEstimate, fit_elastica
from bench.analysis.curvature.elastica import fit_rod
from bench.analysis.curvature.rod_frames import find_cells, place_in_rod
from bench.analysis.curvature.rod_law import FittedLaw
from bench.analysis.curvature.rod_mesh import make_rod_mesh
from bench.analysis.curvature.rod_reading import read_cells
from bench.analysis.curvature.rod_shapes import RodModel
from bench.analysis.kernels import normal, rod, rod_balance, rod_reading
from bench.errors import AnalysisError

NOISE_M = 2e-4
EXACT = {"sigma_m": 1e-9, "sigma_rad": 1e-9}


def fit(known: Known, markers: np.ndarray, ends: ClampedEnds, noise_m: float = NOISE_M) -> CurveEstimate:
    return fit_elastica(
        markers.astype(np.float32), known.marker_s_m, known.places_m, noise_m, ends=ends, with_vector=True
    )


def turn(way: np.ndarray, axis: list[float], angle: float) -> np.ndarray:
    """Return the way (3,) turned about an axis across it, or nearly so, as a unit vector."""
    turned = way * np.cos(angle) + np.cross(axis, way) * np.sin(angle)
    return turned / np.linalg.norm(turned)


def twist_apart(n: int, bend_of_moment=lambda moment: moment / STIFFNESS) -> list[Solved]:
    """Return rods whose clamps turn out of the plane, against each other, while the end moves aside."""
    rods = [hang_rod()]
    start, middle, end = rods[0].state[3:6, 0], rods[0].state[:3, -1], rods[0].state[3:6, -1]
    for i in range(n):
        ways = turn(start, [0, 1, 0], 0.15 * i), turn(end, [0, 1, 0], -0.15 * i)
        rods.append(bend_in_space(rods[-1], ways[0], middle + np.array([0, 0, 0.02 * i]), ways[1], bend_of_moment))
    return rods[1:]


@pytest.mark.parametrize("stiffness_nm2", [0.02, 0.005, 0.002])
def test_the_peak_curvature_at_a_clamp_is_right_to_a_percent_and_inside_the_band(stiffness_nm2: float) -> None:
    known, error, inside = make_rods(stiffness_nm2, 10, 12), [], []
    at = np.arange(len(known.markers_m)), known.curvature_per_m.argmax(axis=1)
    for seed in range(5):
        rng = np.random.default_rng(300 + seed)
        found = fit(known, known.see(rng, NOISE_M), hold_both(known, rng))
        error.append(found.curvature_per_m[at] / known.curvature_per_m[at] - 1)
        inside.append(np.abs(found.curvature_per_m - known.curvature_per_m) <= 2 * found.sigma_per_m)
        assert np.nanmedian(found.residual_m) < NOISE_M
        assert found.warnings == []
    assert abs(np.mean(error)) < 0.01
    assert 0.90 <= np.mean(inside) <= 0.99


def test_in_space_it_agrees_with_scipys_boundary_value_solver() -> None:
    known = know(twist_apart(6), 10)
    found = fit(known, known.markers_m, hold_both(known, np.random.default_rng(0), **EXACT))
    peak = known.curvature_per_m.max(axis=1, keepdims=True)
    assert np.ptp(known.markers_m[-1, :, 2]) > 0.2
    assert (np.abs(found.curvature_per_m - known.curvature_per_m) / peak).max() < 3e-3
    assert "0.0133 m³" in found.notes[0]


def test_the_curvature_vector_points_along_the_binormal() -> None:
    rods = twist_apart(3)
    known = know(rods, 10)
    found = fit(known, known.markers_m, hold_both(known, np.random.default_rng(0), **EXACT))
    for known_rod, vector in zip(rods, found.vector_per_m, strict=True):
        true = np.stack([np.interp(known.places_m, known_rod.s_m, x) for x in known_rod.bend_per_m.T], axis=1)
        assert np.abs(vector - true).max() < 4e-3 * np.abs(true).max()


def test_a_lab_turned_about_the_vertical_and_moved_changes_nothing_but_the_vectors() -> None:
    known = make_rods(0.02, 10, 6)
    markers, ends = known.see(np.random.default_rng(1), NOISE_M), hold_both(known, np.random.default_rng(2))
    # y up becomes z up, then any turn about z.
    angle = 0.7
    about = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    matrix, shift = about @ np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]), np.array([0.3, -1.0, 2.0])
    moved = [
        replace(end, position_m=end.position_m @ matrix.T + shift, tangent=end.tangent @ matrix.T)
        for end in (ends.anchor, ends.end)
    ]
    a = fit(known, markers, ends)
    b = fit(known, markers @ matrix.T + shift, ClampedEnds(moved[0], moved[1], ends.length_m, up=(0.0, 0.0, 1.0)))
    assert np.allclose(a.curvature_per_m, b.curvature_per_m, rtol=2e-3, atol=2e-3)
    assert np.allclose(a.vector_per_m @ matrix.T, b.vector_per_m, rtol=2e-3, atol=5e-3)


def test_a_frame_of_a_long_recording_reads_what_it_reads_alone() -> None:
    # Frames whose clamps stand alike share a shape; each is one linear step away from it.
    known = make_rods(0.005, 10)
    ends = hold_both(known, np.random.default_rng(3))
    markers = known.see(np.random.default_rng(4), NOISE_M)
    stay = np.repeat(np.arange(24), 40)
    jitter = np.random.default_rng(5).normal(0, 1.5e-3, (len(stay), 3))
    held = [replace(e, **{k: getattr(e, k)[stay] for k in vars(e)}) for e in (ends.anchor, ends.end)]
    # The end is not where it is said to be, by a millimetre or two: the cable is where it was.
    held[1] = replace(held[1], position_m=held[1].position_m + jitter, position_sigma_m=np.full(len(stay), 1.5e-3))
    found = fit(known, markers[stay], ClampedEnds(held[0], held[1], ends.length_m))
    alone = fit(known, markers, ends)
    peak = known.curvature_per_m.max(axis=1)[stay]
    apart = np.abs(found.curvature_per_m.max(axis=1) - alone.curvature_per_m[stay].max(axis=1)) / peak
    assert apart.max() < 0.01


def test_missing_markers_widen_the_band_and_fewer_than_three_leave_no_curve() -> None:
    known = make_rods(0.02, 10)
    markers, ends = known.see(np.random.default_rng(6), NOISE_M), hold_both(known, np.random.default_rng(7))
    whole = fit(known, markers, ends)
    markers[3, :8], markers[5, 3:7] = np.nan, np.nan
    found = fit(known, markers, ends)
    assert np.isnan(found.curvature_per_m[3]).all()
    assert np.isnan(found.residual_m[3])
    assert found.sigma_per_m[5].mean() > whole.sigma_per_m[5].mean()
    assert "1 of 24 frames have no curve by the heavy rod" in found.warnings[0]
    beyond = fit_elastica(markers, known.marker_s_m, np.array([-0.01, 0.0, 1.5, 1.51]), NOISE_M, ends=ends)
    assert np.array_equal(np.isfinite(beyond.curvature_per_m[0]), [False, True, True, False])


def test_a_stiffness_that_falls_with_the_bend_is_found() -> None:
    # Strands that stick, then slip: stiff as three times EI up to 2 /m, then only EI more.
    knee, friction = 2.0, 2 * STIFFNESS * 2.0
    fine = np.linspace(0, 60, 20_001)
    rods = twist_apart(5, lambda moment: np.interp(moment, STIFFNESS * fine + friction * np.tanh(fine / knee), fine))
    known = know(rods, 10)
    markers, ends = known.see(np.random.default_rng(8), NOISE_M), hold_both(known, np.random.default_rng(9))
    rod_found = fit_rod(markers, known.marker_s_m, NOISE_M, ends)
    found = rod_found.read(known.places_m)
    assert rod_found.law.slips
    assert found.curvature_per_m.max(axis=1) == pytest.approx(known.curvature_per_m.max(axis=1), rel=0.03)
    assert "as the strands slip" in found.notes[0]
    assert found.warnings == []


def test_a_cable_that_is_no_such_rod_raises_the_alarm() -> None:
    known = make_rods(0.02, 10, 6)
    markers, ends = known.see(np.random.default_rng(10), NOISE_M), hold_both(known, np.random.default_rng(11))
    lying = ClampedEnds(ends.anchor, ends.end, ends.length_m, up=(0.0, -1.0, 0.0))
    found = fit(known, markers, lying)
    assert np.nanmedian(found.residual_m) > 3 * NOISE_M
    assert any("where noise explains 0.2 mm" in text for text in found.warnings)


def test_a_marker_that_sits_elsewhere_is_found_and_named() -> None:
    known = make_rods(0.02, 10)
    markers, ends = known.see(np.random.default_rng(12), NOISE_M), hold_both(known, np.random.default_rng(13))
    said = known.marker_s_m.copy()
    said[4] -= 0.004
    found = fit_elastica(markers, said, known.places_m, NOISE_M, ends=ends)
    assert "Marker 5 seems to sit" in found.warnings[0]
    peak = known.curvature_per_m.max(axis=1)
    assert found.curvature_per_m.max(axis=1) == pytest.approx(peak, rel=0.02)


def test_a_wrong_marker_in_one_frame_widens_that_frames_band_alone() -> None:
    known = make_rods(0.02, 10)
    markers, ends = known.see(np.random.default_rng(14), NOISE_M), hold_both(known, np.random.default_rng(15))
    clean = fit(known, markers, ends)
    markers[7, 5] += [0.02, 0.0, 0.0]
    found = fit(known, markers, ends)
    others = np.arange(24) != 7
    assert found.residual_m[7] > 5 * found.residual_m[others].max()
    assert found.sigma_per_m[7].mean() > 3 * clean.sigma_per_m[7].mean()
    assert np.allclose(found.curvature_per_m[others], clean.curvature_per_m[others], rtol=0.03, atol=0.05)


def test_a_clamp_that_is_not_known_is_refused_with_what_to_do() -> None:
    known = make_rods(0.02, 10, 3)
    markers, ends = known.see(np.random.default_rng(16), NOISE_M), hold_both(known, np.random.default_rng(17))
    nowhere = np.full((3, 3), np.nan)
    cases = [
        (None, "place of the cable's anchor"),
        (replace(ends, end=None), "place of the cable's end"),
        (replace(ends, anchor=replace(ends.anchor, tangent=nowhere)), "clamp at the cable's anchor"),
        (replace(ends, end=replace(ends.end, tangent=nowhere)), "clamp at the cable's end"),
    ]
    for given, text in cases:
        with pytest.raises(AnalysisError, match=text) as refused:
            fit(known, markers, given)
        assert "clamp_direction" in refused.value.hint
    assert "bench calibrate" in refused.value.hint


def test_a_rod_shorter_than_the_way_between_its_clamps_is_refused() -> None:
    known = make_rods(0.02, 10, 3)
    ends = hold_both(known, np.random.default_rng(18))
    with pytest.raises(AnalysisError, match="in no frame"):
        fit(known, known.markers_m, replace(ends, length_m=0.5))


def test_nothing_in_gives_a_refusal_and_one_frame_a_curve() -> None:
    known = make_rods(0.02, 10, 1)
    ends = hold_both(known, np.random.default_rng(19))
    one = fit(known, known.markers_m, ends)
    assert one.curvature_per_m.max() == pytest.approx(known.curvature_per_m.max(), rel=0.02)
    assert one.method == "elastica"
    with pytest.raises(AnalysisError):
        fit(known, known.markers_m * np.nan, ends)


def test_the_compiled_loops_do_what_their_python_does(monkeypatch: pytest.MonkeyPatch) -> None:
    known = know(twist_apart(1), 6)
    markers, ends = known.see(np.random.default_rng(20), NOISE_M), hold_both(known, np.random.default_rng(21))
    markers[0, 2] = np.nan
    frames = place_in_rod(np.repeat(markers, 2, axis=0), _twice(ends), NOISE_M)
    mesh = make_rod_mesh(LENGTH_M, frames.up, 12)
    model = RodModel(mesh, known.marker_s_m, np.array([0.5 * STIFFNESS, 0.5 * STIFFNESS, 1.0]), NOISE_M)
    law = FittedLaw(model, known.marker_s_m, 1e-5 * np.eye(3), NOISE_M, slips=True, relative_sigma=0.01, tension_m=0.5)
    cells = find_cells(frames)
    compiled = list(read_cells(frames, cells, law, known.places_m, with_vector=True))
    for module in (normal, rod_balance, rod, rod_reading):
        for name, loop in vars(module).copy().items():
            monkeypatch.setattr(module, name, getattr(loop, "py_func", loop))
    plain = list(read_cells(frames, cells, law, known.places_m, with_vector=True))
    for a, b in zip(compiled, plain, strict=True):
        for field in ("curvature_per_m", "sigma_per_m", "vector_per_m", "residual_m"):
            assert np.allclose(getattr(a, field), getattr(b, field), rtol=1e-6)
    assert len(plain[0].frame) == 2


def _twice(ends: ClampedEnds) -> ClampedEnds:
    held = [replace(e, **{k: np.repeat(v, 2, axis=0) for k, v in vars(e).items()}) for e in (ends.anchor, ends.end)]
    return ClampedEnds(held[0], held[1], ends.length_m)
