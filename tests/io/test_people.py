"""Keypoint formats, and who of several people is the same in all views."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from support.cameras import ring
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.io.keypoints import LAYOUTS, read_openpose, read_people
from twistcap.io.people import check_arrangement, same_person
from twistcap.io.recording import keypoints_of
from twistcap.io.session_tables import KeypointSet

BODY = humanoid("full")


def standing(x: float, y: float, bend: float = 0.3) -> Posed:
    root = np.eye(4)
    root[:3, 3] = x, y, 0.93
    q = np.array([bend if n.startswith(("elbow", "knee")) else 0.0 for n in BODY.coordinate_names])
    return Posed(BODY, Pose(root, q))


def seen(posed: Posed, layout: str, rng: np.random.Generator, rig: Rig | None = None) -> np.ndarray:
    """(C, L, 3) as a detector writes it; 0 where the body lacks a name."""
    marks = dict(zip(BODY.landmarks.names, posed.landmarks, strict=True))
    rig = ring() if rig is None else rig
    out = np.zeros((len(rig), len(LAYOUTS[layout]), 3))
    for k, name in enumerate(LAYOUTS[layout]):
        if name in marks:
            for c, camera in enumerate(rig):
                out[c, k] = [*(camera.project(marks[name][None])[0][0] + rng.standard_normal(2)), 0.9]
    return out


@pytest.mark.parametrize(("layout", "count"), [("halpe_26", 26), ("coco_133", 133), ("blazepose", 33)])
def test_a_layout_has_its_joints_once(layout: str, count: int) -> None:
    names = LAYOUTS[layout]
    assert len(names) == len(set(names)) == count
    sides = {n[:-2] for n in names if n.endswith(("_r", "_l"))}
    assert all(f"{n}_r" in names and f"{n}_l" in names for n in sides)
    assert {f"{j}_{s}" for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "toe") for s in "rl"} <= set(
        names
    )


def test_places_in_the_layouts() -> None:
    """Against the numbers in the formats' own documents."""
    halpe, whole, blaze = (LAYOUTS[name] for name in ("halpe_26", "coco_133", "blazepose"))
    assert [halpe[k] for k in (0, 16, 17, 18, 19, 20, 25)] == [
        "nose", "ankle_r", "head_top", "neck", "mid_hip", "toe_l", "heel_r",
    ]  # fmt: skip
    assert [whole[k] for k in (10, 17, 19, 20, 22, 23, 91, 132)] == [
        "wrist_r", "toe_l", "heel_l", "toe_r", "heel_r", "face_0", "hand_l_0", "hand_r_20",
    ]  # fmt: skip
    assert [blaze[k] for k in (0, 2, 5, 11, 16, 23, 28, 29, 32)] == [
        "nose", "eye_l", "eye_r", "shoulder_l", "wrist_r", "hip_l", "ankle_r", "heel_l", "toe_r",
    ]  # fmt: skip


def test_the_person_is_chosen_by_geometry_whatever_the_order() -> None:
    rng = np.random.default_rng(0)
    a, b = seen(standing(-0.5, 0.2), "halpe_26", rng), seen(standing(0.7, -0.3), "halpe_26", rng)
    orders = [(a, b), (b, a), (b, a), (a,)]  # b is not seen by the last camera
    people = [np.stack([person[c] for person in order]) for c, order in enumerate(orders)]
    choice, joints = same_person(ring(), people)
    assert choice == (0, 1, 1, 0)
    known = dict(zip(LAYOUTS["halpe_26"], joints, strict=True))
    truth = dict(zip(BODY.landmarks.names, standing(-0.5, 0.2).landmarks, strict=True))
    assert np.linalg.norm(known["hip_r"] - truth["hip_r"]) < 0.03
    assert same_person(ring(), people, {"cam0": 1})[0] == (1, 0, 0, None)  # named by the user: the other one
    _, other = same_person(ring(), people, {"cam0": 1})
    assert same_person(ring(), people, None, other)[0] == (1, 0, 0, None)  # who was followed before


