"""``report.html``: one file that opens offline in any browser, prints on A4, and asks the network for nothing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from bench.model import Severity
from bench.report.cautions import list_cautions
from bench.report.drift_text import describe_drift_section
from bench.report.figures import (
    bend_map_figure,
    completeness_figure,
    cycles_figure,
    cycles_per_group,
    drawable_example,
    drift_figure,
    example_figure,
    n_points_outside,
)
from bench.report.headline import summarise
from bench.report.methods import describe_methods
from bench.report.outcome import IMPORT
from bench.report.pages import render_page, write_page
from bench.report.results import NotedLine, Results
from bench.report.wording import (
    NBSP,
    count_decimals,
    describe_clocks,
    describe_cycles,
    describe_ending,
    describe_interval,
    describe_losses,
    describe_outcome,
    describe_place,
    describe_seen,
    find_worst_residual_us,
    say_mm,
    say_number,
    say_percent,
    say_radius,
    say_short_time,
    say_utc,
)

__all__ = ["ATTENTION_ROWS", "REPORT_NAME", "render_report", "write_report"]

REPORT_NAME = "report.html"
ATTENTION_ROWS = 200
"""Most rows in the table of odd cycles: four printed pages; the rest is in ``cycles.parquet``."""
NOTED_ROWS = 200
"""Most lines of the run's log: a night with a loose plug gives thousands; they are in the recording."""


@dataclass(frozen=True)
class _OddCycle:
    """One row of the table of cycles that need a look; everything as text."""

    index: int
    start: str
    duration: str
    verdict: str
    complete: str
    curvature: str
    radius: str
    place: str
    reasons: list[str]


def write_report(results: Results, folder: Path) -> Path:
    """Write ``report.html`` into `folder`, which is made when it does not exist.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    RecordingExistsError
        The folder already holds a report.
    RecordingError, DiskFullError
        The folder cannot be written.
    """
    return write_page(folder / REPORT_NAME, render_report(results))


def render_report(results: Results) -> str:
    """Return the text of the page; the same results give the same text."""
    return render_page("report.html.j2", _context(results))


def _context(results: Results) -> dict[str, Any]:
    headline = summarise(results)
    odd = sorted(results.attention)
    return {
        "results": results,
        "headline": headline,
        "outcome": describe_outcome(results, headline),
        "ending": describe_ending(results),
        "cautions": list_cautions(results, headline),
        "cycles": describe_cycles(headline, len(odd)),
        "radius": say_radius(headline.tightest.radius_mm, headline.tightest.low_mm) if headline.tightest else "",
        "interval": describe_interval(headline.tightest) if headline.tightest else "",
        "place": describe_place(headline.tightest) if headline.tightest else "",
        "losses": describe_losses(headline),
        "seen": describe_seen(results),
        "clocks": describe_clocks([] if results.exit_status == IMPORT else results.clocks),
        "worst_residual": say_short_time(find_worst_residual_us(results.clocks)).split(NBSP),
        "figures": _figures(results),
        "captions": _captions(results),
        "odd_cycles": _list_odd_cycles(results, odd[:ATTENTION_ROWS]),
        "n_odd": len(odd),
        "drift": describe_drift_section(results),
        "noted": _choose_noted(results.noted),
        "methods": describe_methods(results),
        "files": FILES | (DRIFT_FILE if results.drift else {}),
    }


FILES = {
    "cycles.parquet": "one row per cycle: times, verdict, largest curvature and smallest bend radius",
    "markers.parquet": "one row per tracker frame: the sorted markers, in the lab frame",
    "curvature.parquet": "one row per tracker frame: curvature and its standard deviation along the cable",
    "summary.json": "the numbers of this report's first page, versions and methods",
}
DRIFT_FILE = {"drift.parquet": "one row per cycle: how far its shape and largest curvature are from the first cycles"}


