"""Rules that every numba kernel of the package keeps."""

from __future__ import annotations

import inspect
import pkgutil
import re
from importlib import import_module
from pathlib import Path

import pytest
from numba.core.registry import CPUDispatcher

import twistcap
from support.twins import reference_of


def kernels() -> list[CPUDispatcher]:
    """All compiled functions that the package's modules define; those that need an extra that is not there are left."""
    found = []
    for info in pkgutil.walk_packages(twistcap.__path__, "twistcap."):
        try:
            module = import_module(info.name)
        except ImportError:
            continue
        values = vars(module).values()
        found += [v for v in values if isinstance(v, CPUDispatcher) and v.py_func.__module__ == info.name]
    return found


KERNELS = {f"{k.py_func.__module__}.{k.py_func.__name__}": k for k in kernels()}


def test_kernels_are_found() -> None:
    assert len(KERNELS) > 100


@pytest.mark.parametrize("name", KERNELS)
def test_no_kernel_takes_more_than_eight_arguments(name: str) -> None:
    assert len(inspect.signature(KERNELS[name].py_func).parameters) <= 8


@pytest.mark.parametrize("name", KERNELS)
def test_no_kernel_may_take_it_that_numbers_are_finite(name: str) -> None:
    """`nnan` and `ninf` let the compiler drop what would show a NaN of an image; fast and True contain them."""
    flags = KERNELS[name].targetoptions.get("fastmath", False)
    assert flags is False or (isinstance(flags, set | frozenset) and not flags & {"nnan", "ninf", "fast"})


@pytest.mark.parametrize("name", [name for name in KERNELS if not name.rpartition(".")[2].startswith("_")])
def test_every_public_kernel_has_a_readable_twin(name: str) -> None:
    twin = reference_of(KERNELS[name])
    assert twin is not None and not isinstance(twin, CPUDispatcher)
    assert len(inspect.signature(twin).parameters) == len(inspect.signature(KERNELS[name].py_func).parameters)


@pytest.mark.parametrize("name", [name for name in KERNELS if not name.rpartition(".")[2].startswith("_")])
def test_every_public_kernel_is_held_against_its_twin(name: str) -> None:
    kernel = name.rpartition(".")[2]
    called = re.compile(rf"check_twin\(\s*(\w+\.)?{kernel}\b|\b{kernel}_reference\(")
    tests = Path(__file__).parents[1].rglob("test_*.py")
    assert any(called.search(path.read_text(encoding="utf-8")) for path in tests)