def test_where_nobody_agrees_the_first_is_taken() -> None:
    rng = np.random.default_rng(1)
    people = [rng.uniform(0, 300, (2, 26, 3)) for _ in range(4)]
    for p in people:
        p[..., 2] = 1.0
    assert same_person(ring(), people)[0] == (0, 0, 0, 0)


def exchanged(people: list[np.ndarray], a: int, b: int) -> list[np.ndarray]:
    return [people[{a: b, b: a}.get(c, c)] for c in range(len(people))]


@pytest.mark.parametrize(("a", "b"), itertools.combinations(range(4), 2))
def test_cameras_whose_keypoints_are_exchanged_are_named(a: int, b: int) -> None:
    """As where their videos are. Of four in a ring, two that face each other are as good as the two others."""
    rng, rig = np.random.default_rng(5), ring()
    one, other = (seen(standing(x, y), "halpe_26", rng) for x, y in ((-0.5, 0.2), (0.3, 0.8)))
    for people in ([one[c][None] for c in range(4)], [np.stack([one[c], other[c]]) for c in range(4)]):
        with pytest.raises(InputError, match=f"only if .*{rig.names[a]} and {rig.names[b]}.* are exchanged") as told:
            check_arrangement(rig, exchanged(people, a, b))
        assert (", or " in str(told.value)) == (b - a == 2)


def test_a_camera_that_shows_somebody_else_is_not_exchanged() -> None:
    rng = np.random.default_rng(6)
    one, other = (seen(standing(x, y), "halpe_26", rng) for x, y in ((-0.5, 0.2), (0.7, -0.3)))
    people = [other[0][None], *(one[c][None] for c in (1, 2, 3))]
    check_arrangement(ring(), people)
    assert same_person(ring(), people)[0] == (None, 0, 0, 0)


@pytest.mark.parametrize("count", [2, 3, 5, 10])
def test_exchanged_cameras_of_other_numbers(count: int) -> None:
    """Two may agree by chance; a camera without people, or with nothing detected, is not asked."""
    rig, person = ring(count), seen(standing(-0.5, 0.2), "halpe_26", np.random.default_rng(7), ring(count))
    people = [person[c][None] for c in range(count)]
    check_arrangement(rig, people)
    if count == 2:
        check_arrangement(rig, exchanged(people, 0, 1))
        return
    with pytest.raises(InputError, match=r"only if cam0 and cam1.* are exchanged"):
        check_arrangement(rig, exchanged(people, 0, 1))
    if count == 5:
        nobody = [*exchanged(people, 0, 1)[:3], np.zeros((0, 26, 3)), 0.0 * people[4]]
        with pytest.raises(InputError, match=r"only if cam0 and cam1.* are exchanged"):
            check_arrangement(rig, nobody)


def test_exchanged_cameras_are_refused_at_the_start_and_nowhere_else(tmp_path: Path) -> None:
    """Later on three cameras of five that are right go on giving keypoints."""
    rig = ring(5)
    person = seen(standing(-0.5, 0.2), "halpe_26", np.random.default_rng(8), rig)
    for c, name in enumerate(rig.names):
        people = [{"pose_keypoints_2d": person[{0: 1, 1: 0}.get(c, c)].ravel().tolist()}]
        (tmp_path / name).mkdir()
        (tmp_path / name / "000000.json").write_text(json.dumps({"people": people}))
    table = KeypointSet(format="halpe_26", folders={n: str(tmp_path / n) for n in rig.names})
    with pytest.raises(InputError, match=r"only if cam0 and cam1.* are exchanged"):
        keypoints_of(table, rig)
    (found,) = keypoints_of(table, rig, first=False)
    np.testing.assert_array_equal((found.confidence > 0).any(axis=1), [False, False, True, True, True])


