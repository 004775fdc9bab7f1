"""Looking for the whole body where it was lost: after gaps, after it left, and with a camera that contradicts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import islice, product

import cv2
import numpy as np
import pytest

from support.faulty_walk import FAULT, empty, tracked_walk, walk
from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.body.limbs import limbs
from twistcap.build import build
from twistcap.camera.bump import turned_back
from twistcap.cues.view import steadied
from twistcap.estimate import Frame, Keypoints
from twistcap.hindsight import tracked
from twistcap.predict import Moment, Prediction
from twistcap.search.body import BodyRule, BodySearch
from twistcap.search.limb import LimbRule, placed
from twistcap.search.placing import Stance
from twistcap.search.stances import bundled
from twistcap.studio import StudioConfig, capture
from twistcap.track import Model, Tracker
from twistcap.track.step import posed_problem

BUMP = np.deg2rad([0.9, -1.6, 0.8])


@cache
def _while_gone(faulty: Callable[[Frame], Frame]) -> list[tuple[float, Pose]]:
    """Error and pose of each frame, for all tests that look at the same track."""
    return [(error, tracker.state.past.last) for error, tracker in tracked_walk(faulty)]


def _black(frame: Frame) -> Frame:
    return replace(frame, images=tuple(np.zeros_like(image) for image in frame.images))


def _gone(frame: Frame) -> Frame:
    return replace(frame, images=(None,) * len(frame.images))


@pytest.mark.parametrize("faulty", [empty, _black, _gone])
def test_a_body_that_was_gone_is_found_where_it_is_now(faulty: Callable[[Frame], Frame]) -> None:
    scene, _ = walk()
    walked = np.linalg.norm((scene.landmarks[FAULT[-1]] - scene.landmarks[FAULT[0]])[0])
    assert walked > 0.4  # far beyond what a contour pulls
    errors = [error for error, _ in _while_gone(faulty)]
    assert min(errors[FAULT[-1] + 1 :]) < 0.02
    assert errors[-1] < 0.02


def test_a_first_pose_beside_the_person_is_moved_there() -> None:
    pose = walk()[0].first_pose
    beside = Pose(se3.transform(pose.root[:3, :3], pose.root[:3, 3] + (0.2, -0.22, 0.0)), pose.q)
    errors = [error for error, _ in islice(tracked_walk(lambda frame: frame, beside), 3)]
    assert errors[0] < 0.05
    assert errors[-1] < 0.02


def test_a_limb_of_the_first_pose_that_is_wrong_is_set_right() -> None:
    """In nearly all cases: among wrong places of a limb another one may agree as well."""
    scene, _ = walk()
    worst = list[float]()
    for joint, degrees in product(("hip_flexion_r", "arm_flex_l", "neck"), (50.0, 70.0)):
        q = scene.first_pose.q.copy()
        q[[name.startswith(joint) for name in scene.body.coordinate_names]] += np.deg2rad(degrees)
        errors = [error for error, _ in islice(tracked_walk(lambda frame: frame, Pose(scene.first_pose.root, q)), 2)]
        worst.append(max(errors))
    assert np.count_nonzero(np.array(worst) < 0.05) >= 5


def test_a_limb_is_looked_for_unasked_where_it_is_better_elsewhere() -> None:
    scene, frames = walk()
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), 12)
    model, truth = tracker.model, scene.true_poses[12]
    none = np.zeros((scene.body.dof, scene.body.dof))
    problem = posed_problem(tracker.state, frames[12], model, Prediction(truth, "hold", none, none))
    known, rule = tracker.state.searches["lost body"].known, LimbRule()
    evidence, arm = (
        known.evidence(problem),
        next(limb for limb in limbs(scene.body) if limb[6 + scene.body.coordinate("arm_flex_r")]),
    )
    bent = truth.retract(np.where(arm, 0.9, 0.0)).within(scene.body.limits)
    for pose, moved in ((truth, False), (bent, True)):
        nats = evidence.of(pose)
        found, more = placed(rule, known.angles, evidence, arm, np.random.default_rng(0), pose, nats, 40.0)
        assert (found is not pose, more > nats) == (moved, moved)
    off = np.linalg.norm(Posed(scene.body, found).landmarks - scene.landmarks[12], axis=1)
    assert off.max() < 0.08


def test_a_body_in_a_stance_that_it_never_showed_is_found_far_away_after_long() -> None:
    """It walks; all that the recording has shown is a squat, elsewhere, longer ago than the history goes."""
    scene, frames = walk()
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), 12)
    state, squat = tracker.state, next(s for s in bundled(scene.body) if s.height < 0.6)
    away = Pose(se3.transform(np.eye(3), np.array([2.0, 2.0, squat.height])), squat.q)
    moments = (Moment(frames[11].time, away, seen=False),)
    past = replace(state.past, moments=moments, seen_time=frames[11].time - 5.0)
    none = np.zeros((scene.body.dof, scene.body.dof))
    problem = posed_problem(state.with_past(past), frames[12], tracker.model, Prediction(away, "hold", none, none))
    known = state.searches["lost body"].known
    known = replace(known, turns=squat.turn[None], heights=np.array([squat.height]), angles=squat.q[None])
    evidence = known.evidence(problem)
    _check_found(BodySearch(BodyRule(), LimbRule(), known, problem, evidence).found(), 12)
    gone = Pose(se3.transform(np.eye(3), np.array([17.0, 2.0, squat.height])), squat.q)  # what was found there ran away
    run_away = replace(problem, state=state.with_past(replace(past, moments=(Moment(frames[11].time, gone),))))
    surely = Moment(frames[11].time - 5.0, away)
    _check_found(BodySearch(BodyRule(), LimbRule(), known, run_away, evidence, surely).found(), 12)


def _check_found(pose: Pose | None, frame: int) -> None:
    scene, _ = walk()
    assert pose is not None
    assert np.linalg.norm(Posed(scene.body, pose).landmarks - scene.landmarks[frame], axis=1).max() < 0.06


def test_an_arm_thrown_faster_than_a_contour_reaches_is_kept() -> None:
    """A body at rest whose right arm is thrown forward, 35° from frame to frame, elbow bent on the way."""
    still, poses = capture(StudioConfig(seed=0, views=3, frames=1)), list[Pose]()
    arm, elbow = (still.body.coordinate(f"{name}_flex_r") for name in ("arm", "elbow"))
    for k in range(12):
        q = still.first_pose.q.copy()
        q[[arm, elbow]] += np.deg2rad([35.0, 15.0]) * np.clip(k - 5, 0, 4)
        poses.append(Pose(still.first_pose.root, q))
    scene = capture(StudioConfig(seed=0, views=3, frames=len(poses)), still.body, poses)
    model = build(scene.body, scene.rig)

    def off(model: Model) -> float:
        """m by which the farthest landmark is off at the end."""
        last = list(tracked(scene.frames(), model, scene.first_pose))[-1]
        return float(np.linalg.norm(Posed(scene.body, last.pose).landmarks - scene.landmarks[-1], axis=1).max())

    assert off(replace(model, searches=())) > 0.15
    assert off(model) < 0.03


def test_a_body_that_is_nowhere_is_held() -> None:
    poses = [pose for _, pose in _while_gone(empty)]
    roots = np.array([pose.root[:3, 3] for pose in poses])[FAULT]
    assert np.linalg.norm(roots[-1] - roots[-4]) < 0.03


def _turned(frame: Frame, cameras: tuple[int, ...]) -> Frame:
    """The frame as if some cameras had been turned by 2 degrees."""
    rig, images = walk()[0].rig, list(frame.images)
    for i in cameras:
        image = images[i]
        assert image is not None
        images[i] = turned_back(image, rig[i], -BUMP)
    return replace(frame, images=tuple(images))


@pytest.mark.parametrize("cameras", [(0,), (0, 1, 2)])
def test_bumped_cameras_are_turned_back_until_they_stand_again(cameras: tuple[int, ...]) -> None:
    track = [(error, tracker.state) for error, tracker in tracked_walk(lambda frame: _turned(frame, cameras))]
    assert max(error for error, _ in track) < 0.04
    assert all(state.left_out == () for _, state in track)
    for k, (_, state) in enumerate(track):
        moved = [i for i in range(3) if np.any(state.bumps[i])]
        assert moved == (list(cameras) if k in FAULT else [])
        np.testing.assert_allclose(state.bumps[moved], np.tile(BUMP, (len(moved), 1)), atol=np.deg2rad(0.05))


@pytest.mark.parametrize("cameras", [(0,), (1, 2)])
def test_a_camera_that_is_bumped_while_nobody_is_in_sight(cameras: tuple[int, ...]) -> None:
    def faulty(frame: Frame) -> Frame:
        seen = empty(frame) if frame.index < FAULT[8] else frame
        return _turned(seen, cameras) if frame.index >= FAULT[4] else seen

    track = [(error, tracker.state.bumps) for error, tracker in tracked_walk(faulty)]
    assert min(error for error, _ in track[FAULT[8] : FAULT[8] + 4]) < 0.02
    assert max(error for error, _ in track[FAULT[12] :]) < 0.03
    np.testing.assert_allclose(track[FAULT[12]][1][list(cameras)], np.tile(BUMP, (len(cameras), 1)), atol=0.001)


def test_a_camera_that_all_but_stands_as_it_did_is_left_in_peace() -> None:
    """Else it would be looked at, and found turned, in every frame."""
    rig, little = walk()[0].rig, np.deg2rad([0.02, 0.03, 0.03])

    def faulty(frame: Frame) -> Frame:
        if frame.index < FAULT[4]:
            return _turned(frame, (0,))
        first = frame.images[0]
        assert first is not None
        return replace(frame, images=(turned_back(first, rig[0], -little), *frame.images[1:]))

    states = [tracker.state for _, tracker in tracked_walk(faulty)]
    assert np.any(states[FAULT[3]].bumps[0])
    assert not any(np.any(state.bumps) for state in states[FAULT[6] :])
    unrest = [state.searches["lost body"].unrest.restless[0] for state in states[FAULT[6] : FAULT[-1]]]
    assert np.all(np.diff(unrest) < 0.0)


def test_cameras_that_sway_are_followed() -> None:
    rig = walk()[0].rig

    def swayed(k: int) -> Float:
        return np.outer([1.0, -1.3, 0.8], np.deg2rad([0.6, 0.9, 0.4])) * np.sin(0.4 * (k - FAULT[0]))

    def swaying(frame: Frame) -> Frame:
        turns = swayed(frame.index)
        images = [turned_back(image, c, -b) for image, c, b in zip(frame.images, rig, turns, strict=True)]
        return replace(frame, images=tuple(images))

    track = [(error, tracker.state.bumps) for error, tracker in tracked_walk(swaying)]
    assert max(error for error, _ in track) < 0.04
    off = [np.linalg.norm(track[k][1] - swayed(k), axis=1).max() for k in FAULT]
    assert np.rad2deg(max(off)) < 0.25 and np.rad2deg(np.median(off)) < 0.08


def test_keypoints_of_a_turned_camera_do_not_count() -> None:
    scene, frames = walk()
    keypoints = Keypoints(("knee_r",), np.zeros((3, 1, 2)), np.ones((3, 1)))
    turned = steadied(replace(frames[0], keypoints=keypoints), np.outer([0.0, 1.0, 0.0], BUMP), scene.rig)
    assert turned.keypoints is not None and turned.keypoints.confidence.ravel().tolist() == [1.0, 0.0, 1.0]
    assert [now is before for now, before in zip(turned.images, frames[0].images, strict=True)] == [True, False, True]


def test_a_moved_camera_is_left_out_and_taken_back() -> None:
    """It has not only been turned: no turn explains its picture."""

    def moved(frame: Frame) -> Frame:
        first = frame.images[0]
        assert first is not None
        larger = np.array([[1.15, 0.0, 14.0], [0.0, 1.15, 6.0]])
        return replace(
            frame, images=(np.asarray(cv2.warpAffine(first, larger, (320, 240)), np.uint8), *frame.images[1:])
        )

    track = [(error, tracker.state) for error, tracker in tracked_walk(moved)]
    assert max(error for error, _ in track) < 0.25  # which two cameras and a walk leave
    out = [state.left_out for _, state in track]
    assert all(cameras == () for cameras in out[: FAULT[0]])
    assert all(cameras == (0,) for cameras in out[FAULT[0] + 4 : FAULT[-1]])
    assert out[-1] == () and not any(np.any(state.bumps) for _, state in track)


@pytest.mark.parametrize(
    ("factor", "more"), [(0.5, (0.0, 0.0, 0.0)), (0.4, (60.0, 40.0, 10.0)), (0.6, (80.0, 0.0, 0.0)), (1.3, (0.0,) * 3)]
)
def test_a_switched_light_moves_nothing(factor: float, more: tuple[float, ...]) -> None:
    """The look that was learnt before would: colours of the old light pass for no part's, or for another's."""

    def switched(frame: Frame) -> Frame:
        lit = [np.clip(factor * np.float32(image) + more, 0, 255).astype(np.uint8) for image in frame.images]
        return replace(frame, images=tuple(lit))

    errors = [error for error, _ in tracked_walk(switched)]
    assert max(errors) < 0.04


def test_a_switched_light_is_said_in_the_frame_in_which_it_is() -> None:
    """Nothing is said of the first frame, in which all is learned for the first time."""
    scene, frames = walk()
    dark = [replace(f, images=tuple(np.asarray(i // 2, np.uint8) for i in f.images if i is not None)) for f in frames]
    tracker = Tracker(build(scene.body, scene.rig))
    tracker.start(scene.first_pose)
    relit, unrest = list[bool](), list[float]()
    for k in range(18):
        relit.append(tracker.step(dark[k] if k >= 14 else frames[k]).relit)
        unrest.append(tracker.state.searches["lost body"].unrest.in_vain.max())
    assert relit == [k == 14 for k in range(18)]
    assert unrest[14] == 0.0  # no camera was bumped, and bumps that come are not overlooked


def test_a_first_frame_without_pictures_is_no_other_light() -> None:
    scene, frames = walk()
    tracker = Tracker(build(scene.body, scene.rig))
    tracker.start(scene.first_pose)
    assert not any(tracker.step(_gone(frames[0]) if k == 0 else frames[k]).relit for k in range(3))


def test_a_mirror_image_has_its_landmarks_mirrored() -> None:
    body = humanoid()
    q = np.random.default_rng(0).uniform(-0.4, 0.4, body.dof - 6)
    turned = Stance(np.eye(3), 1.0, q).mirrored(body)
    np.testing.assert_allclose(turned.mirrored(body).q, q)
    names = body.landmarks.names
    twin = [names.index(n.replace("_r", "_?").replace("_l", "_r").replace("_?", "_l")) for n in names]
    here, there = (Posed(body, Pose(np.eye(4), angles)).landmarks for angles in (q, turned.q))
    np.testing.assert_allclose(there[twin], here * (1.0, -1.0, 1.0), atol=1e-6)
