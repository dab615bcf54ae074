"""The error study and a recorded shape, from the estimators to tables and page."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from run_examples import RunSpec, write_run

from bench.analysis import ESTIMATORS, Circle, CurveEstimate, SampledShape, Straight, fit_spline
from bench.errors import AnalysisError, RecordingExistsError
from bench.recording import open_run
from bench.report.accuracy import (
    describe_template,
    explain_skipped,
    judge_noise,
    make_paper_subjects,
    make_rod_subject,
    measure_template,
    run_study,
    tabulate_study,
    tabulate_template,
    write_study_page,
    write_study_tables,
    write_template_page,
    write_template_tables,
)
from bench.report.pipeline import analyse_run

RESULTS_PAGE = Path(__file__).parents[2] / "docs" / "reference" / "results.md"
AT_ORIGIN = 'kind = "static_marker"\nposition_m = [0.0, 0.0, 0.0]'
SHORT = {"anchor": AT_ORIGIN, "robot": False, "seconds": 0.29, "analysis": "marker_noise_mm = 0.05"}
"""While the example's cable is at rest: a circle of 400 mm."""


def needs_clamps(position_m, marker_arc_length_m, arc_length_m, noise_m, *, ends=None, with_vector=False):
    """Stand for an estimator that uses the ends and gives nothing without."""
    if ends is None:
        raise AnalysisError("It needs both clamps.")
    shape = (len(position_m), len(arc_length_m))
    return CurveEstimate(np.full(shape, 2.5, dtype=np.float32), np.full(shape, 0.1, dtype=np.float32))


def sees_nothing(position_m, marker_arc_length_m, arc_length_m, noise_m, *, ends=None, with_vector=False):
    nothing = np.full((len(position_m), len(arc_length_m)), np.nan, dtype=np.float32)
    return CurveEstimate(nothing, nothing, notes=["It saw nothing."])


@pytest.fixture(scope="module")
def study():
    rod = make_rod_subject(0.1, make_arc(Circle(0.4)), 6)
    estimators = {"spline": fit_spline, "held": needs_clamps, "blind": sees_nothing}
    return run_study([*make_paper_subjects(), rod], estimators, 2e-4)


def make_arc(circle):
    at = np.linspace(0, 1, 501)
    return SampledShape("arc", at, np.pi / 2 + at / circle.radius_m, circle.place(at), circle.curvature(at))


def test_the_study_has_the_papers_two_figures(study):
    for subject, percent in (("circle", 15.5), ("catenary", 12.0)):
        row = study.find(subject, "ideal", "spline", "unused")
        assert 100 * row.figures.max_radius_error == pytest.approx(percent, abs=0.1)


def test_every_registered_estimator_is_tried_or_says_why_not():
    circle, _ = make_paper_subjects()
    study = run_study([dataclasses.replace(circle, conditions=("ideal", "noise"))], ESTIMATORS, 2e-4)
    assert {row.estimator for row in study.rows} == set(ESTIMATORS)
    assert all(row.figures or row.skipped for row in study.rows)


def test_the_study_is_the_same_every_time():
    circle = dataclasses.replace(make_paper_subjects()[0], conditions=("placement", "2 hidden"))
    one, other = (run_study([circle], {"spline": fit_spline}, 2e-4) for _ in range(2))
    for a, b in zip(one.rows, other.rows, strict=True):
        np.testing.assert_array_equal(a.figures.radius_quantiles_m, b.figures.radius_quantiles_m)


def test_an_estimator_that_ignores_the_ends_has_one_row_and_one_that_uses_them_two(study):
    at = [(row.estimator, row.ends) for row in study.rows if (row.subject, row.condition) == ("circle", "noise")]
    assert at == [
        ("spline", "unused"),
        ("held", "unknown"),
        ("held", "known"),
        ("blind", "unknown"),
        ("blind", "known"),
    ]


def test_what_gave_nothing_is_named_with_its_reason(study):
    skipped = explain_skipped(study)
    assert "held without known ends (circle, catenary, rod 0.1): It needs both clamps." in skipped
    assert (
        "blind with known ends (circle, catenary, rod 0.1): It gives no curvature in any frame. It saw nothing."
        in skipped
    )
    circle = tabulate_study(study)[0]
    assert [row[0] for row in circle.rows] == ["spline", "held + ends"]
    assert circle.rows[0][1].startswith("15.5 / ")
    assert circle.rows[1][1] == "0.00 / 0.00"


def test_the_rods_table_has_the_true_radius_and_the_error_of_the_peak(study):
    rods = tabulate_study(study)[-1]
    assert rods.columns[1] == "arc, R 400 mm"
    assert rods.rows[-1][1] == "0.00 ± 0.00, 100"


def test_the_page_begins_with_what_the_methods_in_use_err_by(tmp_path):
    subjects = [make_paper_subjects()[0], make_rod_subject(0.1, make_arc(Circle(0.4)), 6)]
    study = run_study(subjects, {"menger_gp": fit_spline, "elastica": needs_clamps}, 2e-4)
    text = write_study_page(study, {"bench": "0"}, tmp_path).read_text("utf-8")
    first = text[text.index("<main>") : text.index("What was done")]
    names = ["Circle, markers alone", "Beside a clamp, markers alone", "Beside a clamp, clamps given"]
    assert [first.index(name) for name in names] == sorted(first.index(name) for name in names)
    assert "where the true smallest radius is 400 mm" in first


