"""The OpenSim package, opened and solved by OpenSim itself."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from support.cameras import ring
from support.results import two_links
from twistcap.body import Body, Pose
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.estimate import Estimate
from twistcap.io.angles import PELVIS_PLACE
from twistcap.io.markers import TO_FILE, WorldAxes, read_trc
from twistcap.io.motion_files import MotionTable, read_mot
from twistcap.io.opensim_model import opensim_model
from twistcap.io.opensim_package import write_opensim
from twistcap.io.result import Result, ResultWriter, read_result
from twistcap.studio.motion import gait

LOST, FRAMES = 5, 14
BODIES = {"plain": humanoid(), "all joints": humanoid(stature=1.68, thorax=True, clavicles=True, wrists=True)}


@pytest.fixture(scope="module")
def opensim() -> Any:
    found = pytest.importorskip("opensim", reason="OpenSim is not installed (pip install opensim)")
    found.Logger.setLevelString("error")
    return found


def walk(folder: Path, body: Body, lost: bool = False) -> Result:
    """A walk with every coordinate off its usual place, so that none is 0; one frame is lost."""
    off = np.random.default_rng(2).normal(scale=0.15, size=len(body.coordinate_names))
    with ResultWriter(folder / "r.h5", body, ring(), {}) as writer:
        for n, pose in enumerate(gait(body, frames=FRAMES, heading=0.6)):
            moved, unit = Pose(pose.root, pose.q + off), np.eye(body.dof) * 1e-4
            writer.append(Estimate(n, 1 + n / 60, moved, unit, lost=lost or n == LOST))
    return read_result(folder / "r.h5")


@pytest.fixture(params=list(BODIES))
def package(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    write_opensim(tmp_path / "opensim", walk(tmp_path, BODIES[request.param]))
    return tmp_path / "opensim"


def errors_of(one: MotionTable, other: MotionTable) -> tuple[float, float]:
    """Greatest root mean square over the coordinates: degrees, and metres of the pelvis."""
    rms = {name: np.sqrt(np.mean((one.get(name) - other.get(name)) ** 2)) for name in one.columns}
    places = [rms.pop(name) for name in PELVIS_PLACE]
    return float(np.degrees(max(rms.values()))), float(max(places))


def test_inverse_kinematics_gives_the_motion_again(
    opensim: Any, package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(package)
    assert opensim.InverseKinematicsTool("ik.xml").run()
    ours, theirs = read_mot("angles.mot"), read_mot("ik.mot")
    np.testing.assert_allclose(theirs.times, ours.times, atol=1e-8)
    degrees, metres = errors_of(ours, theirs)
    assert degrees < 0.05 and metres < 1e-4  # to reach: 2° and 10 mm


def test_the_model_moved_by_the_motion_puts_markers_where_they_are(opensim: Any, package: Path) -> None:
    model = opensim.Model(str(package / "model.osim"))
    state, table = model.initSystem(), read_mot(package / "angles.mot")
    points = opensim.TimeSeriesTableVec3(str(package / "markers.trc"))
    np.testing.assert_array_equal(points.getIndependentColumn(), table.times)
    for row in (0, len(table.times) - 1):
        for name in table.columns:
            coordinate = model.getCoordinateSet().get(name)
            coordinate.setValue(state, float(table.get(name)[row]), False)
        model.realizePosition(state)
        for m, name in enumerate(points.getColumnLabels()):
            there = model.getMarkerSet().get(name).getLocationInGround(state).to_numpy()
            np.testing.assert_allclose(there, points.getRowAtIndex(row)[m].to_numpy(), atol=2e-6)
    assert model.getNumCoordinates() == len(table.columns)
    assert 60 < model.getTotalMass(state) < 90


def test_the_surface_of_the_model_is_the_body(opensim: Any, package: Path) -> None:
    """Corners of the meshes in the default pose, but for pronation, where OpenSim's palm is forward."""
    model = opensim.Model(str(package / "model.osim"))
    state = model.initSystem()
    body = next(b for b in BODIES.values() if len(b.coordinate_names) == model.getNumCoordinates() - 6)
    for side in "rl":  # the default of the coordinate undoes it
        assert model.getCoordinateSet().get(f"pro_sup_{side}").getDefaultValue() == pytest.approx(np.pi / 2)
    model.realizePosition(state)
    origin = model.getBodySet().get("pelvis").findStationLocationInGround(state, opensim.Vec3(0)).to_numpy()
    np.testing.assert_allclose(origin, 0.0, atol=1e-9)
    for path in (package / "Geometry").glob("*.obj"):
        bone = model.getBodySet().get(path.stem)
        corners = [line.split()[1:] for line in path.read_text().splitlines() if line.startswith("v ")]
        ours = body.vertices @ TO_FILE["opensim"].T
        shift = None
        for corner in np.array(corners[::40], float):
            place = bone.findStationLocationInGround(state, opensim.Vec3(*corner)).to_numpy()
            gap = ours - place
            shift = gap[np.argmin(np.linalg.norm(gap - pelvis_of(body), axis=1))]
            np.testing.assert_allclose(shift, pelvis_of(body), atol=1e-6)
        assert shift is not None


