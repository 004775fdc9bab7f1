"""Export formats by name; a format of one's own is one file and one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from support.cameras import ring
from support.results import estimate, two_links
from twistcap.errors import InputError
from twistcap.io.exports import FORMATS, ExportOptions, export, shared
from twistcap.io.result import Result, ResultWriter, read_result
from twistcap.io.session_tables import Output

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
    assert FORMATS.names() == ("trc", "mot", "bvh", "csv", "glb", "usd", "c3d", "opensim", "toy")
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


@pytest.mark.parametrize(
    ("key", "value", "formats"),
    [
        ("axes", "z_up", ("bvh", "glb", "usd")),
        ("angles", "isb", ("trc", "bvh", "glb", "usd", "c3d", "opensim")),
        ("fps", 24.0, ("trc", "mot", "csv", "c3d", "opensim", "toy")),
        ("into", Path("hero.glb"), ("usd", "trc", "mot", "csv", "c3d", "opensim", "toy")),
        ("rig", Path("none.toml"), ("trc", "mot", "csv", "c3d", "opensim", "toy")),
    ],
)
@pytest.mark.usefixtures("installed")
def test_options_that_a_format_does_not_take_are_refused(
    result: Result, tmp_path: Path, key: str, value: object, formats: tuple[str, ...]
) -> None:
    """Where one format is asked for; a session's options are those of all its formats."""
    options = ExportOptions(**{key: value})  # type: ignore[arg-type]
    for name in formats:
        with pytest.raises(InputError, match=f"^export: {key}: {name} takes none; leave it away"):
            export(result, name, tmp_path, options=options)
        assert shared(options, name) == ExportOptions()
    assert all(shared(options, name) == options for name in {"mot", "glb"} - {*formats})


def test_a_rig_file_without_its_glb_is_refused(result: Result, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="of the GLB of into; give both"):
        export(result, "glb", tmp_path, options=ExportOptions(rig=tmp_path / "hero.rig.toml"))


def test_a_body_of_ours_needs_no_into(result: Result, tmp_path: Path) -> None:
    own = export(result, "glb", tmp_path)
    with pytest.raises(InputError, match="body of twistcap, which exports hold as it is; leave --into away"):
        export(result, "glb", tmp_path, options=ExportOptions(into=own))
