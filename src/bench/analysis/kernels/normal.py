"""Small symmetric positive matrices, solved inside loops over frames (Cholesky)."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Floats
from bench.analysis.kernels.compiling import compiled

__all__ = ["backward", "factor", "forward"]


@compiled
def factor(matrix: Floats) -> None:
    """Replace a symmetric positive matrix by its lower triangle's factor (Cholesky)."""
    for i in range(len(matrix)):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = np.sqrt(max(total, 1e-300)) if i == j else total / matrix[j, j]


@compiled
def forward(lower: Floats, right: Floats) -> None:
    """Solve with the lower factor, in place, for as many values as it has rows."""
    for i in range(len(lower)):
        for j in range(i):
            right[i] -= lower[i, j] * right[j]
        right[i] /= lower[i, i]


@compiled
def backward(lower: Floats, right: Floats) -> None:
    """Solve with the lower factor's transpose, in place."""
    for i in range(len(lower) - 1, -1, -1):
        for j in range(i + 1, len(lower)):
            right[i] -= lower[j, i] * right[j]
        right[i] /= lower[i, i]