def pelvis_of(body: Body) -> np.ndarray:
    from twistcap.io.angles import pelvis_point

    return TO_FILE["opensim"] @ pelvis_point(body)


@pytest.mark.parametrize("axes", ["pose2sim", "z_up"])
def test_other_worlds(opensim: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, axes: WorldAxes) -> None:
    write_opensim(tmp_path / "o", walk(tmp_path, BODIES["plain"]), axes)
    monkeypatch.chdir(tmp_path / "o")
    assert opensim.InverseKinematicsTool("ik.xml").run()
    degrees, metres = errors_of(read_mot("angles.mot"), read_mot("ik.mot"))
    assert degrees < 0.05 and metres < 1e-4
    down = opensim.Model("model.osim").getGravity().to_numpy()
    np.testing.assert_allclose(down, TO_FILE[axes] @ [0, 0, -9.80665], atol=1e-6)


def test_opensim_reads_points_and_angles_with_their_gaps(opensim: Any, tmp_path: Path) -> None:
    """The TRC of `--to trc`: its last field of a lost frame is empty, too."""
    from twistcap.io.exports import export

    result = walk(tmp_path, BODIES["plain"])
    table = opensim.TimeSeriesTableVec3(str(export(result, "trc", tmp_path)))
    np.testing.assert_array_equal(table.getIndependentColumn(), result.times)
    markers = read_trc(tmp_path / "joints.trc")
    for n in range(FRAMES):
        theirs = np.array([table.getRowAtIndex(n)[m].to_numpy() for m in range(table.getNumColumns())])
        np.testing.assert_allclose(theirs, markers.points[n] @ TO_FILE["opensim"].T, atol=1e-6)
        assert np.isnan(theirs).all() == (n == LOST)


@pytest.mark.parametrize("fill", [False, True])
def test_opensims_storage_reads_the_motion_to_its_end(opensim: Any, tmp_path: Path, fill: bool) -> None:
    """Its tools read so: a row of NaN would end the motion there, without a word."""
    from twistcap.io.exports import ExportOptions, export

    result = walk(tmp_path, BODIES["plain"])
    whole = result.times if fill else np.delete(result.times, LOST)
    for name, within in (("mot", ""), ("opensim", "angles.mot")):
        path = export(result, name, tmp_path, options=ExportOptions(fill=fill)) / within
        storage, times = opensim.Storage(str(path)), opensim.ArrayDouble()
        assert storage.getSize() == len(whole)
        storage.getTimeColumn(times)
        np.testing.assert_array_equal([times.get(n) for n in range(times.getSize())], whole)
        text = path.read_text()
        assert f"nRows={len(whole)}\n" in text
        assert f"Frames left out, since the body was lost or not seen: {LOST}-{LOST} (" in text or fill
        assert read_mot(path).gaps == (() if fill else ((result.times[LOST], result.times[LOST]),))