def _figures(results: Results) -> dict[str, Markup]:
    """Return the figures as markup: made here, and every word in them escaped by their maker."""
    makers = {
        "example": example_figure,
        "cycles": cycles_figure,
        "completeness": completeness_figure,
        "bend_map": bend_map_figure,
        "drift": drift_figure,
    }
    return {name: Markup(make(results)) for name, make in makers.items()}  # noqa: S704 - SVG of our own making


def _captions(results: Results) -> dict[str, str]:
    return {"example": _example_caption(results), "cycles": _cycles_caption(results)}


def _example_caption(results: Results) -> str:
    example = drawable_example(results)
    if example is None:
        return ""
    place = "outside any cycle" if example.cycle_index < 0 else f"cycle {example.cycle_index}"
    if np.isfinite(example.cycle_phase):
        place += f", phase {example.cycle_phase:.3f}"
    outside = n_points_outside(example)
    beyond = f"; {outside} of them outside the picture" if outside else ""
    chosen = "a complete frame near the tightest bend of a usual cycle"
    return f"Frame {example.frame_number}, {place}: {chosen}; {example.points_m.shape[0]} points recorded{beyond}."


def _cycles_caption(results: Results) -> str:
    value = results.cycles.max_curvature_per_m
    value = value[np.isfinite(value) & (value > 0)]
    if not value.size:
        return ""
    radius_mm = 1e3 / value
    if value.size == 1:
        return ""
    typical = (
        f"Smallest bend radius of a cycle: median {say_mm(float(np.median(radius_mm)))} mm, "
        f"from {say_mm(float(radius_mm.min()))} to {say_mm(float(radius_mm.max()))} mm."
    )
    size = cycles_per_group(results.cycles.cycle_index.size)
    return typical if size == 1 else f"{typical} {size} neighbouring cycles share one place along the axis."


def _list_odd_cycles(results: Results, indices: list[int]) -> list[_OddCycle]:
    """Return the rows of the table; all have as many decimals as the interval of a usual cycle leaves them."""
    cycles = results.cycles
    known = np.isfinite(cycles.max_curvature_sigma_per_m) & (cycles.max_curvature_per_m > 0)
    if not known.any():
        return [_odd_cycle(results, index, 2, 1) for index in indices]
    band = 2 * float(np.median(cycles.max_curvature_sigma_per_m[known]))
    value = float(np.median(cycles.max_curvature_per_m[known]))
    digits, radius_digits = count_decimals(band), count_decimals(1e3 / value - 1e3 / (value + band))
    return [_odd_cycle(results, index, digits, radius_digits) for index in indices]


def _odd_cycle(results: Results, index: int, digits: int, radius_digits: int) -> _OddCycle:
    """Return the row of one cycle; a cycle without a row of its own in the table still shows its reasons."""
    cycles = results.cycles
    rows = np.flatnonzero(cycles.cycle_index == index)
    if not rows.size:
        return _OddCycle(index, "–", "–", "–", "–", "–", "–", "–", results.attention[index])
    row = int(rows[0])
    value, sigma = float(cycles.max_curvature_per_m[row]), float(cycles.max_curvature_sigma_per_m[row])
    return _OddCycle(
        index=index,
        start=say_utc(int(cycles.start_ns[row])),
        duration=say_number(float(cycles.duration_s[row]), 2),
        verdict=str(cycles.verdict[row]),
        complete=say_percent(float(cycles.complete_fraction[row])),
        curvature=_with_band(value, sigma, digits),
        radius=say_number(float(cycles.min_bend_radius_mm[row]), radius_digits),
        place=say_number(1e3 * float(cycles.max_curvature_arc_length_m[row]), 0),
        reasons=results.attention[index],
    )


def _choose_noted(noted: list[NotedLine]) -> list[NotedLine]:
    """Return what there is room for: where it is too much, warnings and errors come first."""
    if len(noted) > NOTED_ROWS:
        noted = [line for line in noted if line.severity > Severity.INFO]
    return noted[:NOTED_ROWS]


def _with_band(value: float, sigma: float, digits: int) -> str:
    known = np.isfinite(sigma) and np.isfinite(value)
    return say_number(value, digits) + (f" ± {say_number(2 * sigma, digits)}" if known else "")
