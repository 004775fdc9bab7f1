"""The result file: round trip, readable after a kill, resumable, and readable without this package."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import h5py
import numpy as np
import pytest

import twistcap
from support.cameras import ring
from support.results import estimate, two_links
from twistcap.body import Body, Posed
from twistcap.errors import InputError
from twistcap.io.result import ResultWriter, read_result


def write(path: Path, count: int = 5) -> Path:
    with ResultWriter(path, two_links(), ring(), {"tracker": {"method": "direct"}}) as writer:
        for k in range(count):
            writer.append(estimate(k))
    return path


def same_body(a: Body, b: Body) -> None:
    for field in fields(Body):
        if field.name == "landmarks":
            assert a.landmarks.names == b.landmarks.names
            np.testing.assert_array_equal(a.landmarks.points, b.landmarks.points)
        else:
            np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name))


def test_round_trip(tmp_path: Path) -> None:
    result = read_result(write(tmp_path / "r.h5"))
    same_body(result.body, two_links())
    for read, made in zip(result.rig, ring(), strict=True):
        assert (read.name, read.size) == (made.name, made.size)
        np.testing.assert_array_equal(read.P, made.P)
        np.testing.assert_array_equal(read.dist, made.dist)
    assert result.config == {"tracker": {"method": "direct"}} and result.versions["twistcap"] == twistcap.__version__
    assert len(result) == 5 and list(result.lost) == [False, False, False, True, False]
    for read, made in zip(result.estimates, map(estimate, range(5)), strict=True):
        np.testing.assert_array_equal(read.pose.root, made.pose.root)
        np.testing.assert_array_equal(read.pose.q, made.pose.q)
        np.testing.assert_array_equal(read.covariance, made.covariance)
        assert read.energies == made.energies
        assert (read.index, read.time, read.status) == (made.index, made.time, made.status)
        assert (read.iterations, read.lost, read.support) == (made.iterations, made.lost, made.support)


KILLED = """
import sys, time
sys.path.insert(0, {tests!r})
from support.cameras import ring
from support.results import estimate, two_links
from twistcap.io.result import ResultWriter
writer = ResultWriter({path!r}, two_links(), ring(), {{}})
for k in range(10**6):
    writer.append(estimate(k))
    if k == 30: print("go", flush=True)
"""


def test_survives_kill_and_resumes(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    code = KILLED.format(tests=str(Path(__file__).parents[1]), path=str(path))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None and child.stdout.readline() == "go\n"
        child.send_signal(signal.SIGKILL)
    result = read_result(path)
    assert len(result) > 30
    np.testing.assert_array_equal(result.q[:31], [estimate(k).pose.q for k in range(31)])
    with ResultWriter.resume(path) as writer:
        start = len(writer)
        assert start == len(result)
        writer.append(estimate(start))
    after = read_result(path)
    assert list(after.indices) == list(range(start + 1))
    np.testing.assert_array_equal(after.roots[-1], estimate(start).pose.root)


def test_half_written_frame_is_left_out(tmp_path: Path) -> None:
    """A kill between two datasets of one frame: the incomplete row is neither read nor kept."""
    path = write(tmp_path / "r.h5")
    with h5py.File(path, "r+") as file:
        file["frames/index"].resize(6, axis=0)
        file["frames/energies/late"].resize(6, axis=0)
        file["frames/energies/contour"].resize(4, axis=0)
    assert len(read_result(path)) == 5 and np.isnan(read_result(path).energies["contour"][4])
    with ResultWriter.resume(path) as writer:
        writer.append(estimate(7))
    assert list(read_result(path).indices) == [0, 1, 2, 3, 4, 7]


def test_layout_is_as_documented(tmp_path: Path) -> None:
    """The example of docs/formats/result-file.md gives our landmarks when run; every dataset is in its table."""
    path = write(tmp_path / "result.h5")
    page = (Path(__file__).parents[2] / "docs" / "formats" / "result-file.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", page, flags=re.S)
    names: dict[str, object] = {}
    exec(blocks[0].replace('"result.h5"', repr(str(path))), names)
    result = read_result(path)
    np.testing.assert_allclose(names["world"], Posed(result.body, result.poses[0]).landmarks, atol=1e-12)
    np.testing.assert_allclose(names["knee_deg"], np.rad2deg(result.q[:, 0]))
    found: list[str] = []
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.append(name) if isinstance(item, h5py.Dataset) else None)
    for name in found:
        stem, leaf = name.rsplit("/", 1)
        assert stem == "frames/energies" or leaf in page, name


def test_what_is_no_result_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        read_result(tmp_path / "none.h5")
    (tmp_path / "text.h5").write_text("no")
    with pytest.raises(InputError, match="no HDF5 file"):
        read_result(tmp_path / "text.h5")
    with h5py.File(tmp_path / "other.h5", "w"):
        pass
    with pytest.raises(InputError, match="no twistcap result"):
        ResultWriter.resume(tmp_path / "other.h5")
    with pytest.raises(InputError, match="its folder does not exist"):
        ResultWriter(tmp_path / "no" / "folder" / "r.h5", two_links(), ring(), {})
    path = write(tmp_path / "r.h5")
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = 99
    with pytest.raises(InputError, match="newer twistcap"):
        read_result(path)
