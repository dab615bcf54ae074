"""What the first screen says before its numbers are believed."""

import dataclasses

import numpy as np
import pytest
from synthetic_results import make_results

from bench.model import Outcome
from bench.report.cautions import list_cautions
from bench.report.ends import END_BEND
from bench.report.headline import summarise
from bench.report.html import render_report
from bench.report.outcome import RunEnd, judge_run
from bench.report.results import Results


def cautions_of(results: Results) -> list[str]:
    return list_cautions(results, summarise(results))


def without(*stretches: tuple[int, int], places: slice = slice(None)) -> Results:
    results = make_results(5)
    for first, last in stretches:
        results.bend_map_per_m[first:last, places] = np.nan
    return results


def test_a_part_of_the_cycle_that_was_never_seen_is_said_first():
    first = cautions_of(without((33, 54)))[0]
    assert first.startswith("At phase 0.33 to 0.54 of the cycle (21.0")
    assert first.endswith("the cable was not seen well enough in any cycle: a tighter bend there would not show.")


def test_of_many_unseen_stretches_the_longest_are_named_in_their_order():
    first = cautions_of(without((0, 2), (10, 30), (40, 45), (60, 70)))[0]
    assert "At phase 0.10 to 0.30, 0.40 to 0.45, 0.60 to 0.70 and others of the cycle" in first


def test_places_that_were_never_seen_are_a_share_of_the_map():
    first = cautions_of(without((0, 100), places=slice(0, 10)))[0]
    assert "of the Bend-radius map is empty in all cycles" in first


@pytest.mark.parametrize("stretch", [(0, 0), (50, 51)])
def test_a_moment_or_nothing_unseen_is_no_caution(stretch):
    assert not any("would not show" in text for text in cautions_of(without(stretch)))


@pytest.mark.parametrize(("last", "outcome"), [(38, Outcome.PASS), (54, Outcome.ERROR)])
def test_a_cable_that_was_not_seen_in_a_tenth_of_the_cycle_has_not_passed(last: int, outcome: Outcome):
    results = without((33, last))
    found, reasons = judge_run(results.cycles, [], RunEnd("success", ""), 1.0, 1.0, results.bend_map_per_m)
    assert found == outcome
    told = cautions_of(dataclasses.replace(results, outcome_reasons=reasons))
    assert sum("At phase 0.33 to" in text for text in [*reasons, *told]) == 1


def test_what_holds_for_the_method_comes_last():
    texts = cautions_of(make_results(5, warnings=["All markers were found in 60 % of the frames."]))
    assert texts[0].startswith("All markers were found")
    assert texts[-1].startswith("Beside the clamps")


def test_the_odd_cycles_have_one_number_of_decimals():
    results = make_results(5, attention={i: ["slow"] for i in range(5)})
    results.cycles.max_curvature_sigma_per_m[:] = [0.1, 0.2, 0.2, 0.2, 2.0]
    page = render_report(results)
    row = page[page.index('<th scope="row" class="n">4</th>') :]
    assert " ± 4.0<" in row


def test_a_warning_that_names_the_clamp_stands_for_the_general_one():
    texts = cautions_of(make_results(5, warnings=[f"{END_BEND} at the end of its curve."]))
    assert texts == [f"{END_BEND} at the end of its curve."]
