"""Agreement with another system: numbers by hand and by other formulas, its clock, its world, its files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.cameras import ring
from support.commands import document, refusal, run
from twistcap import se3
from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.errors import InputError
from twistcap.estimate import Estimate
from twistcap.evaluate.agreement import agreements
from twistcap.evaluate.alignment import world_motion
from twistcap.evaluate.load import load_reference
from twistcap.evaluate.other_systems import landmark_name, read_c3d
from twistcap.evaluate.reference import evaluate
from twistcap.io.exports import export
from twistcap.io.markers import write_trc
from twistcap.io.motion_files import read_mot, write_mot
from twistcap.io.result import Result, ResultWriter, read_result
from twistcap.studio.motion import gait

LATE, COUNT = 0.4133, 90  # s that the other clock is behind ours; frames


@pytest.fixture(scope="module")
def body() -> Body:
    return humanoid()


@pytest.fixture(scope="module")
def result(body: Body, tmp_path_factory: pytest.TempPathFactory) -> Result:
    path = tmp_path_factory.mktemp("agreement") / "r.h5"
    with ResultWriter(path, body, ring(), {}) as writer:
        for n, pose in enumerate(gait(body, frames=COUNT, heading=0.4)):
            writer.append(Estimate(n, n / 60, pose, np.eye(body.dof) * 1e-5))
    return read_result(path)


def other_clock(body: Body) -> tuple[np.ndarray, list[Pose]]:
    """The same walk sampled at 100 a second by a clock that is behind, for longer."""
    times = np.arange(-40, 220) / 100
    fine = gait(body, fps=2000.0, frames=int(2.6 * 2000) + 2, heading=0.4, phase=0.0)
    at = np.clip(np.round(times * 2000).astype(int), 0, None)
    keep = times >= 0
    return times[keep] - LATE, [fine[k] for k in at[keep]]


def test_agreement_by_hand() -> None:
    reference = np.array([[0.0], [10.0], [20.0], [30.0], [np.nan]])
    difference = np.array([[1.0], [3.0], [1.0], [3.0], [9.0]])
    (found,) = agreements(["knee"], difference, reference)
    assert found.frames == 4 and found.bias == 2.0
    sd = np.std([1, 3, 1, 3], ddof=1)
    assert (found.lower, found.upper) == pytest.approx((2 - 1.96 * sd, 2 + 1.96 * sd))
    assert found.rmse == pytest.approx(np.sqrt(5)) and found.rmse_offset_removed == pytest.approx(1.0)
    assert found.correlation == pytest.approx(np.corrcoef([0, 10, 20, 30], [1, 13, 21, 33])[0, 1])


def test_cmc_is_an_anova() -> None:
    """1 − (mean square within frames) / (mean square of all), by scipy-free sums in another order."""
    rng = np.random.default_rng(0)
    theirs = np.sin(np.linspace(0, 6, 50)) * 20
    difference = rng.normal(scale=3, size=50) + 2
    (found,) = agreements(["hip"], difference[:, None], theirs[:, None])
    ours, frames = theirs + difference, 50
    within = sum((o - t) ** 2 / 2 for o, t in zip(ours, theirs, strict=True)) / frames
    everything = np.concatenate([ours, theirs])
    assert found.cmc == pytest.approx(np.sqrt(1 - within / everything.var(ddof=1)))
    (far,) = agreements(["hip"], np.full((50, 1), 200.0), theirs[:, None])
    assert np.isnan(far.cmc) and far.correlation == pytest.approx(1.0)
    still = np.radians(90.0) + 1e-16 * rng.normal(size=50)  # a coordinate that a model holds, as a file rounds it
    assert np.isnan(agreements(["pro_sup"], difference[:, None], np.degrees(still)[:, None])[0].correlation)
    (nothing,) = agreements(["hip"], np.full((3, 1), np.nan), np.zeros((3, 1)))
    assert nothing.frames == 0 and np.isnan(nothing.rmse)


def test_the_other_clock_is_found_by_angles(result: Result, body: Body, tmp_path: Path) -> None:
    times, poses = other_clock(body)
    write_mot(tmp_path / "b.mot", body, times, poses)
    wrong = evaluate(result, tmp_path / "b.mot")
    found = evaluate(result, tmp_path / "b.mot", align=True)
    added = float(found.notes[-1].split()[0])
    assert added == pytest.approx(LATE, abs=0.001)
    assert max(a.rmse for a in found.agreements) < 0.3 < max(a.rmse for a in wrong.agreements)
    knee = next(a for a in found.agreements if a.name == "knee_angle_r")
    assert knee.cmc > 0.999 and knee.correlation > 0.999


def test_clock_and_world_are_found_by_points(result: Result, body: Body, tmp_path: Path) -> None:
    """Another laboratory: its world is turned and shifted, some points it does not see."""
    times, poses = other_clock(body)
    points = np.stack([Posed(body, pose).landmarks for pose in poses])
    points = points @ se3.exp_rotation(np.array([0.1, 0.2, 2.0])).T + [3.0, -1.0, 0.5]
    points[40:60, 3] = np.nan
    write_trc(tmp_path / "b.trc", times, body.landmarks.names, points, axes="z_up")
    found = evaluate(result, tmp_path / "b.trc", axes="z_up", align=True, register=True)
    assert float(found.notes[0].split()[0]) == pytest.approx(LATE, abs=0.002)
    assert "turned by" in found.notes[1]
    assert max(d.rmse for d in found.distances) < 3.0
    alone = evaluate(result, tmp_path / "b.trc", axes="z_up", align=True)
    assert min(d.mean for d in alone.distances) > 100


def test_world_motion_is_a_rotation_even_for_mirrored_points() -> None:
    ours = np.random.default_rng(0).normal(size=(1, 9, 3))
    R, _ = world_motion(ours, ours * [1, 1, -1])
    assert np.linalg.det(R) == pytest.approx(1.0)
    with pytest.raises(InputError, match="three points"):
        world_motion(ours[:, :2], ours[:, :2])


def test_what_does_not_move_tells_no_time(result: Result, body: Body, tmp_path: Path) -> None:
    write_mot(tmp_path / "later.mot", body, np.arange(90) / 60 + 50.0, result.poses)
    with pytest.raises(InputError, match="the result has 1 frames, and it takes 10"):
        evaluate(result.within(0, 0), tmp_path / "later.mot", align=True)
    with pytest.raises(InputError, match="no movement in common"):
        evaluate(result, tmp_path / "later.mot", align=True)


def test_c3d_of_another_system(result: Result, tmp_path: Path) -> None:
    """Points by name, and the joints at which Theia's segments begin, in a file without such points."""
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    whole = export(result, "c3d", tmp_path)
    evaluation = evaluate(result, whole)
    assert len(evaluation.distances) == 12 and max(d.rmse for d in evaluation.distances) < 1e-3
    file = ezc3d.c3d(str(whole))
    keep = [k for k, name in enumerate(file["parameters"]["POINT"]["LABELS"]["value"]) if name in ("RLFC", "nose")]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["RLFC", "nose"]
    file["parameters"]["POINT"]["DESCRIPTIONS"]["value"] = ["", ""]
    file["data"]["points"] = file["data"]["points"][:, keep]
    del file["data"]["meta_points"]
    file.write(str(tmp_path / "theia.c3d"))
    held = read_c3d(tmp_path / "theia.c3d")
    assert {"RLFC", "nose", "hip_r", "knee_l", "elbow_r"} <= set(held.names)
    np.testing.assert_allclose(held.times, result.times)
    only = evaluate(result, tmp_path / "theia.c3d")
    assert {d.name for d in only.distances} == {
        f"{j}_{s}" for j in ("hip", "knee", "ankle", "shoulder", "elbow") for s in "rl"
    }
    assert max(d.rmse for d in only.distances) < 0.01


