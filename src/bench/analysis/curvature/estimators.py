"""Estimators of the cable's curve, chosen by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from bench.analysis.curvature.best_curve import estimate_best
from bench.analysis.curvature.elastica import fit_elastica
from bench.analysis.curvature.estimate import CurveEstimator
from bench.analysis.curvature.menger import fit_menger_gp
from bench.analysis.curvature.spline import fit_spline
from bench.errors import AnalysisError

__all__ = ["ESTIMATORS", "get_estimator"]

ESTIMATORS: Mapping[str, CurveEstimator] = MappingProxyType(
    {"elastica": fit_elastica, "menger_gp": fit_menger_gp, "spline": fit_spline}
)
"""Estimators by the names of `[analysis] curvature`."""


def get_estimator(name: str) -> CurveEstimator:
    """Return the estimator of that name; 'auto' is `estimate_best`, which chooses for each place.

    Raises
    ------
    AnalysisError
        There is no estimator of that name.
    """
    if name == "auto":
        return estimate_best
    if name not in ESTIMATORS:
        known = ", ".join(ESTIMATORS)
        raise AnalysisError(f"There is no curvature method '{name}'.", hint=f"Choose one of: auto, {known}.")
    return ESTIMATORS[name]
