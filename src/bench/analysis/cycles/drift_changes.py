"""Lasting changes and slow trends in a series of one value for each cycle, with a known rate of false alarms.

The series is described as a level and steps, with or without a line, which is straight or, where it stands out, may be
bent: wear that speeds up is no staircase. Step after step is taken in, each time the one that explains most, until none
stands out of what the series does by itself; of these descriptions the one that says most in fewest parts is kept.

The null hypothesis is a stationary series whose values may be correlated over up to an eleventh of its length: noise is
measured on the differences of neighbouring means at all scales up to that, and the largest counts. What wanders more
slowly, such as a bench that warms up over the first hundred cycles of a thousand, is a change, and is found as one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Floats

__all__ = ["FEWEST_VALUES", "LevelChange", "SeriesDrift", "describe_drift"]

FEWEST_VALUES = 20
"""With fewer values no change short of all but two or three of them being different stands out."""
MOST_CHANGES = 10
"""A series with more of them is a curve, and needs eyes."""
LONGEST_SCALE = 11
"""Noise is measured up to this part of the series: beyond it one change there and back would pass for noise."""
LIMITS_AT: Floats = np.array([20.0, 35.0, 50.0, 100.0, 200.0, 500.0, 2000.0, 10_000.0, 100_000.0])
LIMITS: Floats = np.array([13.4, 8.3, 6.4, 5.2, 4.6, 4.1, 3.8, 3.9, 4.2])
"""What the largest score exceeds once in 250 series of so many values without any change.

