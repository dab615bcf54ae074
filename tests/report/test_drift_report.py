"""A cable that changes its shape half way: found in the run file, said on the first page, kept in the tables."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from run_examples import CYCLE_S, START_S, TRACKER_HZ, WAIT_S, RunSpec, write_run
from synthetic_results import make_results

from bench.recording import open_run
from bench.report.drift import measure_step
from bench.report.drift_text import describe_drift_section, list_drift, warn_about_drift
from bench.report.figures import drift_figure
from bench.report.html import render_report
from bench.report.pipeline import analyse_run
from bench.report.results import Drift, DriftChange, DriftColumns, DriftTrend, Results
from bench.report.tables import write_tables

N_CYCLES, CHANGED = 44, 24
SAG_M = 0.004


def sag(i: int, values: dict[str, Any]) -> dict[str, Any]:
    """Let the cable's middle lie 4 mm beside its first place, from one cycle on."""
    if i / TRACKER_HZ < START_S + CHANGED * (CYCLE_S + WAIT_S) - WAIT_S / 2:
        return values
    points = values["points_m"].copy()
    points[:, 2] += SAG_M * np.sin(np.pi * np.linalg.norm(points, axis=1) / 0.6)
    return values | {"points_m": points}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    path = tmp_path_factory.mktemp("sagging") / "run.mcap"
    write_run(path, RunSpec(n_cycles=N_CYCLES, change_points=sag))
    return analyse_run(open_run(path))


def test_the_change_is_found_with_its_cycle_size_and_place(results: Results) -> None:
    assert results.drift is not None
    change = next(change for change in results.drift.changes if change.quantity == "shape")
    assert change.matters
    assert change.cycle_index == CHANGED
    assert change.largest == pytest.approx(1e3 * SAG_M, rel=0.1)
    assert 0.18 <= change.arc_length_m <= 0.42
    assert 0 < change.cycle_phase < 1
    columns = results.drift.columns
    expected = 1e3 * SAG_M * np.sqrt(np.mean(np.sin(np.pi * np.linspace(0.1, 1, 6)) ** 2))
    assert np.median(columns.shape_distance_mm[CHANGED:]) == pytest.approx(expected, rel=0.15)
    assert columns.shape_distance_mm[:CHANGED].max() < 0.1
    assert results.drift.reference_cycle_index.tolist() == list(range(10))


def test_the_first_page_and_the_section_say_it(results: Results) -> None:
    page = render_report(results)
    (sentence,) = [text for text in list_drift(results) if "shape" in text]
    assert f"changed with cycle\u00a0{CHANGED}" in sentence
    assert "mm away from that of the first cycles; most at the marker" in sentence
    assert page.count(sentence.split(":")[0].replace("'", "&#39;")) == 2
    assert "up to cycle 9" in describe_drift_section(results)[0]
    assert "drift.parquet" in page


def test_the_tables_and_the_summary_hold_it(results: Results, tmp_path: Path) -> None:
    names = [path.name for path in write_tables(results, tmp_path / "out")]
    assert "drift.parquet" in names
    table = pq.read_table(tmp_path / "out" / "drift.parquet")
    assert table.column_names == list(DriftColumns.__dataclass_fields__)
    assert table["cycle_index"].to_pylist() == list(range(N_CYCLES))
    assert all(table["watched"].to_pylist())
    drift = json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))["drift"]
    assert drift["reference_cycle_index"] == list(range(10))
    assert CHANGED in [change["cycle_index"] for change in drift["changes"]]
    assert {trend["quantity"] for trend in drift["trends"]} == {"shape", "max_curvature"}


def test_a_short_run_says_how_many_cycles_it_lacks(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap", RunSpec(n_cycles=3))
    short = analyse_run(open_run(tmp_path / "run.mcap"))
    assert short.drift is None
    assert describe_drift_section(short) == ["A change over the test shows from 20 cycles with verdict ok on; here: 3."]
    assert warn_about_drift(short) == []
    names = [path.name for path in write_tables(short, tmp_path / "out")]
    assert "drift.parquet" not in names
    assert json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))["drift"] is None
    assert "figure.drift" not in render_report(short)


def make_drift(n_cycles: int, changes: list[DriftChange], trends: list[DriftTrend]) -> Drift:
    values = np.full(n_cycles, 0.1)
    watched = np.ones(n_cycles, dtype=bool)
    columns = DriftColumns(np.arange(n_cycles), watched, values, values, values, values, values)
    return Drift(columns, np.arange(10), 0.05, changes, trends)


def test_what_does_not_matter_is_only_counted_and_many_changes_are_cut_short() -> None:
    bend = DriftChange("max_curvature", 30, -0.8, 0.1, 0.54, 0.45, -0.9, True)
    shape = DriftChange("shape", 31, -0.4, 0.02, float("nan"), float("nan"), float("nan"), True)
    small = replace(shape, size=0.01, matters=False)
    trends = [DriftTrend("shape", 1.5, 0.2, True, True), DriftTrend("max_curvature", -0.1, 0.01, True, True)]
    results = make_results(60, drift=make_drift(60, [bend, shape, small], trends))
    said = list_drift(results)
    where = "most at 540\u00a0mm from the anchor, phase\u00a00.45, by −0.90\u00a01/m"
    assert said == [
        f"The cable's largest curvature changed with cycle\u00a030: by −0.80 ± 0.20\u00a01/m; {where}.",
        "The cable's shape changed with cycle\u00a031: by 0.40 ± 0.04\u00a0mm back towards that of the first cycles.",
        "The cable's shape drifts away from that of the first cycles, by 1.50 ± 0.40\u00a0mm in 1000 cycles.",
        "The cable's largest curvature drifts by −0.10 ± 0.02\u00a01/m in 1000 cycles.",
    ]
    assert warn_about_drift(results) == [*said[:3], "And 1 more such change: see Change over the test."]
    assert describe_drift_section(results)[-1].startswith("One smaller change stands out")
    quiet = make_results(60, drift=make_drift(60, [], []))
    assert describe_drift_section(quiet)[1:] == ["No change was found that matters."]


@pytest.mark.parametrize(
    ("quantity", "before", "after", "size"),
    [
        ("shape", 0.1, 0.4, 0.3),
        ("shape", -0.1, 0.4, 0.5),
        ("shape", 0.1, -0.4, 0.5),
        ("shape", -0.4, 0.1, -0.5),
        ("max_curvature", -0.4, 0.1, 0.5),
    ],
)
def test_a_step_of_the_shape_leads_away_or_back(quantity: str, before: float, after: float, size: float) -> None:
    assert measure_step(quantity, before, after) == pytest.approx(size)


@pytest.mark.parametrize("n_cycles", [20, 61, 2500])
def test_the_figure_is_drawn_for_few_and_for_many_cycles(n_cycles: int) -> None:
    change = DriftChange("shape", n_cycles // 2, 0.4, 0.02, 0.5, 0.5, 0.6, True)
    drift = make_drift(n_cycles, [change], [DriftTrend("shape", 0.0, 0.1, False, False)])
    figure = drift_figure(make_results(n_cycles, per_cycle=2, drift=drift))
    assert "change that matters" in figure
    assert ("median of 3 cycles, band: all of them" in figure) == (n_cycles == 2500)
