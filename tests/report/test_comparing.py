"""Two recordings against each other, or one and a known shape: from run files to figures, table and page."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from run_examples import RunSpec, write_run

from bench.analysis import Circle
from bench.errors import AnalysisError, RecordingExistsError, TooFewMarkersError
from bench.recording import open_run
from bench.report.comparison import (
    COMPARISON_FILES,
    compare_runs,
    compare_with_shape,
    describe_comparison,
    write_comparison,
)
from bench.report.pipeline import analyse_run

RESULTS_PAGE = Path(__file__).parents[2] / "docs" / "reference" / "results.md"
AT_ORIGIN = 'kind = "static_marker"\nposition_m = [0.0, 0.0, 0.0]'


def moved(_, values):
    """Turn and shift what the tracker sees, anchor and all."""
    x, y, z = values["points_m"].T
    return values | {"points_m": np.stack([-y + 0.5, x, z - 0.2], axis=1).astype(np.float32)}


def analysed(path, **spec):
    write_run(path, RunSpec(**{"anchor": AT_ORIGIN} | spec))
    return analyse_run(open_run(path))


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    return analysed(tmp_path_factory.mktemp("runs") / "first.mcap")


@pytest.fixture(scope="module")
def second(tmp_path_factory):
    return analysed(tmp_path_factory.mktemp("runs") / "second.mcap", n_cycles=4)


def with_markers(results, keep):
    """Return the results as those of fewer markers."""
    frames = dataclasses.replace(
        results.frames, source=results.frames.source[:, keep], position_m=results.frames.position_m[:, keep]
    )
    return dataclasses.replace(results, frames=frames, marker_arc_length_m=results.marker_arc_length_m[keep])


def test_equal_motions_are_no_further_apart_than_their_noise(first, second):
    assert compare_runs(first, first).difference.e_m == 0.0
    found = compare_runs(first, second)
    assert 0 < found.difference.e_m < 1e-4
    assert found.difference.compared > 0.95
    assert "the same 6 markers" in found.notes[0]


def test_a_run_in_another_space_is_far_until_it_is_aligned(first, tmp_path):
    anchor = AT_ORIGIN.replace("[0.0, 0.0, 0.0]", "[0.5, 0.0, -0.2]")
    other = analysed(tmp_path / "moved.mcap", anchor=anchor, change_points=moved)
    apart, aligned = compare_runs(first, other), compare_runs(first, other, in_space=True)
    assert apart.difference.e_m > 0.3
    assert aligned.difference.e_m < 1e-4
    assert describe_comparison(aligned)["aligned in space"].startswith("the second was turned by 90.0")


def test_programs_that_both_recordings_carry_are_held_against_each_other(first):
    facts = {"file": "bend.urp", "bytes": "7", "sha256": "ab" * 32}
    same = dataclasses.replace(first, program_facts=facts)
    other = dataclasses.replace(first, program_facts=facts | {"sha256": "cd" * 32})
    assert f"the same program in both: bend.urp, 7 bytes, SHA-256 {'ab' * 32}." in compare_runs(same, same).notes[-1]
    told = compare_runs(same, other).notes[-1]
    assert told.startswith("The robot drove by different programs: bend.urp")
    assert "ab" * 32 in told
    assert "cd" * 32 in told
    assert not any("program" in note for note in compare_runs(first, other).notes)
    loaded = dataclasses.replace(first, program_facts={"loaded": "bend", "loaded_sha256": "ef" * 32})
    assert "the same program in both: bend" in compare_runs(loaded, loaded).notes[-1]


def test_a_late_motion_is_put_forward(first):
    phase = first.frames.cycle_phase
    late = np.where(np.isfinite(phase), np.clip(phase * 0.9, 0, 1), phase)
    other = dataclasses.replace(first, frames=dataclasses.replace(first.frames, cycle_phase=late))
    apart, aligned = compare_runs(first, other), compare_runs(first, other, in_time=True)
    assert aligned.difference.e_m < apart.difference.e_m
    assert aligned.late < 0
    assert aligned.late_s == pytest.approx(aligned.late * 0.8, rel=0.02)
    assert "of a cycle) late" in describe_comparison(aligned)["aligned in time"]


def test_other_markers_are_compared_where_both_have_a_curve(first, second):
    found = compare_runs(first, with_markers(second, slice(1, 6)))
    assert (found.arc_length_m[0], found.arc_length_m[-1]) == pytest.approx((0.18, 0.66))
    assert "The first has 6 markers, the second 5, at other places" in found.notes[0]
    assert found.difference.e_m < 1e-3


def test_no_common_stretch_of_cable_is_said_with_both(first, second):
    other = dataclasses.replace(second, marker_arc_length_m=second.marker_arc_length_m + 0.7)
    with pytest.raises(AnalysisError, match="no stretch of cable in common: 60 to 660 mm and 760 to 1360 mm"):
        compare_runs(first, other)


def test_phases_told_by_other_means_are_said(first, second):
    other = dataclasses.replace(second, methods=second.methods | {"cycles": "whole take, phase by time"})
    told = dataclasses.replace(
        first, methods=first.methods | {"cycles": "robot's counter, phase by the robot's register"}
    )
    assert any("told by different means" in note for note in compare_runs(told, other).notes)
    assert not any("told by different means" in note for note in compare_runs(told, told).notes)


def test_a_motion_that_was_hardly_seen_is_said_to_be(first, second):
    position = second.frames.position_m.copy()
    position[second.frames.cycle_phase > 0.3] = np.nan
    blind = dataclasses.replace(second, frames=dataclasses.replace(second.frames, position_m=position))
    found = compare_runs(first, blind)
    assert found.difference.compared < 0.4
    assert "Less than half of the motion could be compared" in found.notes[-1]
    assert "Less than half" not in compare_runs(first, second).notes[-1]


def test_three_markers_are_too_few(first, second):
    with pytest.raises(TooFewMarkersError, match=r"second\.mcap has 3 markers; at least 4"):
        compare_runs(first, with_markers(second, slice(0, 3)))


def test_a_recording_without_markers_cannot_be_compared(first, tmp_path):
    empty = {"points_m": np.zeros((0, 3), np.float32), "ids": np.zeros(0, np.uint32)}
    empty |= {"flags": np.zeros(0, np.uint32), "residual_m": np.zeros(0, np.float32)}
    dark = analysed(tmp_path / "dark.mcap", change_points=lambda _, values: values | empty)
    with pytest.raises(AnalysisError, match=r"dark\.mcap shows at no phase"):
        compare_runs(first, dark)


def test_a_cable_at_rest_lies_on_the_circle_that_it_is(tmp_path):
    rest = analysed(tmp_path / "rest.mcap", robot=False, seconds=0.29)
    found = compare_with_shape(rest, Circle(0.4))
    assert found.difference.e_m < 1e-4
    assert "stands still" in found.notes[0]
    wrong = compare_with_shape(rest, Circle(0.3))
    assert wrong.difference.e_m > 5e-3


def test_page_table_and_summary_are_written_once(first, second, tmp_path):
    found = compare_runs(first, second, in_time=True, in_space=True)
    page = write_comparison(found, tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == set(COMPARISON_FILES)
    text = page.read_text("utf-8")
    for part in ("first.mcap", "second.mcap", "e of eq. (6)", "aligned in space", "Figure 2."):
        assert part in text
    assert text.count("<svg") == 2
    table = pq.read_table(tmp_path / "out" / "difference.parquet")
    assert table.num_rows == found.difference.distance_m.size
    np.testing.assert_allclose(table["distance_m"].to_numpy(), found.difference.distance_m.ravel(), rtol=1e-6)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))
    assert summary["e_mm"] == pytest.approx(1e3 * found.difference.e_m)
    reference = RESULTS_PAGE.read_text("utf-8")
    assert [name for name in [*table.column_names, *summary] if f"`{name}`" not in reference] == []
    with pytest.raises(RecordingExistsError):
        write_comparison(found, tmp_path / "out")


def test_the_same_comparison_gives_the_same_page(first, second, tmp_path):
    pages = [write_comparison(compare_runs(first, second), tmp_path / name).read_bytes() for name in ("a", "b")]
    assert pages[0] == pages[1]