@pytest.mark.parametrize("content", [b"", b"\x02\x50", b"\x02\x50" + bytes(600), b"no C3D at all" * 60])
def test_damaged_c3d(tmp_path: Path, content: bytes) -> None:
    pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    (tmp_path / "a.c3d").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.c3d (is no C3D|cannot be read|: POINT)|a\.c3d"):
        read_c3d(tmp_path / "a.c3d")


def test_names_of_joint_centres() -> None:
    names = [landmark_name(name) for name in ("RHJC", "LKJC", "RHip", "RASI", "nose")]
    assert names == ["hip_r", "knee_l", "hip_r", "RASI", "nose"]


def test_command_fits_80_columns(
    result: Result, body: Body, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with ResultWriter(tmp_path / "r.h5", body, ring(), {}) as writer:
        for estimate in result.estimates:
            writer.append(estimate)
    write_mot(tmp_path / "b.mot", body, result.times, [Pose(p.root, p.q + 0.3) for p in result.poses])
    capsys.readouterr()
    assert run("evaluate", tmp_path / "r.h5", "--reference", tmp_path / "b.mot") == 0
    out = capsys.readouterr().out.splitlines()
    assert all(len(line) <= 80 for line in out)
    knee = next(line for line in out if line.strip().startswith("knee_angle_r"))
    assert knee.split()[:2] == ["knee_angle_r", "-17.19"]
    write_mot(tmp_path / "isb.mot", body, result.times, result.poses, angles="isb")
    assert run("evaluate", tmp_path / "r.h5", "--reference", tmp_path / "isb.mot") == 0
    out = capsys.readouterr().out
    assert "isb_shoulder_elevation_l " in out and "…" not in out.partition("angles, deg")[2]  # not cut: sides differ
    found = document(capsys, "evaluate", tmp_path / "r.h5", "--reference", tmp_path / "b.mot", "--align")
    assert {a["name"] for a in found["agreements_deg"]} == set(body.coordinate_names)
    said = refusal(capsys, "evaluate", tmp_path / "r.h5", "--reference", tmp_path / "b.mot", "--axes", "sideways")
    assert "axes" in said


def test_rows_that_are_excluded_are_those_of_the_file(result: Result, body: Body, tmp_path: Path) -> None:
    """Also behind a span that a file of ours leaves out."""
    known = np.ones(len(result), np.bool_)
    known[20:30] = False
    write_mot(tmp_path / "a.mot", body, result.times, result.poses, known=known)
    reference = load_reference(tmp_path / "a.mot", body, lambda count: result.times[:count])
    k, times = reference.coordinate_names.index("knee_angle_r"), read_mot(tmp_path / "a.mot").times
    left = reference.without(["knee_angle_r:40-44"])
    gone = np.isfinite(reference.angles[:, k]) & np.isnan(left.angles[:, k])
    np.testing.assert_array_equal(reference.times[gone], times[40:45])
    with pytest.raises(InputError, match=f"rows 0 to {len(times) - 1}"):
        reference.without([f"knee_angle_r:{len(times)}"])


def test_agreement_is_that_of_the_files(result: Result, body: Body, tmp_path: Path) -> None:
    """The bias of the shoulder equals what anybody computes from both MOT files."""
    rng = np.random.default_rng(1)
    off = [Pose(p.root, p.q + rng.normal(scale=0.2, size=len(p.q))) for p in result.poses]
    write_mot(tmp_path / "ours.mot", body, result.times, result.poses)
    write_mot(tmp_path / "theirs.mot", body, result.times, off)
    ours, theirs = read_mot(tmp_path / "ours.mot"), read_mot(tmp_path / "theirs.mot")
    found = {a.name: a for a in evaluate(result, tmp_path / "theirs.mot").agreements}
    for name in ("arm_flex_r", "arm_add_l", "arm_rot_r", "pro_sup_l", "knee_angle_r"):
        difference = np.degrees(ours.get(name) - theirs.get(name))
        assert found[name].bias == pytest.approx(difference.mean(), abs=1e-5), name
        assert found[name].rmse == pytest.approx(np.sqrt(np.mean(difference**2)), abs=1e-5), name


def test_arms_raised_past_the_lock_agree(body: Body, tmp_path: Path) -> None:
    """Beyond 90° both ways of writing a shoulder are right; each system may take another."""
    times, rng = np.arange(240) / 60, np.random.default_rng(0)
    q, arms = np.zeros((240, len(body.coordinate_names))), list[int]()
    for side in "rl":
        own = [body.coordinate(f"arm_{part}_{side}") for part in ("add", "flex", "rot")]
        q[:, own[0]] = -np.radians(10 + 75 * (1 - np.cos(np.pi * times)))
        q[:, own[1]], q[:, own[2]] = np.radians(rng.uniform(-10, 10)), np.radians(20 * np.sin(times))
        arms += own
    noisy = q.copy()
    noisy[:, arms] += np.radians(2) * rng.standard_normal((240, len(arms)))
    rest = Pose.rest(body).root
    with ResultWriter(tmp_path / "r.h5", body, ring(), {}) as writer:
        for n, row in enumerate(noisy):
            writer.append(Estimate(n, float(times[n]), Pose(rest, row), np.eye(body.dof) * 1e-5))
    write_mot(tmp_path / "theirs.mot", body, times, [Pose(rest, row) for row in q])
    found = evaluate(read_result(tmp_path / "r.h5"), tmp_path / "theirs.mot").agreements
    assert max(a.rmse for a in found if a.name.startswith("arm_")) < 15.0
