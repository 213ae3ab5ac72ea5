"""References in extended precision, from the data as they arrived: no formula of floating-point numbers is trusted twice."""

from collections.abc import Callable
from decimal import Decimal, localcontext
from typing import Any

import numpy as np
from jaxtyping import Float

DIGITS = 120
"""Decimal digits: normal equations square a condition of 10¹⁶ and have room left."""


def _exact(array: Any) -> np.ndarray:
    return np.vectorize(Decimal, otypes=[object])(np.asarray(array, np.float64))


def _in_digits(work: Callable[..., Any]) -> Callable[..., Any]:
    def precise(*arguments: Any) -> Any:
        with localcontext() as context:
            context.prec = DIGITS
            context.Emax, context.Emin = 10**6, -(10**6)
            return work(*arguments)

    return precise


def _solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Gaussian elimination with partial pivoting, in the precision of the entries."""
    size = len(matrix)
    table = np.concatenate([matrix, right], axis=1)
    for k in range(size):
        pivot = k + int(np.argmax(np.abs(table[k:, k])))
        table[[k, pivot]] = table[[pivot, k]]
        table[k] = table[k] / table[k, k]
        others = np.arange(size) != k
        table[others] = table[others] - np.outer(table[others, k], table[k])
    return table[:, size:]


@_in_digits
def ridge(x: Float[np.ndarray, "M n"], targets: Float[np.ndarray, "B n"], damping: float) -> Float[np.ndarray, "B M"]:
    """argmin ‖W X − targets‖² + λ ‖W‖²; with λ = 0 for full rank alone."""
    x, targets = _exact(x), _exact(targets)
    held = Decimal(float(damping)) * np.eye(min(x.shape), dtype=int)
    if x.shape[0] <= x.shape[1]:
        w = _solve(x.dot(x.T) + held, x.dot(targets.T)).T
    else:
        w = targets.dot(_solve(x.T.dot(x) + held, x.T))
    return w.astype(np.float64)


@_in_digits
def leave_one_out(
    x: Float[np.ndarray, "M n"], targets: Float[np.ndarray, "B n"], damping: float
) -> Float[np.ndarray, "B n"]:
    """Residual of each column under the ridge fit of all others, from the inverse of XᵀX + λ."""
    x, targets, size = _exact(x), _exact(targets), x.shape[1]
    inverse = _solve(x.T.dot(x) + Decimal(float(damping)) * np.eye(size, dtype=int), _exact(np.eye(size)))
    return (targets.dot(inverse) / np.diagonal(inverse)).astype(np.float64)
