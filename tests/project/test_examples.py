"""The numbered examples run, and do what they say."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

EXAMPLES = Path(__file__).parents[2] / "examples"


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_studio_walk_is_tracked_to_millimetres() -> None:
    assert example("01_studio_walk").main(frames=4) < 15.0


def test_one_system_finds_the_knee() -> None:
    assert example("02_one_system").main() < 5.0


def test_a_glb_of_ones_own_is_tracked() -> None:
    assert example("03_your_own_mesh").main(frames=3)