def test_a_model_of_ones_own_is_scaled_to_the_body(
    opensim: Any, shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rajagopal's model: its markers, which we have not made, lie near ours, and its joints turn as ours do."""
    write_opensim(tmp_path / "o", walk(tmp_path, humanoid(stature=1.6)))
    shutil.copy(
        shared_data / "opensim_gait" / "Models" / "Rajagopal" / "Rajagopal2016.osim", tmp_path / "o/generic.osim"
    )
    monkeypatch.chdir(tmp_path / "o")
    assert opensim.ScaleTool("scale.xml").run()
    setup = Path("ik.xml").read_text().replace("model.osim", "generic_scaled.osim")
    Path("ik2.xml").write_text(setup)
    assert opensim.InverseKinematicsTool("ik2.xml").run()
    worst = opensim.TimeSeriesTable("twistcap_ik_marker_errors.sto")
    rms = worst.getDependentColumn("marker_error_RMS").to_numpy()
    assert rms.max() < 0.04  # m; the bones are another's
    ours, theirs = read_mot("angles.mot"), read_mot("ik.mot")
    for name in ("hip_flexion", "knee_angle", "ankle_angle", "arm_flex", "elbow_flex", "hip_adduction"):
        for side in "rl":
            gap = np.degrees(theirs.get(f"{name}_{side}") - ours.get(f"{name}_{side}"))
            assert gap.std() < 5.0 and abs(gap.mean()) < 25.0, name


def test_what_opensim_cannot_hold_is_told(tmp_path: Path) -> None:
    body = two_links()
    with pytest.raises(InputError, match="sliding"):
        opensim_model(body, body.landmarks)
    with pytest.raises(InputError, match="sliding"):
        write_opensim(tmp_path / "none", replace(walk(tmp_path, BODIES["plain"]), body=body))
    assert not (tmp_path / "none").exists()
    plain = humanoid()
    with pytest.raises(InputError, match="look inward"):
        opensim_model(replace(plain, faces=plain.faces[:, ::-1].copy()), plain.landmarks)
    with pytest.raises(InputError, match="lost in every frame; with --fill"):
        write_opensim(tmp_path / "o", walk(tmp_path, BODIES["plain"], lost=True))
    write_opensim(tmp_path / "o", walk(tmp_path, BODIES["plain"], lost=True), fill=True)
    names = [m.get("name") for m in ET.parse(tmp_path / "o" / "markers.xml").iter("Marker")]
    assert tuple(names) == read_trc(tmp_path / "o" / "markers.trc").names and len(names) >= 40


def test_names_that_opensim_does_not_take(opensim: Any, tmp_path: Path) -> None:
    """Blanks, as in "Bip01 L Thigh", would split a label; a path would lead out of the folder."""
    plain = BODIES["plain"]
    parts, angles = [list(names) for names in (plain.segment_names, plain.coordinate_names)]
    parts[:4], angles[:4] = ["a b", "a_b", "../../c", "/d"], ["e f", "e_f", "g/h", "=i*"]
    body = replace(plain, name="my body/1", segment_names=tuple(parts), coordinate_names=tuple(angles))
    write_opensim(tmp_path / "in" / "opensim", walk(tmp_path, body))
    assert {path.name for path in tmp_path.iterdir()} == {"in", "r.h5"}
    assert {path.name for path in (tmp_path / "in").iterdir()} == {"opensim"}
    model = opensim.Model(str(tmp_path / "in" / "opensim" / "model.osim"))
    model.initSystem()
    motion = opensim.Storage(str(tmp_path / "in" / "opensim" / "angles.mot"))
    labels = {motion.getColumnLabels().get(n) for n in range(motion.getColumnLabels().getSize())}
    coordinates = {model.getCoordinateSet().get(n).getName() for n in range(model.getNumCoordinates())}
    assert coordinates == labels - {"time"} and {"e_f", "e_f_", "g_h", "=i_"} < labels
