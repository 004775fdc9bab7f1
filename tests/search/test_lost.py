"""Looking for the whole body where it was lost: after gaps, after it left, and with a camera that contradicts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from itertools import islice, product

import cv2
import numpy as np
import pytest

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.body.limbs import limbs
from twistcap.build import build
from twistcap.camera.bump import turned_back
from twistcap.cues.view import despeckled, steadied
from twistcap.estimate import Frame, Keypoints
from twistcap.hindsight import tracked
from twistcap.predict import Moment, Prediction
from twistcap.search.contradiction import Judged
from twistcap.search.evidence import Evidence, EvidenceView
from twistcap.search.limb import LimbRule, placed
from twistcap.search.lost import LostBody
from twistcap.search.placing import Placing, PlacingRule, Stance
from twistcap.search.recollection import Recollection
from twistcap.search.stances import bundled
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Model, Tracker
from twistcap.track.step import posed_problem

FAULT = range(16, 34)
BUMP = np.deg2rad([0.9, -1.6, 0.8])


@cache
def _scene() -> tuple[Capture, list[Frame]]:
    scene = capture(StudioConfig(seed=2, views=3, frames=40, fps=30.0, size=(320, 240)))
    return scene, list(scene.frames())


@cache
def _before_the_fault() -> list[tuple[float, Tracker]]:
    """As `_tracked` gives it, of the frames that no test changes. A state never changes; see `tests/track`."""
    scene, frames = _scene()
    model, out = build(scene.body, scene.rig), list[tuple[float, Tracker]]()
    state = model.start(scene.first_pose)
    for k, frame in enumerate(frames[: FAULT[0]]):
        tracker = Tracker(model)
        tracker.state = state
        out.append((_off(tracker.step(frame).pose, k), tracker))
        state = tracker.state
    return out


def _off(pose: Pose, k: int) -> float:
    scene, _ = _scene()
    return float(np.linalg.norm(Posed(scene.body, pose).landmarks - scene.landmarks[k], axis=1).max())


def _tracked(faulty: Callable[[Frame], Frame], first: Pose | None = None) -> Iterator[tuple[float, Tracker]]:
    """The greatest error of the landmarks (m) in each frame, and the tracker after it."""
    scene, frames = _scene()
    tracker, begun = Tracker(build(scene.body, scene.rig)), [] if first else _before_the_fault()
    yield from begun
    if begun:
        tracker.state = begun[-1][1].state
    else:
        tracker.start(first or scene.first_pose)
    for k, frame in enumerate(frames[len(begun) :], len(begun)):
        yield _off(tracker.step(faulty(frame) if k in FAULT else frame).pose, k), tracker


@cache
def _while_gone(faulty: Callable[[Frame], Frame]) -> list[tuple[float, Pose]]:
    """Error and pose of each frame, for all tests that look at the same track."""
    return [(error, tracker.state.past.last) for error, tracker in _tracked(faulty)]


def _empty(frame: Frame) -> Frame:
    rooms = [np.asarray(255 * room, np.uint8) for room in _scene()[0].rooms]
    return replace(frame, images=tuple(rooms))


def _black(frame: Frame) -> Frame:
    return replace(frame, images=tuple(np.zeros_like(image) for image in frame.images))


def _gone(frame: Frame) -> Frame:
    return replace(frame, images=(None,) * len(frame.images))


@pytest.mark.parametrize("faulty", [_empty, _black, _gone])
def test_a_body_that_was_gone_is_found_where_it_is_now(faulty: Callable[[Frame], Frame]) -> None:
    scene, _ = _scene()
    walked = np.linalg.norm((scene.landmarks[FAULT[-1]] - scene.landmarks[FAULT[0]])[0])
    assert walked > 0.4  # far beyond what a contour pulls
    errors = [error for error, _ in _while_gone(faulty)]
    assert min(errors[FAULT[-1] + 1 :]) < 0.02
    assert errors[-1] < 0.02


def test_a_first_pose_beside_the_person_is_moved_there() -> None:
    pose = _scene()[0].first_pose
    beside = Pose(se3.transform(pose.root[:3, :3], pose.root[:3, 3] + (0.2, -0.22, 0.0)), pose.q)
    errors = [error for error, _ in islice(_tracked(lambda frame: frame, beside), 3)]
    assert errors[0] < 0.05
    assert errors[-1] < 0.02


def test_a_limb_of_the_first_pose_that_is_wrong_is_set_right() -> None:
    """In nearly all cases: among wrong places of a limb another one may agree as well."""
    scene, _ = _scene()
    worst = list[float]()
    for joint, degrees in product(("hip_flexion_r", "arm_flex_l", "neck"), (50.0, 60.0, 70.0)):
        q = scene.first_pose.q.copy()
        q[[name.startswith(joint) for name in scene.body.coordinate_names]] += np.deg2rad(degrees)
        errors = [error for error, _ in islice(_tracked(lambda frame: frame, Pose(scene.first_pose.root, q)), 2)]
        worst.append(max(errors))
    assert np.count_nonzero(np.array(worst) < 0.05) >= 7


def test_a_limb_is_looked_for_unasked_where_it_is_better_elsewhere() -> None:
    scene, frames = _scene()
    *_, (_, tracker) = islice(_tracked(lambda frame: frame), 12)
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
    scene, frames = _scene()
    *_, (_, tracker) = islice(_tracked(lambda frame: frame), 12)
    state, squat = tracker.state, next(s for s in bundled(scene.body) if s.height < 0.6)
    away = Pose(se3.transform(np.eye(3), np.array([2.0, 2.0, squat.height])), squat.q)
    moments = (Moment(frames[11].time, away, seen=False),)
    past = replace(state.past, moments=moments, seen_time=frames[11].time - 5.0)
    none = np.zeros((scene.body.dof, scene.body.dof))
    problem = posed_problem(state.with_past(past), frames[12], tracker.model, Prediction(away, "hold", none, none))
    known = state.searches["lost body"].known
    known = replace(known, turns=squat.turn[None], heights=np.array([squat.height]), angles=squat.q[None])
    evidence = known.evidence(problem)
    _check_found(LostBody().found(known, problem, evidence, -np.inf), 12)
    gone = Pose(se3.transform(np.eye(3), np.array([17.0, 2.0, squat.height])), squat.q)  # what was found there ran away
    run_away = replace(problem, state=state.with_past(replace(past, moments=(Moment(frames[11].time, gone),))))
    surely = Moment(frames[11].time - 5.0, away)
    _check_found(LostBody().found(known, run_away, evidence, -np.inf, surely), 12)


def _check_found(pose: Pose | None, frame: int) -> None:
    scene, _ = _scene()
    assert pose is not None
    assert np.linalg.norm(Posed(scene.body, pose).landmarks - scene.landmarks[frame], axis=1).max() < 0.06


def test_a_pose_pays_for_having_turned_faster_than_people_do() -> None:
    here, rule = _scene()[0].first_pose, LostBody()
    about = Pose(
        se3.transform(se3.exp_rotation([0.0, 0.0, np.deg2rad(150.0)]) @ here.root[:3, :3], np.zeros(3)), here.q
    )
    costs = [rule._too_fast(about, Moment(0.0, here), seconds) for seconds in (0.1, 0.3, 0.6, 0.8)]
    assert costs[0] == rule.better and 0.0 < costs[2] < costs[1] and costs[3] == 0.0
    assert rule._too_fast(here, Moment(0.0, here), 0.0) == 0.0


def test_places_count_by_the_pixels_that_a_body_covers_there() -> None:
    """As many points of a body twice as far away show it, but a quarter of the pixels."""
    scene, _ = _scene()
    views = [
        EvidenceView(i, camera, np.ones((len(scene.body.segment_names), *camera.size[::-1]), np.float32))
        for i, camera in enumerate(scene.rig)
    ]
    camera, middle = scene.rig[0], scene.first_pose.root[:3, 3]
    centre = -camera.T_cam_world[:3, :3].T @ camera.T_cam_world[:3, 3]
    placing = Placing(Evidence(scene.body, views[:1]), PlacingRule())
    points, offsets = placing.points(scene.first_pose), np.array([np.zeros(3), middle - centre])
    near, far = placing.rough(points, offsets, any_part=True)
    root, q = scene.first_pose.root, scene.first_pose.q
    drawn = [placing.evidence.of(Pose(se3.transform(root[:3, :3], middle + offset), q)) for offset in offsets]
    np.testing.assert_allclose([near / far, drawn[0] / drawn[1]], 4.0, rtol=0.15)


def test_a_body_near_a_camera_counts_no_more_than_from_half_as_far_as_it_was() -> None:
    """It fills the picture, and in noise it would outweigh all other cameras."""
    scene, _ = _scene()
    camera, pose = scene.rig[0], scene.first_pose
    maps = np.ones((len(scene.body.segment_names), *camera.size[::-1]), np.float32)
    towards = -camera.T_cam_world[2, :3] * 0.5 * (camera.T_cam_world[2] @ pose.root[:, 3])
    near = Pose(se3.transform(pose.root[:3, :3], pose.root[:3, 3] + towards), pose.q)
    far = Pose(se3.transform(pose.root[:3, :3], pose.root[:3, 3] - towards), pose.q)
    plain = Evidence(scene.body, [EvidenceView(0, camera, maps)])
    level = plain.no_nearer(far)  # three times as far away as `near`
    assert plain.of(near) > 2.0 * plain.of(pose)
    assert level.of(near) == pytest.approx(plain.of(near) * 4.0 / 9.0)
    assert [level.of(p) for p in (pose, far)] == pytest.approx([plain.of(p) for p in (pose, far)])
    pixels = [evidence.by_part(near)[1].sum() for evidence in (level, plain)]
    assert pixels[0] == pytest.approx(pixels[1] * 4.0 / 9.0)
    offsets, points = np.array([towards, np.zeros(3)]), Placing(plain, PlacingRule()).points(pose)
    rough = Placing(level, PlacingRule()).rough(points, offsets, any_part=True)
    assert rough[0] < 0.7 * Placing(plain, PlacingRule()).rough(points, offsets, any_part=True)[0]


def test_pictures_of_another_background_say_nothing_and_noisy_ones_do() -> None:
    scene, frames = _scene()
    *_, (_, tracker) = islice(_tracked(lambda frame: frame), 12)
    known, none = tracker.state.searches["lost body"].known, np.zeros((scene.body.dof,) * 2)
    first, second, third = frames[12].images
    assert first is not None
    rng = np.random.default_rng(0)
    noisy = np.where(rng.random(first.shape[:2])[..., None] < 0.6, rng.integers(0, 256, first.shape), first)
    for images, telling in (
        ((second, first, second), []),
        ((second, first, third), [2]),
        ((noisy.astype(np.uint8), second, third), [0, 1, 2]),
    ):
        frame = despeckled(replace(frames[12], images=images))
        prediction = Prediction(scene.true_poses[12], "hold", none, none)
        problem = posed_problem(tracker.state, frame, tracker.model, prediction)
        evidence = known.evidence(problem)
        assert [view.index for view in evidence.views] == telling
        assert evidence.by_part(problem.start)[0].shape == (len(telling), len(scene.body.segment_names))


def test_a_fit_that_hardly_covers_the_pictures_is_no_sign_of_another_light() -> None:
    """All that was learnt would be forgotten for a few points that agree."""
    scene, frames = _scene()
    *_, (_, tracker) = islice(_tracked(lambda frame: frame), 12)
    known, none = tracker.state.searches["lost body"].known, np.zeros((scene.body.dof,) * 2)
    prediction = Prediction(scene.true_poses[12], "hold", none, none)
    problem = posed_problem(tracker.state, frames[12], tracker.model, prediction)
    fit = problem.align(problem.start)
    check = replace(known.check(fit.posed, fit.sights, problem), fitting=0.2 * known.fitting)
    for share, relit in ((1.0, True), (0.2, False)):
        now = Judged(problem, fit, replace(check, pixels=share * check.pixels))
        assert (LostBody()._fitted_without_look(known, now) is not None) == relit


@pytest.mark.parametrize(("unknown", "frames", "sought"), [("r", 2, True), ("rl", 2, False), ("rl", 30, True)])
def test_limbs_whose_look_is_not_known_yet_are_not_looked_for(unknown: str, frames: int, sought: bool) -> None:
    """That of the other side tells it, and after a while it is not to be waited for."""
    scene, shown = _scene()
    *_, (_, tracker) = islice(_tracked(lambda frame: frame), 12)
    memory, none = tracker.state.searches["lost body"], np.zeros((scene.body.dof,) * 2)
    arms = [
        next(k for k, own in enumerate(memory.groups) if own[scene.body.segment_names.index(f"humerus_{side}")])
        for side in unknown
    ]
    bent = scene.true_poses[12].retract(np.where(limbs(scene.body)[arms[0]], 0.9, 0.0)).within(scene.body.limits)
    problem = posed_problem(tracker.state, shown[12], tracker.model, Prediction(bent, "hold", none, none))
    fit = problem.measured(bent)
    pixels = np.where(memory.groups[arms].any(axis=0), 0.0, memory.known.pixels)
    known = replace(memory.known, pixels=pixels, nats=np.where(pixels > 0.0, memory.known.nats, 0.0))
    now, lost = Judged(problem, fit, known.check(fit.posed, fit.sights, problem)), LostBody()
    lately = np.where((np.arange(len(memory.groups)) == arms[0])[:, None], 1.0, 0.0 * memory.lately)
    memory = replace(memory, known=known, frames=frames, signs=lately, lately=lately, limb_waiting=0)
    found, _, _ = lost._with_limbs(memory, now, Moment(shown[11].time, bent))
    assert (found is not now) == sought


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


def test_images_that_are_not_believed_move_nothing_and_teach_nothing() -> None:
    """In noise the images seem to show a body anywhere."""
    scene, frames = _scene()
    *_, (_, tracker) = islice(_tracked(lambda frame: frame), 14)
    away = tracker.state.past.last
    away = Pose(se3.transform(away.root[:3, :3], away.root[:3, 3] + (0.5, 0.0, 0.0)), away.q)
    none = np.zeros((scene.body.dof, scene.body.dof))
    problem = posed_problem(tracker.state, frames[14], tracker.model, Prediction(away, "motion", none, none))
    search, memory = LostBody(), tracker.state.searches["lost body"]
    fit = problem.measured(away)
    revision, _ = search.revise(memory, problem, fit)
    assert revision is not None  # the body is seen to be elsewhere
    revision, after = search.revise(memory, replace(problem, trust=0.5), fit)
    assert revision is None
    assert after.known is memory.known


def test_a_body_that_shows_little_of_itself_is_not_surely_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """What little is seen may agree anywhere, and from there the body would be looked for."""
    _, frames = _scene()
    *_, (_, tracker) = islice(_tracked(lambda frame: frame), 14)
    here, search, memory = tracker.state.past.last, LostBody(), tracker.state.searches["lost body"]
    monkeypatch.setattr(Recollection, "ratio", lambda *_: 1.0)
    none = np.zeros((6 + len(here.q),) * 2)
    for metres, sure in ((12.0, False), (0.0, True)):
        away = Pose(se3.transform(here.root[:3, :3], here.root[:3, 3] + (metres, 0.0, 0.0)), here.q)
        problem = posed_problem(tracker.state, frames[13], tracker.model, Prediction(away, "hold", none, none))
        _, after = search.revise(memory, problem, problem.measured(away))
        assert (after.surely.pose is away) == sure


def test_clutter_that_changes_at_once_does_not_make_a_body_lost() -> None:
    """What is usual is not known after three frames."""
    scene = capture(StudioConfig(seed=64, views=2, frames=6, rectangles=50, uniform_noise=0.25))
    tracker = Tracker(build(scene.body, scene.rig))
    tracker.start(scene.first_pose)
    assert "not_found" not in [tracker.step(frame).status for frame in scene.frames()]


def test_pictures_that_stay_the_same_tell_nothing_for_as_long_as_they_do() -> None:
    _, frames = _scene()
    frozen = frames[FAULT[0]].images
    statuses = [tracker.state for _, tracker in _tracked(lambda frame: replace(frame, images=frozen))]
    assert not any(state.past.moments[-1].seen for state in [statuses[k] for k in FAULT][1:])
    assert statuses[-1].past.moments[-1].seen


def test_a_body_that_is_nowhere_is_held() -> None:
    poses = [pose for _, pose in _while_gone(_empty)]
    roots = np.array([pose.root[:3, 3] for pose in poses])[FAULT]
    assert np.linalg.norm(roots[-1] - roots[-4]) < 0.03


def _turned(frame: Frame, cameras: tuple[int, ...]) -> Frame:
    """The frame as if some cameras had been turned by 2 degrees."""
    rig, images = _scene()[0].rig, list(frame.images)
    for i in cameras:
        image = images[i]
        assert image is not None
        images[i] = turned_back(image, rig[i], -BUMP)
    return replace(frame, images=tuple(images))


@pytest.mark.parametrize("cameras", [(0,), (0, 1, 2)])
def test_bumped_cameras_are_turned_back_until_they_stand_again(cameras: tuple[int, ...]) -> None:
    track = [(error, tracker.state) for error, tracker in _tracked(lambda frame: _turned(frame, cameras))]
    assert max(error for error, _ in track) < 0.04
    assert all(state.left_out == () for _, state in track)
    for k, (_, state) in enumerate(track):
        moved = [i for i in range(3) if np.any(state.bumps[i])]
        assert moved == (list(cameras) if k in FAULT else [])
        np.testing.assert_allclose(state.bumps[moved], np.tile(BUMP, (len(moved), 1)), atol=np.deg2rad(0.05))


@pytest.mark.parametrize("cameras", [(0,), (1, 2)])
def test_a_camera_that_is_bumped_while_nobody_is_in_sight(cameras: tuple[int, ...]) -> None:
    def faulty(frame: Frame) -> Frame:
        seen = _empty(frame) if frame.index < FAULT[8] else frame
        return _turned(seen, cameras) if frame.index >= FAULT[4] else seen

    track = [(error, tracker.state.bumps) for error, tracker in _tracked(faulty)]
    assert min(error for error, _ in track[FAULT[8] : FAULT[8] + 4]) < 0.02
    assert max(error for error, _ in track[FAULT[12] :]) < 0.03
    np.testing.assert_allclose(track[FAULT[12]][1][list(cameras)], np.tile(BUMP, (len(cameras), 1)), atol=0.001)


def test_a_camera_that_all_but_stands_as_it_did_is_left_in_peace() -> None:
    """Else it would be looked at, and found turned, in every frame."""
    rig, little = _scene()[0].rig, np.deg2rad([0.02, 0.03, 0.03])

    def faulty(frame: Frame) -> Frame:
        if frame.index < FAULT[4]:
            return _turned(frame, (0,))
        first = frame.images[0]
        assert first is not None
        return replace(frame, images=(turned_back(first, rig[0], -little), *frame.images[1:]))

    states = [tracker.state for _, tracker in _tracked(faulty)]
    assert np.any(states[FAULT[3]].bumps[0])
    assert not any(np.any(state.bumps) for state in states[FAULT[6] :])
    unrest = [state.searches["lost body"].unrest.restless[0] for state in states[FAULT[6] : FAULT[-1]]]
    assert np.all(np.diff(unrest) < 0.0)


def test_cameras_that_sway_are_followed() -> None:
    rig = _scene()[0].rig

    def swayed(k: int) -> Float:
        return np.outer([1.0, -1.3, 0.8], np.deg2rad([0.6, 0.9, 0.4])) * np.sin(0.4 * (k - FAULT[0]))

    def swaying(frame: Frame) -> Frame:
        turns = swayed(frame.index)
        images = [turned_back(image, c, -b) for image, c, b in zip(frame.images, rig, turns, strict=True)]
        return replace(frame, images=tuple(images))

    track = [(error, tracker.state.bumps) for error, tracker in _tracked(swaying)]
    assert max(error for error, _ in track) < 0.04
    off = [np.linalg.norm(track[k][1] - swayed(k), axis=1).max() for k in FAULT]
    assert np.rad2deg(max(off)) < 0.25 and np.rad2deg(np.median(off)) < 0.08


def test_keypoints_of_a_turned_camera_do_not_count() -> None:
    scene, frames = _scene()
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

    track = [(error, tracker.state) for error, tracker in _tracked(moved)]
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

    errors = [error for error, _ in _tracked(switched)]
    assert max(errors) < 0.04


def test_a_mirror_image_has_its_landmarks_mirrored() -> None:
    body = humanoid()
    q = np.random.default_rng(0).uniform(-0.4, 0.4, body.dof - 6)
    turned = Stance(np.eye(3), 1.0, q).mirrored(body)
    np.testing.assert_allclose(turned.mirrored(body).q, q)
    names = body.landmarks.names
    twin = [names.index(n.replace("_r", "_?").replace("_l", "_r").replace("_?", "_l")) for n in names]
    here, there = (Posed(body, Pose(np.eye(4), angles)).landmarks for angles in (q, turned.q))
    np.testing.assert_allclose(there[twin], here * (1.0, -1.0, 1.0), atol=1e-6)
