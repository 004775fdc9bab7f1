"""What a user of the package sees: the names at its top, its types, and how it wants to be cited."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

import twistcap
from twistcap.body import Posed
from twistcap.differential.model import DifferentialModel

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", twistcap.__all__)
def test_every_name_at_the_top_is_there(name: str) -> None:
    assert getattr(twistcap, name) is not None and name in dir(twistcap)


def test_the_lists_of_names_agree() -> None:
    assert sorted((*twistcap._HOMES, "build")) == sorted(twistcap.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = twistcap.nonsense


def test_importing_it_loads_next_to_nothing() -> None:
    code = "import sys, {}; print([m for m in ('numpy', 'numba', 'cv2') if m in sys.modules])"
    for name, loaded in (("twistcap", "[]\n"), ("twistcap.cli", "['numpy']\n")):
        run = [sys.executable, "-c", code.format(name)]
        assert subprocess.run(run, capture_output=True, text=True).stdout == loaded


def test_a_first_run_says_that_it_compiles(tmp_path: Path) -> None:
    """With a cache of numba that is empty, and with one that has kernels."""
    code = "from twistcap.commands.terminal import tell_compiling as t; t()"
    code += "; import pathlib; from twistcap.render.raster import rasterise as r; f = pathlib.Path(r.stats.cache_path)"
    code += "; f.mkdir(parents=True, exist_ok=True); (f / 'raster.rasterise-1.py3.nbi').touch(); t()"
    run = [sys.executable, "-c", code]
    found = subprocess.run(run, capture_output=True, text=True, env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)})
    assert found.returncode == 0 and found.stderr.count("compiles the kernels") == 1, found.stderr


def test_types_are_announced() -> None:
    assert (Path(twistcap.__file__).parent / "py.typed").is_file()


def test_the_citation_is_of_this_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = (ROOT / "CITATION.cff").read_text()
    found = dict(re.findall(r"^([\w-]+): (.+)$", citation, flags=re.MULTILINE))
    assert found["version"] == project["version"] == twistcap.__version__
    assert found["license"] == project["license"] and found["cff-version"] == "1.2.0" and "authors:" in citation


@dataclass
class Watcher:
    """A cue and a prior that want nothing, and count how often they are asked."""

    name: str = "watcher"
    news: bool = True
    asked: list[str] = field(default_factory=list)

    def start(self, body: Any, rig: Any) -> None:
        return None

    def measure(self, sight: Any, memory: None, level: Any) -> None:
        self.asked.append("cue")

    def learn(self, memory: None, fit: Any, lesson: int) -> None:
        return None

    def terms(self, alternation: Any) -> tuple[()]:
        self.asked.append("prior")
        return ()

    def claimed(self, posed: Posed) -> None:
        return None


def test_track_takes_cues_and_priors_of_ones_own() -> None:
    walk = twistcap.capture(twistcap.StudioConfig(0, 2, (192, 140), frames=2))
    model, cue, prior = twistcap.build.build(walk.body, walk.rig), Watcher(), Watcher("other")
    estimates = list(twistcap.tracked(walk.frames(), model, walk.first_pose, cues=[cue], priors=[prior]))
    assert len(estimates) == 2 and set(cue.asked) == {"cue"} and set(prior.asked) == {"prior"}
    with pytest.raises(twistcap.InputError, match="neither cues nor priors"):
        twistcap.tracked([], DifferentialModel(walk.body, rig=walk.rig), walk.first_pose, cues=[cue])
