"""What stands outside the wheel uses its public names only, and the wheel's own rooms stay small."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILES = sorted([*(ROOT / "reproduce").rglob("*.py"), *(ROOT / "benchmarks").glob("*.py")])


def private_names(source: str) -> Iterator[str]:
    """Line and name of each import of a private name of ours, and of each private attribute of another object."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from (f"line {node.lineno}: {alias.name}" for part in alias.name.split(".") if private(part))
        elif isinstance(node, ast.ImportFrom) and node.module != "__future__":
            parts = [*(node.module or "").split("."), *(alias.name for alias in node.names)]
            yield from (f"line {node.lineno}: {part} of {node.module}" for part in parts if private(part))
        elif isinstance(node, ast.Attribute) and private(node.attr):
            owner = node.value
            if not (isinstance(owner, ast.Name) and owner.id in ("self", "cls")):
                yield f"line {node.lineno}: {ast.unparse(node)}"


def private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__") and name != "_exit"  # of os, after a fork


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_only_public_names_are_used(path: Path) -> None:
    assert list(private_names(path.read_text())) == []


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_to_the_wheel_and_reproduce_alone(path: Path) -> None:
    """No benchmark imports another, and nothing imports benchmarks or tests."""
    benchmarks = {f.stem for f in FILES if f.parent.name == "benchmarks"}
    forbidden = benchmarks | {"benchmarks", "tests", "support"}
    imported = [
        name.split(".")[0]
        for node in ast.walk(ast.parse(path.read_text()))
        for name in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [node.module or ""]
            if isinstance(node, ast.ImportFrom)
            else []
        )
    ]
    assert not forbidden & set(imported)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_and_functions_stay_small(path: Path) -> None:
    text = path.read_text()
    assert text.count("\n") <= 400
    functions = [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.FunctionDef)]
    assert [f.name for f in functions if (f.end_lineno or 0) - f.body[0].lineno >= 45] == []


def test_the_test_finds_what_it_looks_for() -> None:
    source = (
        "from twistcap._cached import cached\nfrom twistcap.body import _a\nimport twistcap._b\nx._c\nself._d\nx.__e__"
    )
    assert [found.split(":")[0] for found in private_names(source)] == [f"line {n}" for n in (1, 2, 3, 4)]
