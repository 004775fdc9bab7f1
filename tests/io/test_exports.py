"""Export formats by name; a format of one's own is one file and one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from support.cameras import ring
from support.results import estimate, two_links
from twistcap.errors import InputError
from twistcap.io.exports import FORMATS, export
from twistcap.io.result import Result, ResultWriter, read_result
from twistcap.io.session import Output

TOY = '''
"""The root's places as JSON."""
import json
from twistcap.io.exports import ExportFormat

def toy():
    return ExportFormat("places.json", "where the body is", write)

def write(result, path, options):
    path.write_text(json.dumps(result.roots[:, :3, 3].tolist()))
'''


@pytest.fixture
def result(tmp_path: Path) -> Result:
    with ResultWriter(tmp_path / "r.h5", two_links(), ring(), {}) as writer:
        for k in range(3):
            writer.append(estimate(k))
    return read_result(tmp_path / "r.h5")


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package of one module, as pip would put it there."""
    (tmp_path / "toy_format.py").write_text(TOY)
    info = tmp_path / "toy_format-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: toy_format\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[twistcap.exports]\ntoy = toy_format:toy\n")
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("installed")
def test_a_format_of_an_installed_package_is_one_file_and_one_line(result: Result, tmp_path: Path) -> None:
    assert FORMATS.names() == ("trc", "mot", "bvh", "csv", "glb", "c3d", "opensim", "toy")
    path = export(result, "toy", tmp_path)
    assert path == tmp_path / "places.json"
    np.testing.assert_array_equal(json.loads(path.read_text()), result.roots[:, :3, 3])
    assert Output(exports=("toy",)).exports == ("toy",)


def test_unknown_formats_are_refused_with_the_known_ones(result: Result, tmp_path: Path) -> None:
    known = "no export format 'fbx'; choose one of trc, mot, bvh, csv, glb"
    with pytest.raises(InputError, match=known):
        export(result, "fbx", tmp_path)
    with pytest.raises(ValueError, match=known):  # pydantic's, which `load_session` makes an InputError of
        Output(exports=("fbx",))


def test_what_cannot_be_written_is_refused(result: Result, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        export(result, "glb", tmp_path / "no such folder")
    with ResultWriter(tmp_path / "none.h5", two_links(), ring(), {}):
        pass
    with pytest.raises(InputError, match="no frame"):
        export(read_result(tmp_path / "none.h5"), "csv", tmp_path)