def test_tables_and_page_of_the_study(study, tmp_path):
    write_study_tables(study, {"bench": "0"}, tmp_path)
    page = write_study_page(study, {"bench": "0"}, tmp_path)
    table = pq.read_table(tmp_path / "accuracy.parquet")
    assert table.num_rows == len(study.rows)
    summary = json.loads((tmp_path / "summary.json").read_text("utf-8"))
    assert summary["shapes"]["circle"]["smallest_radius_mm"] == pytest.approx(400)
    text = page.read_text("utf-8")
    for part in (
        "up to 15.5 % on the ideal circle (around 15 %",
        "and 12.0 %",
        "It needs both clamps.",
        "Catenary, tracked.",
    ):
        assert part in text
    assert text.count("<svg") == 5
    reference = RESULTS_PAGE.read_text("utf-8")
    names = [*table.column_names, *summary]
    assert [name for name in names if f"`{name}`" not in reference] == []
    with pytest.raises(RecordingExistsError):
        write_study_tables(study, {"bench": "0"}, tmp_path)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("template") / "circle.mcap"
    write_run(path, RunSpec(**SHORT))
    return analyse_run(open_run(path))


def test_a_recorded_circle_is_found_with_its_radius_and_its_noise(recorded):
    template = measure_template(recorded, Circle(0.4), Circle, 0.4, {"spline": fit_spline})
    assert template.n_frames == template.n_complete == 28
    assert template.own_size_m == pytest.approx(0.4, rel=2e-3)
    assert template.noise_m == pytest.approx(5e-5, rel=0.15)
    assert template.fit.rms_m < 5e-5
    assert np.abs(template.placement_m).max() < 1e-4
    spline = template.estimators[0].figures
    assert 0.001 < spline.max_radius_error < 0.1
    assert spline.scatter == pytest.approx(1.0, abs=0.3)


def test_a_wrong_radius_shows_in_every_radius_error(recorded):
    template = measure_template(recorded, Circle(0.42), Circle, 0.42, {"spline": fit_spline})
    assert template.own_size_m == pytest.approx(0.4, rel=2e-3)
    assert template.estimators[0].figures.rms_radius_error == pytest.approx(0.05, abs=0.015)


def test_the_page_of_a_recorded_shape(recorded, tmp_path):
    template = measure_template(recorded, Circle(0.4), Circle, 0.4, {"spline": fit_spline, "held": needs_clamps})
    write_template_tables(template, tmp_path)
    text = write_template_page(template, tmp_path).read_text("utf-8")
    for part in ("circle, r = 400 mm", "circle.mcap", "fits them best", "held: It needs both clamps.", "<svg"):
        assert part in text
    summary = json.loads((tmp_path / "summary.json").read_text("utf-8"))
    assert len(summary["placement_mm"]) == 6
    reference = RESULTS_PAGE.read_text("utf-8")
    assert [name for name in summary if f"`{name}`" not in reference] == []


def test_the_words_of_a_recorded_shape(recorded):
    template = measure_template(recorded, Circle(0.4), Circle, 0.4, {"spline": fit_spline})
    assert describe_template(template)["Frames"] == "28 measured, 28 of 28 complete"
    curvature, markers = tabulate_template(template)
    assert [row[0] for row in curvature.rows] == ["spline"]
    assert len(markers.rows) == 6
    assert judge_noise(template) == ""


def test_a_configured_noise_that_is_not_the_measured_one_is_said(tmp_path):
    write_run(tmp_path / "quiet.mcap", RunSpec(**SHORT | {"analysis": "marker_noise_mm = 0.5"}))
    template = measure_template(analyse_run(open_run(tmp_path / "quiet.mcap")), Circle(0.4), None, np.nan, {})
    assert "marker_noise_mm is 0.5, but 0.04" in judge_noise(template)
    assert "Size by the markers" not in describe_template(template)


def test_a_straight_rod_has_no_radius_error_but_a_tightest_radius(tmp_path):
    def straighten(_, values):
        points = values["points_m"].copy()
        reach = np.linalg.norm(points, axis=1)
        at = 0.8 * np.arcsin(np.clip(reach / 0.8, 0, 1))  # chord to arc length of the circle of 400 mm
        return values | {
            "points_m": (points * 0 + np.array([1, 0, 0]) * at[:, None] + points % 1e-5).astype(np.float32)
        }

    write_run(tmp_path / "rod.mcap", RunSpec(**SHORT, change_points=straighten))
    results = analyse_run(open_run(tmp_path / "rod.mcap"))
    template = measure_template(results, Straight(), None, np.nan, {"spline": fit_spline})
    row = tabulate_template(template)[0].rows[0]
    assert row[1] == "– / –"
    assert np.nanmin(template.estimators[0].figures.radius_quantiles_m) > 1.0
    assert "Curvature" in write_template_page(template, tmp_path).read_text("utf-8")


def test_a_recording_without_markers_cannot_be_measured(tmp_path):
    empty = {"points_m": np.zeros((0, 3), np.float32), "ids": np.zeros(0, np.uint32)}
    empty |= {"flags": np.zeros(0, np.uint32), "residual_m": np.zeros(0, np.float32)}
    write_run(tmp_path / "dark.mcap", RunSpec(**SHORT, change_points=lambda _, values: values | empty))
    results = analyse_run(open_run(tmp_path / "dark.mcap"))
    with pytest.raises(AnalysisError, match=r"No frame of dark\.mcap has every marker"):
        measure_template(results, Circle(0.4), Circle, 0.4, {})