Simulated 2026-11: up to 2000 values with a correlation of 0.6 between neighbours (first-order autoregressive), above of
white noise. Two quantities are watched, so that about 1 of 125 runs has an alarm, fewer where cycles err independently.
"""
HIGHEST_DEGREE = 2
"""Of the line: a series that turns twice is a curve, and needs eyes."""
LEAST_LASTING = 3
"""Values on either side of a lasting change: fewer are bad cycles."""
OUTLIER_RATIO = 5.0
"""A value this many standard deviations off its four neighbours is a bad cycle and no lasting change."""
ROUNDING = 1e-9
"""Part of the values below which a residual is that of the arithmetic."""
NORMAL_QUARTILE = 0.6745
"""Median of the absolute value of a standard normal variable."""


@dataclass(frozen=True)
class LevelChange:
    """A lasting step."""

    at: int
    """Index of the first value after it."""
    size: float
    sigma: float
    """Standard deviation of the size."""


@dataclass(frozen=True, eq=False)
class SeriesDrift:
    """What a series does besides its noise."""

    changes: list[LevelChange]
    """In order."""
    slope: float
    """Of the line through what the steps leave, per value: on the whole, where it is bent."""
    slope_sigma: float
    is_trend: bool
    """Whether the line stands out of the noise, as a step must."""
    fitted: Floats
    """(n,): level, steps, and the line where it stands out, bent where that does; NaN where the value is."""


def describe_drift(values: Floats) -> SeriesDrift:
    """Describe a series (n,) of which values may be missing (NaN).

    Parameters
    ----------
    values : (n,)
        One for each cycle, in order; at least `FEWEST_VALUES` finite ones.

    Returns
    -------
    SeriesDrift
        Indices are those of `values`.
    """
    known = np.flatnonzero(np.isfinite(values))
    series, place = _without_outliers(values[known]), known.astype(np.float64)
    models = _fit_models(series, place)
    noise = min(_measure_noise(model.rest) for model in models)
    best = min(models, key=lambda model: model.cost(noise))
    line = best if best.degree else _Model(series, place, best.steps, degree=1)
    fitted = np.full(len(values), np.nan)
    fitted[known] = series - best.rest
    changes = [LevelChange(int(known[at]), *best.size_of(i)) for i, at in enumerate(best.steps)]
    return SeriesDrift(changes, line.slope, line.slope_sigma, best.degree > 0, fitted)


class _Model:
    """Level, steps and perhaps a line, fitted to a series.

    The line's `degree` is 0 for none, 1 for a straight one, 2 for a bent one.
    """

    def __init__(self, series: Floats, place: Floats, steps: list[int], degree: int) -> None:
        self.steps, self.degree = steps, degree
        design = _design(place, steps, degree)
        self._size = np.linalg.lstsq(design, series, rcond=None)[0]
        self.rest = series - design @ self._size
        bounds = list(zip([0, *steps], [*steps, len(series)], strict=True))
        everywhere = _measure_noise(self.rest)
        noise = [
            _measure_noise(self.rest[low:high]) if high - low >= FEWEST_VALUES else everywhere for low, high in bounds
        ]
        self._error = [one / np.sqrt(high - low) for one, (low, high) in zip(noise, bounds, strict=True)]
        self._sigma = max(noise) * np.sqrt(np.diagonal(np.linalg.inv(design.T @ design)))

    @property
    def slope(self) -> float:
        """Of a line of any degree."""
        return float(self._size[1 + len(self.steps)])

    @property
    def slope_sigma(self) -> float:
        return float(self._sigma[1 + len(self.steps)])

    @property
    def is_sound(self) -> bool:
        """Whether a line, or its bend if it has one, stands out of the noise."""
        return not self.degree or bool(abs(self._size[-1]) > _limit(len(self.rest)) * self._sigma[-1])

    def cost(self, noise: float) -> float:
        """Return what is left unexplained, and what each part must explain at least: the less the better."""
        parts = len(self.steps) + self.degree
        return float(self.rest @ self.rest) + parts * (_limit(len(self.rest)) * noise) ** 2

    def size_of(self, i: int) -> tuple[float, float]:
        """Return the size of a step and its standard deviation."""
        return float(self._size[1 + i]), float(np.hypot(self._error[i], self._error[i + 1]))


def _fit_models(series: Floats, place: Floats) -> list[_Model]:
    """Return the descriptions to choose from: a line only where it stands out, bent only where that does too."""
    models: list[_Model] = []
    for degree in range(HIGHEST_DEGREE + 1):
        model = _Model(series, place, _find_steps(series, place, degree), degree)
        if not model.is_sound:
            break
        models.append(model)
    return models


def _find_steps(series: Floats, place: Floats, degree: int) -> list[int]:
    """Take in step after step, each time the one that explains most, until none stands out."""
    steps: list[int] = []
    while len(steps) < MOST_CHANGES:
        design = _design(place, steps, degree)
        rest = series - design @ np.linalg.lstsq(design, series, rcond=None)[0]
        rest[np.abs(rest) < ROUNDING * np.abs(series).max()] = 0.0
        at = _find_step(rest, steps)
        if at < 0:
            break
        steps = sorted([*steps, at])
    return steps


def _without_outliers(series: Floats) -> Floats:
    """Return the series with each lone outlier replaced by the median of its neighbourhood."""
    padded = np.pad(series, 2, mode="reflect")
    near = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
    sigma = float(np.median(np.abs(np.diff(series)))) / NORMAL_QUARTILE / np.sqrt(2.0)
    return np.where(np.abs(series - near) > OUTLIER_RATIO * sigma, near, series)


def _measure_noise(series: Floats) -> float:
    """Return the standard deviation that one value must have for means to scatter as they do.

    Differences of neighbouring means over 1, 2, 4 … values; of white noise each gives the same, of correlated noise
    the longer ones give more. The medians make it blind to a line, and to the few differences that span a step.
    """
    sums = np.concatenate([[0.0], np.cumsum(series - series.mean())])
    noise, scale = 0.0, 1
    while scale <= max(len(series) // LONGEST_SCALE, 1):
        mean = (sums[scale:] - sums[:-scale]) / scale
        difference = mean[scale:] - mean[:-scale]
        apart = float(np.median(np.abs(difference - np.median(difference)))) / NORMAL_QUARTILE
        noise = max(noise, apart * np.sqrt(scale / 2.0))
        scale *= 2
    return noise


def _limit(n_values: int) -> float:
    return float(np.interp(np.log(n_values), np.log(LIMITS_AT), LIMITS))


def _design(place: Floats, steps: list[int], degree: int) -> Floats:
    """Return the columns: level, steps, line, and a bend that leaves the line's slope what it is on the whole."""
    index, centred = np.arange(len(place)), place - place.mean()
    columns = [np.ones(len(place)), *(np.where(index >= at, 1.0, 0.0) for at in steps)]
    if degree > 0:
        columns.append(centred)
    if degree > 1:
        bend = np.square(centred / np.abs(centred).max())
        columns.append(bend - bend.mean() - centred * (bend @ centred) / (centred @ centred))
    return np.stack(columns, axis=1)


def _find_step(rest: Floats, steps: list[int]) -> int:
    """Return where the step is that explains most of the residual, -1 if none stands out.

    Each stretch between two steps has its own noise: a cable that has changed may scatter more than before.
    """
    best, score = -1, 0.0
    for low, high in zip([0, *steps], [*steps, len(rest)], strict=True):
        n = high - low
        if n < FEWEST_VALUES:
            continue
        left, part = np.arange(LEAST_LASTING, n - LEAST_LASTING + 1), rest[low:high] - rest[low:high].mean()
        explained = np.abs(np.cumsum(part)[left - 1]) * np.sqrt(n / (left * (n - left)))
        largest = float(explained.max())
        if largest > max(score, _limit(n) * _measure_noise(part)):
            best, score = low + int(left[explained.argmax()]), largest
    return best
