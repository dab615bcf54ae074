"""Lasting changes and slow trends in a series of one value for each cycle, with a known rate of false alarms.

The series is described as a level, a straight line and steps. Part after part is taken in, each time the one that
explains most, until none stands out of what the series does by itself.

The null hypothesis is a stationary series whose values may be correlated over up to an eleventh of its length: noise is
measured on the differences of neighbouring means at all scales up to that, and the largest counts. What wanders more
slowly, such as a bench that warms up over the first hundred cycles of a thousand, is a change, and is found as one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Floats, Ints

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
    """Of the straight line through what the steps leave, per value."""
    slope_sigma: float
    is_trend: bool
    """Whether the line stands out of the noise, as a step must."""
    fitted: Floats
    """(n,): level, steps, and the line where it stands out; NaN where the value is."""


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
    steps: list[int] = []
    has_line = False
    while len(steps) < MOST_CHANGES:
        model = _design(place, steps, has_line)
        rest = series - model @ np.linalg.lstsq(model, series, rcond=None)[0]
        rest[np.abs(rest) < ROUNDING * np.abs(series).max()] = 0.0
        at, step_score = _find_step(rest, steps)
        line_score = 0.0 if has_line else _score_line(rest, place, model)
        if line_score > step_score:
            has_line = True
        elif step_score > 0.0:
            steps = sorted([*steps, at])
        else:
            break
    found = _fit(values, known, series, steps, has_line)
    # a line that was taken in for the sum of several steps has nothing left to explain beside them
    if has_line and abs(found.slope) <= _limit(len(series)) * found.slope_sigma:
        found = _fit(values, known, series, steps, has_line=False)
    return found


def _without_outliers(series: Floats) -> Floats:
    """Return the series with each lone outlier replaced by the median of its neighbourhood."""
    padded = np.pad(series, 2, mode="edge")
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


def _design(place: Floats, steps: list[int], has_line: bool) -> Floats:
    index = np.arange(len(place))
    columns = [np.ones(len(place)), *(np.where(index >= at, 1.0, 0.0) for at in steps)]
    if has_line:
        columns.append(place - place.mean())
    return np.stack(columns, axis=1)


def _find_step(rest: Floats, steps: list[int]) -> tuple[int, float]:
    """Return where the residual's best step is, and what it explains (root of a sum of squares): 0 if it is noise.

    Each stretch between two steps has its own noise: a cable that has changed may scatter more than before.
    """
    best, score = 0, 0.0
    for low, high in zip([0, *steps], [*steps, len(rest)], strict=True):
        n = high - low
        if n < FEWEST_VALUES:
            continue
        left, part = np.arange(1, n), rest[low:high] - rest[low:high].mean()
        explained = np.abs(np.cumsum(part)[:-1]) * np.sqrt(n / (left * (n - left)))
        largest = float(explained.max())
        if largest > max(score, _limit(n) * _measure_noise(part)):
            best, score = low + 1 + int(explained.argmax()), largest
    return best, score


def _score_line(rest: Floats, place: Floats, model: Floats) -> float:
    """Return what a straight line explains besides the model, likewise."""
    own = place - model @ np.linalg.lstsq(model, place, rcond=None)[0]
    explained = float(abs(own @ rest) / np.sqrt(own @ own))
    return explained if explained > _limit(len(rest)) * _measure_noise(rest) else 0.0


def _fit(values: Floats, known: Ints, series: Floats, steps: list[int], has_line: bool) -> SeriesDrift:
    place = known.astype(np.float64)
    model = _design(place, steps, has_line=True)
    size = np.linalg.lstsq(model, series, rcond=None)[0]
    bounds = list(zip([0, *steps], [*steps, len(series)], strict=True))
    rest = series - model @ size
    noise = [_measure_noise(rest[low:high]) for low, high in bounds]
    slope, slope_sigma = float(size[-1]), float(max(noise) * np.sqrt(np.linalg.inv(model.T @ model)[-1, -1]))
    if not has_line:
        model = model[:, :-1]
        size = np.linalg.lstsq(model, series, rcond=None)[0]
    fitted = np.full(len(values), np.nan)
    fitted[known] = model @ size
    error = [one / np.sqrt(high - low) for one, (low, high) in zip(noise, bounds, strict=True)]
    changes = [
        LevelChange(int(known[at]), float(size[1 + i]), float(np.hypot(error[i], error[i + 1])))
        for i, at in enumerate(steps)
    ]
    return SeriesDrift(changes, slope, slope_sigma, has_line, fitted)
