"""The report's figures: each a function from `Results` to the text of an SVG element."""

from bench.report.figures.bend_map import bend_map_figure
from bench.report.figures.cycles import completeness_figure, cycles_figure, cycles_per_group
from bench.report.figures.drift import drift_figure
from bench.report.figures.example import drawable_example, example_figure, n_points_outside

__all__ = [
    "bend_map_figure",
    "completeness_figure",
    "cycles_figure",
    "cycles_per_group",
    "drawable_example",
    "drift_figure",
    "example_figure",
    "n_points_outside",
]
