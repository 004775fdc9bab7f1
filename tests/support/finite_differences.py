"""The one finite-difference check that every derivative of the package goes through."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def numeric_jacobian(f: Callable[[Array], Array], x: Array, step: float = 1e-5) -> Array:
    """(..., n) derivative of f (...) at x (n,) by central differences."""
    columns = [(np.asarray(f(x + h)) - np.asarray(f(x - h))) / (2 * step) for h in step * np.eye(len(x))]
    return np.stack(columns, axis=-1)


def check_jacobian(
    f: Callable[[Array], Array], J: Array, x: Array, *, step: float = 1e-5, rtol: float = 1e-6, atol: float = 1e-7
) -> None:
    """Assert that J (..., n) is the derivative of f at x (n,)."""
    np.testing.assert_allclose(J, numeric_jacobian(f, x, step), rtol=rtol, atol=atol)
