"""The notebooks run from the first cell to the last; their own asserts say whether they show what they should."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

for package in ("jupytext", "nbclient", "ipykernel", "nbformat"):
    pytest.importorskip(package, reason="needs the extra notebooks")

ROOT = Path(__file__).parents[2]
NAMES = sorted(path.stem for path in (ROOT / "notebooks").glob("[0-9]*.py"))


def runner() -> ModuleType:
    spec = importlib.util.spec_from_file_location("run_notebooks", ROOT / "notebooks" / "run.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_there_are_five() -> None:
    assert len(NAMES) == 5


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))  # for `reproduce`, where the kernel's folder is not on the path
    text = runner().run(name, tmp_path).read_text(encoding="utf-8")
    assert '"output_type": "stream"' in text or '"output_type": "execute_result"' in text
