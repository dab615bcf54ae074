"""How much a series of residuals really tells, when neighbours err together."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Floats

__all__ = ["correlation_length"]


def correlation_length(residual: Floats) -> float:
    """Return how many samples (n, m) in order of time tell as much as one independent sample; 1 for white noise.

    One plus twice the sum of the autocorrelations, up to the first that is not positive, the mean of the m columns
    weighted by their variance. Estimates that rest on these residuals have so many times the variance that
    independent ones would have.
    """
    centred = residual - residual.mean(axis=0)
    centred /= np.maximum(centred.std(axis=0), np.finfo(float).eps)  # a constant's rounding is no series
    size = 1 << (2 * len(centred) - 1).bit_length()
    power = np.square(np.abs(np.fft.rfft(centred, size, axis=0))).sum(axis=1)
    lags = np.fft.irfft(power, size)[: len(centred) // 2]
    lags = lags[1:] / max(float(lags[0]), np.finfo(float).tiny)
    ends = np.flatnonzero(lags <= 0)
    return float(1.0 + 2.0 * lags[: ends[0] if len(ends) else len(lags)].sum())
