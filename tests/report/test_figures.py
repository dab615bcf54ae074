"""The figures: the same bytes every time, well-formed, and drawn from whatever an analysis can leave."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from functools import cache
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest
from synthetic_results import GRID_M, curvature_at, make_results

from bench.report.figures import (
    bend_map_figure,
    completeness_figure,
    cycles_figure,
    cycles_per_group,
    example_figure,
    n_points_outside,
)
from bench.report.figures.axes import cell_edges
from bench.report.results import Results

Maker = Callable[[Results], str]
FIGURES: list[Maker] = [example_figure, cycles_figure, completeness_figure, bend_map_figure]
SVG = "{http://www.w3.org/2000/svg}"


def words(svg: str) -> str:
    return " ".join(text.strip() for text in ElementTree.fromstring(svg).itertext() if text.strip())


@cache
def drawn(figure: Maker) -> str:
    """Return a figure of three usual cycles."""
    return figure(make_results(3))


@pytest.mark.parametrize("figure", FIGURES)
def test_a_figure_is_the_same_text_every_time(figure):
    assert figure(make_results(3)) == drawn(figure)


@pytest.mark.parametrize("figure", FIGURES)
def test_a_figure_is_well_formed_and_says_what_it_shows(figure):
    root = ElementTree.fromstring(drawn(figure))
    assert root.tag == f"{SVG}svg"
    assert root.get("viewBox")
    assert root.find(f"{SVG}title").text
    assert root.find(f"{SVG}desc").text


def test_no_two_figures_share_an_id_and_every_reference_has_its_target():
    ids: list[str] = []
    for figure in FIGURES:
        svg = drawn(figure)
        own = re.findall(r'\sid="([^"]+)"', svg)
        referred = re.findall(r'url\(#([^)]+)\)|href="#([^"]+)"', svg)
        assert {a or b for a, b in referred} <= set(own)
        ids += own
    assert len(ids) == len(set(ids))


def test_drawing_leaves_the_settings_of_matplotlib_as_they_were():
    before = dict(mpl.rcParams)
    cycles_figure(make_results(3))
    assert dict(mpl.rcParams) == before


def test_a_users_matplotlibrc_does_not_change_the_report():
    usual = drawn(cycles_figure)
    with mpl.rc_context({"lines.linewidth": 9, "font.size": 20, "axes.facecolor": "k", "svg.fonttype": "path"}):
        assert cycles_figure(make_results(3)) == usual


@pytest.mark.parametrize("n_cycles", [0, 1, 2, 61, 1001, 10_000])
def test_every_number_of_cycles_is_drawn_small(n_cycles):
    results = make_results(n_cycles, per_cycle=2)
    for figure in (cycles_figure, completeness_figure):
        assert len(figure(results)) < 300_000


def test_at_most_a_thousand_places_along_the_cycle_axis():
    assert [cycles_per_group(n) for n in (0, 1, 1000, 1001, 10_000, 1_000_000)] == [1, 1, 1, 2, 10, 1000]


def test_many_cycles_say_how_many_share_a_place():
    assert "median of 10 cycles" in words(cycles_figure(make_results(10_000, per_cycle=1)))


def test_the_catalogue_limit_is_named_in_every_figure_that_shows_bends():
    assert "catalogue limit 60 mm" in words(drawn(cycles_figure))
    assert "catalogue limit 60 mm" in words(drawn(example_figure))
    assert "60 limit" in words(drawn(bend_map_figure))


def test_a_map_with_tight_bends_outlines_them():
    results = make_results(3, bend_map_per_m=2 * curvature_at(np.arange(100) / 100))
    assert "tighter than the catalogue limit" in words(bend_map_figure(results))
    assert "tighter than the catalogue limit" not in words(drawn(bend_map_figure))


def test_a_map_with_holes_says_not_seen():
    seen = curvature_at(np.arange(100) / 100)
    holes = seen.copy()
    holes[10:20, 30:50] = np.nan
    assert "not seen" in words(bend_map_figure(make_results(3, bend_map_per_m=holes)))
    assert "not seen" not in words(drawn(bend_map_figure))


def test_the_map_is_a_picture_inside_the_svg():
    svg = drawn(bend_map_figure)
    assert len(ElementTree.fromstring(svg).findall(f".//{SVG}image")) >= 1
    assert len(svg) < 300_000


def test_a_map_of_noise_stays_small():
    noise = np.abs(np.random.default_rng(1).normal(16.7, 5, (50, 2000)))
    results = make_results(
        1, bend_map_per_m=noise, phase_grid=(np.arange(50) + 0.5) / 50, arc_length_m=np.linspace(0.05, 1.15, 2000)
    )
    assert len(bend_map_figure(results)) < 1_000_000


def test_a_map_of_one_cell_is_drawn():
    results = make_results(
        1, bend_map_per_m=np.full((1, 1), 5.0), phase_grid=np.array([0.5]), arc_length_m=np.array([0.3])
    )
    assert "bend radius (mm)" in words(bend_map_figure(results))


def test_a_straight_cable_is_drawn():
    results = make_results(1, bend_map_per_m=np.zeros((100, GRID_M.size)))
    assert "bend radius (mm)" in words(bend_map_figure(results))


@pytest.mark.parametrize("figure", FIGURES)
def test_nothing_seen_gives_one_sentence_instead_of_axes(figure):
    nothing = np.full(3, np.nan)
    cycles = dataclasses.replace(
        make_results(3).cycles,
        max_curvature_per_m=nothing,
        max_curvature_sigma_per_m=nothing,
        complete_fraction=nothing,
    )
    empty = make_results(3, cycles=cycles, example=None, bend_map_per_m=np.full((100, GRID_M.size), np.nan))
    assert re.search(r"No (frame|cycle|place) ", words(figure(empty)))
    assert "(mm)" not in words(figure(empty))


def test_an_example_without_a_single_marker_is_not_drawn():
    example = make_results(1).example
    example = dataclasses.replace(example, position_m=np.full((10, 3), np.nan, dtype=np.float32))
    assert "No frame was complete enough" in words(example_figure(make_results(1, example=example)))


def test_an_example_with_gaps_keeps_the_markers_numbers():
    example = make_results(1).example
    position = example.position_m.copy()
    position[3] = np.nan
    curve = example.curve_m.copy()
    curve[30:40] = np.nan
    svg = example_figure(make_results(1, example=dataclasses.replace(example, position_m=position, curve_m=curve)))
    numbers = re.findall(r"\b\d\b", words(svg).split("(b)", 1)[1].split("(c)", 1)[0])
    assert {"0", "2", "4", "9"} <= set(numbers)


def test_a_ghost_far_away_is_counted_and_does_not_shrink_the_cable():
    assert n_points_outside(make_results(1).example) == 1


def test_points_without_a_noise_estimate_have_no_band_in_the_legend():
    results = make_results(5)
    cycles = dataclasses.replace(results.cycles, max_curvature_sigma_per_m=np.full(5, np.nan))
    assert "± 2" not in words(cycles_figure(dataclasses.replace(results, cycles=cycles)))
    assert "± 2" in words(cycles_figure(results))


def test_a_wild_cycle_is_marked_at_the_edge_and_named():
    results = make_results(20)
    value = results.cycles.max_curvature_per_m.copy()
    value[4] = 5000.0
    cycles = dataclasses.replace(results.cycles, max_curvature_per_m=value)
    assert "off the scale, to 5e+03 1/m" in words(cycles_figure(dataclasses.replace(results, cycles=cycles)))


def test_cells_lie_around_their_centres():
    assert cell_edges(np.array([0.25, 0.75]), 0, 1).tolist() == [0.0, 0.5, 1.0]
    assert cell_edges(np.array([0.3])).tolist() == [-0.2, 0.8]