def test_folders_of_a_session(tmp_path: Path) -> None:
    """Two people, swapped in one view and in one of two frames; the reader follows the same one."""
    rng, rig = np.random.default_rng(2), ring()
    for frame, x in enumerate((-0.5, -0.45)):
        a, b = seen(standing(x, 0.2), "halpe_26", rng), seen(standing(0.7, -0.3), "halpe_26", rng)
        for c, name in enumerate(rig.names):
            pair = (a, b) if (c + frame) % 2 else (b, a)
            if c == 3:
                pair = (a,)
            people = [{"pose_keypoints_2d": person[c].ravel().tolist()} for person in pair]
            (tmp_path / name).mkdir(exist_ok=True)
            (tmp_path / name / f"{frame:06d}.json").write_text(json.dumps({"people": people}))
    table = KeypointSet(format="halpe_26", folders={n: str(tmp_path / n) for n in rig.names}, frames=(0, 1))
    for found, x in zip(keypoints_of(table, rig), (-0.5, -0.45), strict=True):
        marks = dict(zip(BODY.landmarks.names, standing(x, 0.2).landmarks, strict=True))
        for c, camera in enumerate(rig):
            hip = found.pixels[c, found.names.index("hip_r")]
            assert np.linalg.norm(hip - camera.project(marks["hip_r"][None])[0][0]) < 6


def test_annots_of_easymocap_are_read(tmp_path: Path) -> None:
    row = [[10.0 + k, 20.0, 0.5] for k in range(25)]
    (tmp_path / "a.json").write_text(json.dumps({"filename": "x", "annots": [{"personID": 0, "keypoints": row}]}))
    found = read_openpose({"c": tmp_path / "a.json"}, ["c"], "body_25")
    np.testing.assert_allclose(found.pixels[0, :, 0], 10.0 + np.arange(25))
    (tmp_path / "a.json").write_text(json.dumps({"annots": [{"keypoints": row[:24]}]}))
    with pytest.raises(InputError, match=r"a\.json: 'keypoints' of person 0"):
        read_people({"c": tmp_path / "a.json"}, ["c"], "body_25")


def test_where_the_camera_of_a_pin_sees_nobody_the_others_agree() -> None:
    rng = np.random.default_rng(3)
    a, b = seen(standing(-0.5, 0.2), "halpe_26", rng), seen(standing(0.7, -0.3), "halpe_26", rng)
    people = [np.zeros((0, 26, 3)), *(np.stack(pair) for pair in ((a[1], b[1]), (b[2], a[2]), (a[3], b[3])))]
    choice = same_person(ring(), people, {"cam0": 0})[0]
    assert choice in ((None, 0, 1, 0), (None, 1, 0, 1))  # one person, not the first of each


@pytest.mark.parametrize(
    ("pinned", "words"),
    [({"cam9": 0}, "'cam9', which is not in use"), ({"cam1": 1}, r"person 1 is needed, but the file holds 1")],
)
def test_a_pin_that_fits_nobody_is_told(tmp_path: Path, pinned: dict[str, int], words: str) -> None:
    rig, person = ring(), seen(standing(0.0, 0.0), "halpe_26", np.random.default_rng(4))
    for c, name in enumerate(rig.names):
        (tmp_path / name).mkdir()
        people = [{"pose_keypoints_2d": person[c].ravel().tolist()}]
        (tmp_path / name / "000000.json").write_text(json.dumps({"people": people}))
    folders = {n: str(tmp_path / n) for n in rig.names}
    with pytest.raises(InputError, match=words):
        keypoints_of(KeypointSet(format="halpe_26", folders=folders, person=pinned), rig)
    for below in (-1, {"cam1": -1}):
        with pytest.raises(ValueError, match="greater than or equal to 0"):
            KeypointSet(format="halpe_26", folders=folders, person=below)  # type: ignore[arg-type]
