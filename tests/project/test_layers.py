"""Imports point downward between the rooms of ARCHITECTURE.md."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "src" / "twistcap"

# From the ground up; a room may import from its own floor and from those before it.
FLOORS: tuple[tuple[str, ...], ...] = (
    ("errors", "ranges", "arrays", "doors", "_cached", "stages", "threads", "registry"),
    ("se3",),
    ("camera",),
    ("body",),
    ("estimate",),
    ("render",),
    ("features",),
    ("region",),
    ("flow",),
    ("terms", "solve"),
    ("cues",),
    ("predict", "priors"),
    ("motion", "search"),
    ("differential",),
    ("settings",),
    ("track",),
    ("hindsight",),
    ("build",),
    ("adjust",),
    ("studio",),
    ("acquire",),
    ("io",),
    ("calibrate",),
    ("evaluate",),
    ("report", "view"),
    ("pages",),
    ("commands", "cli", "__main__"),
)
FLOOR_OF = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}
FILES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported_rooms(source: str) -> Iterator[tuple[int, str]]:
    """Line and room of every import of ours, those inside functions included."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (
                (node.lineno, alias.name.split(".")[1]) for alias in node.names if alias.name.startswith("twistcap.")
            )
        elif isinstance(node, ast.ImportFrom) and node.module == "twistcap":
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("twistcap."):
            yield node.lineno, str(node.module).split(".")[1]
        elif isinstance(node, ast.ImportFrom) and node.level:
            raise AssertionError(f"line {node.lineno}: write absolute imports")


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_downward(path: Path) -> None:
    room = room_of(path)
    assert room in FLOOR_OF, f"{room} has no floor: add it to FLOORS and ARCHITECTURE.md"
    upward = [
        f"line {line}: {room} imports {other}"
        for line, other in imported_rooms(path.read_text())
        if FLOOR_OF[other] > FLOOR_OF[room]
    ]
    assert not upward, "; ".join(upward)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_the_wheel_knows_nothing_of_what_stands_outside_it(path: Path) -> None:
    assert not {"reproduce", "benchmarks", "tests", "support"} & {top for _, top in imported_packages(path.read_text())}


def imported_packages(source: str) -> Iterator[tuple[int, str]]:
    """Line and top package of every import."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name.split(".")[0]) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.lineno, node.module.split(".")[0]


def test_the_test_finds_what_it_looks_for() -> None:
    source = (
        "import twistcap.cli\nfrom twistcap import io\ndef f():\n    from twistcap.track import Tracker\nimport numpy\n"
    )
    assert sorted(imported_rooms(source)) == [(1, "cli"), (2, "io"), (4, "track")]
    assert (1, "reproduce") in imported_packages("from reproduce.cases import STUDIO")


def test_files_and_functions_stay_small() -> None:
    """Files under 400 lines; nine of ten functions under 25."""
    long_files, lengths = list[str](), list[int]()
    for path in FILES:
        text = path.read_text()
        if text.count("\n") > 400:
            long_files.append(path.name)
        functions = [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.FunctionDef)]
        lengths += [(n.end_lineno or 0) - n.body[0].lineno + 1 for n in functions]
    assert not long_files, long_files
    assert sum(length < 25 for length in lengths) >= 0.9 * len(lengths)
