"""A small studio session and its track, which several files look at: made once by each worker."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from support.commands import run

SMALL = ["--size", "192x140", "--views", "2", "--frames", "8"]


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A studio session, rendered once."""
    folder = tmp_path_factory.mktemp("studio") / "walk"
    assert run("studio", folder, *SMALL) == 0
    return folder


@pytest.fixture
def session(made: Path, tmp_path: Path) -> Path:
    """A copy of the session that a test may spoil."""
    return Path(shutil.copytree(made, tmp_path / "walk")) / "session.toml"


@pytest.fixture(scope="session")
def tracked(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The output folder of a whole track."""
    out = tmp_path_factory.mktemp("out")
    assert run("track", made / "session.toml", "--out", out) == 0
    return out
