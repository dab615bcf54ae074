"""The numbers of the first screen, and the words around them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from synthetic_results import GRID_M, make_results

from bench.model import Outcome
from bench.report.headline import (
    Headline,
    TightestBend,
    find_tightest_bend,
    find_unjudged_bend,
    summarise,
)
from bench.report.methods import describe_methods, warn_about_clamps
from bench.report.results import ClockFinding, StreamFinding
from bench.report.wording import (
    describe_clocks,
    describe_cycles,
    describe_ending,
    describe_interval,
    describe_losses,
    describe_outcome,
    describe_place,
    describe_seen,
    say_mm,
    say_number,
    say_percent,
    say_radius,
    say_range,
    say_short_time,
    say_utc,
    say_versions,
)

THIN, MINUS = "\u202f", "\u2212"


def with_maxima(values: list[float], verdicts: list[str] | None = None):
    results = make_results(len(values))
    value = np.array(values)
    cycles = dataclasses.replace(
        results.cycles,
        max_curvature_per_m=value,
        min_bend_radius_mm=1e3 / value,
        verdict=verdicts or ["ok"] * len(values),
    )
    return dataclasses.replace(results, cycles=cycles)


def bend(**changes: float) -> TightestBend:
    return dataclasses.replace(TightestBend(4, 60.0, 58.0, 62.0, 120.0, 0.25), **changes)


def test_the_tightest_bend_is_found_with_its_cycle_place_and_phase():
    results = make_results(20, per_cycle=50)
    frames = results.frames
    frames.curvature_per_m[7 * 50 + 13, 42] = 25.0
    cycles = results.cycles
    cycles.max_curvature_per_m[7] = 25.0
    cycles.max_curvature_arc_length_m[7] = GRID_M[42]
    found = find_tightest_bend(results)
    assert found.cycle_index == 7
    assert found.radius_mm == pytest.approx(40.0)
    assert found.arc_length_mm == pytest.approx(1e3 * GRID_M[42])
    assert found.cycle_phase == pytest.approx(13.5 / 50)
    assert (found.low_mm, found.high_mm) == pytest.approx((1e3 / 25.3, 1e3 / 24.7))


def test_a_cycle_that_was_not_recorded_whole_does_not_make_the_headline_but_is_named():
    results = with_maxima([10.0, 40.0, 12.0], ["ok", "interrupted", "slow"])
    assert find_tightest_bend(results).cycle_index == 2
    assert find_unjudged_bend(results).cycle_index == 1
    assert find_unjudged_bend(with_maxima([10.0, 11.0], ["ok", "gap"])).cycle_index == 1
    assert find_unjudged_bend(with_maxima([12.0, 11.0], ["ok", "gap"])) is None


def test_without_a_sound_cycle_the_others_make_the_headline():
    results = with_maxima([10.0, 40.0], ["gap", "interrupted"])
    assert find_tightest_bend(results).cycle_index == 1
    assert find_unjudged_bend(results) is None


def test_no_curvature_at_all_gives_no_tightest_bend():
    assert find_tightest_bend(with_maxima([math.nan, math.nan])) is None
    assert find_tightest_bend(make_results(0)) is None
    assert summarise(make_results(0)).n_cycles == 0


def test_a_maximum_without_a_place_has_no_phase():
    results = make_results(3)
    results.cycles.max_curvature_arc_length_m[:] = np.nan
    assert math.isnan(find_tightest_bend(results).cycle_phase)


def test_an_unknown_noise_gives_an_unknown_interval():
    assert describe_interval(bend(low_mm=math.nan, high_mm=math.nan)) == "uncertainty not known"


def test_intervals_and_places_read_as_words():
    assert describe_interval(bend()) == "58.0 to 62.0\u00a0mm (± 2\u00a0sd)"
    assert describe_interval(bend(high_mm=math.inf)).startswith("58.0\u00a0mm or more")
    assert describe_place(bend()) == "120\u00a0mm from the anchor, cycle\u00a04, phase\u00a00.25"
    assert describe_place(bend(cycle_phase=math.nan, arc_length_mm=math.nan)) == "cycle\u00a04"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (4.136, "4.14"),
        (65.55, "65.5"),
        (1140.0, "1140"),
        (12345.0, f"12{THIN}345"),
        (math.nan, "–"),
        (math.inf, "∞"),
        (0.0, "0.00"),
    ],
)
def test_lengths_have_about_four_figures(value, text):
    assert say_mm(value) == text


def test_numbers_use_a_real_minus_and_group_thousands_from_five_digits_on():
    assert say_number(1234.5, 1) == "1234.5"
    assert say_number(12345.0, 0) == f"12{THIN}345"
    assert say_number(-1234567.5, 1) == f"{MINUS}1{THIN}234{THIN}567.5"


@pytest.mark.parametrize(("fraction", "text"), [(1.0, "100.0"), (0.99999, "99.9"), (0.0, "0.0")])
def test_only_what_is_whole_reads_a_hundred_per_cent(fraction, text):
    assert say_percent(fraction) == f"{text}{THIN}%"


def test_times_are_utc_to_the_millisecond():
    assert say_utc(1_772_654_405_123_999_999) == "2026-03-04 20:00:05.123"
    assert say_utc(-1) == "–"


def test_a_pass_claims_no_more_than_was_measured():
    assert describe_outcome(make_results(3), summarise(make_results(3)))[0].startswith("No bend tighter than")
    unseen = with_maxima([math.nan])
    assert describe_outcome(unseen, summarise(unseen)) == ["The bench found nothing against the cable in this run."]


def test_a_fail_by_the_limit_names_the_limit_and_its_reasons_follow():
    results = dataclasses.replace(with_maxima([20.0]), outcome=Outcome.FAIL, outcome_reasons=["Here."])
    sentences = ["The cable was bent tighter than its catalogue limit of 60 mm.", "Here."]
    assert describe_outcome(results, summarise(results)) == sentences


@pytest.mark.parametrize(
    ("status", "words"),
    [
        ("success", "The run ended as planned: all done."),
        ("abort", "The run was aborted: all done."),
        ("fail", "The run failed: all done."),
        ("unfinished", "The recording was never finished: all done."),
        ("import", "All done."),
        ("odd", "The run ended with status odd: all done."),
    ],
)
def test_every_way_a_run_can_end_is_one_sentence(status, words):
    assert describe_ending(make_results(1, exit_status=status, exit_reason="all done.")) == words


def test_losses_read_as_one_line():
    nothing = Headline(1, 1, 60.0, None, 0, 0, {})
    assert describe_losses(nothing) == "no stream is counted in this recording"
    assert describe_losses(dataclasses.replace(nothing, n_recorded=5)).startswith("nothing dropped, nothing missed")
    lossy = dataclasses.replace(nothing, missed_from={"tracker": 5, "robot": 2})
    assert (
        describe_losses(lossy)
        == "0 dropped by the bench, 7 never came from the tracker and the robot; 0 records written"
    )


def test_a_frame_that_never_came_counts_once_though_two_topics_miss_it():
    lost = [StreamFinding(topic, 100.0, 98, 98, 0, 2) for topic in ("/tracker/frame", "/tracker/points")]
    results = make_results(2, streams=[StreamFinding("/robot/state", 500.0, 9, 9, 0, 0), *lost])
    assert summarise(results).missed_from == {"tracker": 2}
    assert summarise(results).n_missed == 2


def test_a_limit_inside_the_interval_is_said_beside_the_verdict():
    results = with_maxima([1 / 0.0601])
    results.cycles.max_curvature_sigma_per_m[:] = 0.5
    assert describe_outcome(results, summarise(results))[-1].startswith("The limit lies inside the interval")


@pytest.mark.parametrize(
    ("low_mm", "radius", "interval"),
    [(125.4, "138", "125 to 152"), (136.4, "137.6", "136.4 to 152.3"), (137.5, "137.64", "137.50 to 152.31")],
)
def test_a_radius_has_no_more_figures_than_its_interval_leaves_it(low_mm, radius, interval):
    assert say_radius(137.64, low_mm) == radius
    assert say_range(137.64, low_mm, 152.31) == interval


def test_a_radius_of_unknown_uncertainty_has_about_four_figures():
    assert say_radius(137.64, math.nan) == "137.6"


@pytest.mark.parametrize(
    ("time_us", "text"), [(70.6, "71\u00a0µs"), (1842.0, "1.8\u00a0ms"), (15_300.0, "15\u00a0ms"), (math.nan, "–")]
)
def test_a_short_time_is_told_in_the_unit_that_suits_it(time_us, text):
    assert say_short_time(time_us) == text


def test_versions_that_recorded_are_told_from_those_that_analysed():
    versions = {"recorded with cable-bench": "0.1.0", "recorded with mcap": "1.6.0", "bench": "0.2.0", "python": "3.12"}
    assert (
        say_versions(versions) == "recorded with cable-bench 0.1.0, mcap 1.6.0; analysed with bench 0.2.0, python 3.12"
    )
    assert say_versions({"bench": "0.2.0"}) == "analysed with bench 0.2.0"


def test_cycles_that_are_ok_and_need_a_look_are_not_called_all_ok():
    headline = summarise(make_results(3))
    assert describe_cycles(headline, 0) == "all ok"
    assert describe_cycles(headline, 3) == "all recorded whole"


def test_how_much_was_seen_is_said_unless_there_was_nothing_to_see():
    assert describe_seen(make_results(0)) == ""
    assert describe_seen(make_results(3)).startswith("every marker found in ")


def test_clocks_read_as_one_line_for_each_device():
    def clock(device: str, segment: int, drift: float, residual: float) -> ClockFinding:
        return ClockFinding(device, segment, "echoes", 0.0, drift, residual, 9)

    assert describe_clocks([clock("robot", 0, -3.0, 9.0)]) == [f"robot: drift {MINUS}3.0\u00a0ppm, residual 9\u00a0µs"]
    assert describe_clocks([clock("robot", 0, 1, 9.0), clock("robot", 1, 2, 30.0)]) == [
        "robot: 2 segments, residual 30\u00a0µs at most"
    ]
    assert describe_clocks([clock("take", 0, math.nan, math.nan)]) == ["take: residual not known"]


def test_the_papers_methods_come_with_their_known_faults():
    notes = {note.step: note.limits for note in describe_methods(make_results(1))}
    assert list(notes) == ["cycles", "sorting", "curvature", "largest curvature", "uncertainty"]
    assert "33, 61 and 74 %" in notes["curvature"]
    assert "64 %" in notes["sorting"]
    assert "above the truth" in notes["largest curvature"]
    assert "0.2 mm" in notes["uncertainty"]


def test_a_method_without_figures_is_said_to_have_none():
    results = make_results(1, methods={"curvature": "a ruler", "extra": "new"})
    assert {note.limits for note in describe_methods(results)[:2]} == {
        "No figures for this method are kept with this report."
    }
    assert warn_about_clamps(results) == ""
