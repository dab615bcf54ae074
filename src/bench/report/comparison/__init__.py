"""Two motions of a cable against each other, by eq. (6) of the paper."""

from bench.report.comparison.compare import Comparison, compare_runs, compare_with_shape
from bench.report.comparison.output import COMPARISON_FILES, write_comparison
from bench.report.comparison.text import describe_comparison

__all__ = [
    "COMPARISON_FILES",
    "Comparison",
    "compare_runs",
    "compare_with_shape",
    "describe_comparison",
    "write_comparison",
]
