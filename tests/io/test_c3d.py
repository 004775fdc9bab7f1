"""C3D, read back by ezc3d and by py-c3d."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.cameras import ring
from twistcap.arrays import Float
from twistcap.body import Body, Landmarks, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.body.surface_markers import surface_markers
from twistcap.errors import InputError
from twistcap.estimate import Estimate
from twistcap.evaluate.other_systems import read_c3d
from twistcap.io.c3d import room, write_c3d
from twistcap.io.markers import TO_FILE
from twistcap.io.result import Result, ResultWriter, read_result
from twistcap.studio.motion import gait

ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is not installed (pip install 'twistcap[c3d]')")
FIRST, LOST, DROPPED = 30, 4, 7


@pytest.fixture(scope="module")
def body() -> Body:
    return humanoid()


@pytest.fixture(scope="module")
def result(body: Body, tmp_path_factory: pytest.TempPathFactory) -> Result:
    """Twelve frames of a walk from frame 30 on; one lost, one dropped."""
    path = tmp_path_factory.mktemp("c3d") / "r.h5"
    A = np.random.default_rng(0).normal(size=(body.dof, body.dof)) * 2e-4
    with ResultWriter(path, body, ring(), {}) as writer:
        for n, pose in enumerate(gait(body, frames=12, heading=0.5)):
            if n != DROPPED:
                time = (FIRST + n) / 60
                writer.append(Estimate(FIRST + n, time, pose, A @ A.T, lost=n == LOST))
    return read_result(path)


def read(path: Path) -> dict:
    return ezc3d.c3d(str(path))


def points_of(body: Body, pose: Pose, stuck: Landmarks | None = None) -> tuple[tuple[str, ...], Float]:
    """Names and places of all points; markers that were `stuck` to the body before need not be found again."""
    stuck, posed = surface_markers(body) if stuck is None else stuck, Posed(body, pose)
    moved = np.einsum("nij,nj->ni", posed.segment_transforms[stuck.segments][:, :3, :3], stuck.points)
    moved += posed.segment_transforms[stuck.segments][:, :3, 3]
    return (*body.landmarks.names, *stuck.names), np.concatenate([posed.landmarks, moved])


@pytest.mark.parametrize("axes", ["opensim", "pose2sim", "z_up"])
def test_points_and_times(result: Result, tmp_path: Path, axes: str) -> None:
    write_c3d(tmp_path / "a.c3d", result, axes)  # type: ignore[arg-type]
    file = read(tmp_path / "a.c3d")
    points, head = file["data"]["points"], file["header"]["points"]
    names, _ = points_of(result.body, result.poses[0])
    assert tuple(file["parameters"]["POINT"]["LABELS"]["value"]) == names
    assert file["parameters"]["POINT"]["UNITS"]["value"] == ["mm"]
    slots = np.round(result.times * 60).astype(int) - FIRST
    for k, slot in enumerate(slots):
        if k != LOST:
            wanted = points_of(result.body, result.poses[k])[1] @ TO_FILE[axes].T
            np.testing.assert_allclose(points[:3, :, slot].T, 1000 * wanted, atol=1e-3)
    empty = np.isnan(points[0]).all(axis=0)
    assert np.flatnonzero(empty).tolist() == [LOST, DROPPED]
    np.testing.assert_array_equal((head["first_frame"] + slots) / head["frame_rate"], result.times)
    assert file["data"]["analogs"].shape[1] == 0
    np.testing.assert_array_equal(
        file["parameters"]["TWISTCAP"]["LOST"]["value"], np.repeat([FIRST + LOST, FIRST + DROPPED], 2) + 1
    )


def test_residuals_are_the_standard_deviations_of_the_points(result: Result, tmp_path: Path) -> None:
    """Read by py-c3d, which has the bytes of a float file as c3d.org says; σ again by moving the pose at random."""
    pyc3d = pytest.importorskip("c3d", reason="py-c3d is not installed")
    write_c3d(tmp_path / "a.c3d", result, "z_up")
    with warnings.catch_warnings(), (tmp_path / "a.c3d").open("rb") as file:
        warnings.simplefilter("ignore")
        frames = [frame[1] for frame in pyc3d.Reader(file).read_frames()]
    assert (frames[LOST][:, 3] == -1).all() and (frames[DROPPED][:, 3] == -1).all()
    rng, covariance = np.random.default_rng(1), result.covariances[0]
    steps = rng.multivariate_normal(np.zeros(result.body.dof), covariance, size=400)
    body, pose, stuck = result.body, result.poses[0], surface_markers(result.body)
    _, at_rest = points_of(body, pose, stuck)
    moved = np.array([points_of(body, pose.retract(step), stuck)[1] for step in steps]) - at_rest
    sigma = 1000 * np.sqrt(np.mean(np.sum(moved**2, axis=2), axis=0))
    assert sigma.max() > 1.5 * sigma.min()
    np.testing.assert_allclose(frames[0][:, 3], sigma, rtol=0.15)
    np.testing.assert_allclose(frames[0][:, :3], 1000 * at_rest, atol=1e-3)


def test_segments_as_visual3d_reads_them(result: Result, tmp_path: Path) -> None:
    write_c3d(tmp_path / "a.c3d", result)
    file = read(tmp_path / "a.c3d")
    labels, matrices = file["parameters"]["ROTATION"]["LABELS"]["value"], file["data"]["rotations"]
    points, names = file["data"]["points"], file["parameters"]["POINT"]["LABELS"]["value"]
    assert {"worldbody_4X4", "pelvis_4X4", "torso_4X4", "r_thigh_4X4", "l_larm_4X4"} <= set(labels)
    assert file["parameters"]["ROTATION"]["RATE"]["value"] == [60.0]
    for label, top, bottom in (("thigh", "hip", "knee"), ("shank", "knee", "ankle"), ("uarm", "shoulder", "elbow")):
        for side in "rl":
            T = matrices[:, :, labels.index(f"{side}_{label}_4X4"), 0]
            upper, lower = (points[:3, names.index(f"{mark}_{side}"), 0] for mark in (top, bottom))
            np.testing.assert_allclose(T[:3, 3], upper, atol=1e-2)  # origin in the upper joint
            np.testing.assert_allclose(T[:3, 2], (upper - lower) / np.linalg.norm(upper - lower), atol=1e-4)
            assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0, abs=1e-5)
            right = points[:3, names.index("hip_r"), 0] - points[:3, names.index("hip_l"), 0]
            assert T[:3, 0] @ right / np.linalg.norm(right) > 0.7  # x to the right on both sides
    assert np.isnan(matrices[:, :, 1, LOST]).all() and not np.isnan(matrices[:, :, 1, 0]).any()


def test_lost_frames_are_filled_on_demand_and_still_told(result: Result, tmp_path: Path) -> None:
    write_c3d(tmp_path / "a.c3d", result, fill=True)
    file = read(tmp_path / "a.c3d")
    assert np.flatnonzero(np.isnan(file["data"]["points"][0]).all(axis=0)).tolist() == [DROPPED]
    np.testing.assert_array_equal(
        file["parameters"]["TWISTCAP"]["LOST"]["value"], np.repeat([FIRST + LOST, FIRST + DROPPED], 2) + 1
    )


def test_what_c3d_cannot_hold_is_told(result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    late = replace(result, times=result.times + np.where(result.indices > 40, 2000.0, 0.0))
    with pytest.raises(InputError, match=r"room for \d+ frames, the result has 12001\d; export it in parts"):
        write_c3d(tmp_path / "a.c3d", late)
    uneven = replace(result, times=result.times + 0.005 * (result.indices % 3))
    with pytest.raises(InputError, match="not evenly spaced"):
        write_c3d(tmp_path / "a.c3d", uneven)
    monkeypatch.setitem(__import__("sys").modules, "ezc3d", None)
    with pytest.raises(InputError, match=r"twistcap\[c3d\]"):
        write_c3d(tmp_path / "a.c3d", result)


def test_a_late_part_keeps_its_times(result: Result, tmp_path: Path) -> None:
    """Its frames have numbers that the format does not hold."""
    late = replace(result, times=result.times + 1200.0)
    write_c3d(tmp_path / "a.c3d", late)
    assert read(tmp_path / "a.c3d")["header"]["points"]["first_frame"] == 0
    times = read_c3d(tmp_path / "a.c3d").times
    np.testing.assert_allclose(times[[0, -1]], late.times[[0, -1]], atol=1e-4)
    write_c3d(tmp_path / "b.c3d", result)
    np.testing.assert_allclose(read_c3d(tmp_path / "b.c3d").times[[0, -1]], result.times[[0, -1]], atol=1e-9)


def test_as_many_frames_as_there_is_room_for(result: Result, tmp_path: Path) -> None:
    """The last block of points and the first of matrices come back: the limit is right."""
    most = room(len(points_of(result.body, result.poses[0])[0]))
    times = np.array([0.0, 1.0, 2.0, most - 1]) / 60
    few = replace(result.within(FIRST, FIRST + 3), times=times)
    write_c3d(tmp_path / "a.c3d", few)
    file = read(tmp_path / "a.c3d")
    assert file["data"]["points"].shape[2] == file["data"]["rotations"].shape[3] == most
    np.testing.assert_allclose(file["data"]["rotations"][:, :, 0, most - 1], np.eye(4))
    assert np.isfinite(file["data"]["points"][0, :, most - 1]).all()


def test_all_spans_without_the_body_are_listed(body: Body, tmp_path: Path) -> None:
    """Every other frame is lost: 300 spans, of which a parameter holds 127."""
    with ResultWriter(tmp_path / "r.h5", body, ring(), {}) as writer:
        for n in range(601):
            writer.append(Estimate(n, n / 60, Pose.rest(body), np.eye(body.dof) * 1e-6, lost=n % 2 == 1))
    write_c3d(tmp_path / "a.c3d", read_result(tmp_path / "r.h5"))
    file = read(tmp_path / "a.c3d")
    found = file["parameters"]["TWISTCAP"]
    assert [len(found[name]["value"]) for name in ("LOST", "LOST2", "LOST3")] == [254, 254, 92]
    ends = np.concatenate([found[name]["value"] for name in ("LOST", "LOST2", "LOST3")])
    gaps = np.arange(1, 601, 2) + 1  # as the file counts
    np.testing.assert_array_equal(ends.reshape(-1, 2), np.stack([gaps, gaps], axis=1))
    assert np.isnan(file["data"]["points"][0]).all(axis=0).sum() == len(gaps)
    assert room(74, 5000) < room(74)
