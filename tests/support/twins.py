"""A kernel held against its readable twin."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from numba.core.registry import CPUDispatcher


def reference_of(kernel: CPUDispatcher) -> Any:
    """The twin of a kernel, from its own module or the one of twins beside it; None where it has none."""
    function, beside = kernel.py_func, f"{kernel.py_func.__module__}_reference"
    modules = [function.__module__, *([beside] if find_spec(beside) else [])]
    twins = [getattr(import_module(module), f"{function.__name__}_reference", None) for module in modules]
    return next((twin for twin in twins if twin is not None), None)


def check_twin(kernel: CPUDispatcher, *arguments: Any, rtol: float = 1e-9, atol: float = 1e-9) -> Any:
    """Both give the same, and change their arguments alike; what the twin gives."""
    ours, theirs = deepcopy(arguments), deepcopy(arguments)
    found, expected = kernel(*ours), reference_of(kernel)(*theirs)
    for a, b in zip(_leaves((found, ours)), _leaves((expected, theirs)), strict=True):
        np.testing.assert_allclose(a, b, rtol=rtol, atol=atol)
    return expected


def _leaves(values: Any) -> Iterator[Any]:
    if isinstance(values, tuple | list):
        for value in values:
            yield from _leaves(value)
    elif values is not None:
        yield values
