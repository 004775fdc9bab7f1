"""Where no body is: what is not to be believed of places, pictures and poses that seem to show one."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from reproduce.faults.figures import figure_of
from reproduce.faults.staged import staged
from support.faulty_walk import FAULT, tracked_walk, walk
from twistcap import se3
from twistcap.body import Pose, Posed
from twistcap.body.limbs import limbs
from twistcap.build import build
from twistcap.cues.view import despeckled
from twistcap.predict import Moment, Prediction
from twistcap.search.body import BodyRule, BodySearch
from twistcap.search.evidence import Evidence, EvidenceView
from twistcap.search.limb import LimbRule
from twistcap.search.lost import LostBody
from twistcap.search.placing import Hypothesis, Placing, PlacingRule
from twistcap.search.recollection import Judged, Recollection
from twistcap.studio import StudioConfig, capture
from twistcap.track import Tracker
from twistcap.track.step import posed_problem


def test_a_pose_pays_for_having_turned_faster_than_people_do() -> None:
    here, rule = walk()[0].first_pose, BodyRule()
    about = Pose(
        se3.transform(se3.exp_rotation([0.0, 0.0, np.deg2rad(150.0)]) @ here.root[:3, :3], np.zeros(3)), here.q
    )
    costs = [rule.too_fast(about, Moment(0.0, here), seconds) for seconds in (0.1, 0.3, 0.6, 0.8)]
    assert costs[0] == rule.better and 0.0 < costs[2] < costs[1] and costs[3] == 0.0
    assert rule.too_fast(here, Moment(0.0, here), 0.0) == 0.0


@pytest.mark.parametrize("camera", range(3))
def test_somebody_alike_who_is_nearer_to_a_camera_is_not_taken_for_the_person(camera: int) -> None:
    """He covers more pixels, and has more evidence; but the person was seen elsewhere a frame ago."""
    scene, frames = walk()
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), 12)
    here, time, none = scene.true_poses[11], frames[11].time, np.zeros((scene.body.dof, scene.body.dof))
    towards = (scene.true_rig[camera].centre - here.root[:3, 3]) * [1.0, 1.0, 0.0]
    towards /= np.linalg.norm(towards)
    twin, astray = (Pose(se3.transform(np.eye(3), m * towards) @ here.root, here.q) for m in (0.9, -0.8))
    figure = figure_of(Posed(scene.true_body, twin), scene.look)
    frame = replace(staged(scene), company=lambda _: [figure]).frame(12)
    state = tracker.state.with_past(replace(tracker.state.past, moments=(Moment(time, astray, seen=False),)))
    problem = posed_problem(state, frame, tracker.model, Prediction(astray, "hold", none, none))
    known = state.searches["lost body"].known
    seen = Moment(time, here)
    found = BodySearch(BodyRule(), LimbRule(), known, problem, known.evidence(problem), seen).found()
    assert found is not None
    assert np.linalg.norm((found.root - scene.true_poses[12].root)[:3, 3]) < 0.02


@pytest.mark.parametrize(
    ("cameras", "away_m", "believed"), [((0, 1, 2), 0.0, True), ((0, 1, 2), 6.0, False), ((0,), 0.0, True)]
)
def test_a_body_that_returns_is_believed_where_two_cameras_show_it(
    cameras: tuple[int, ...], away_m: float, believed: bool
) -> None:
    """Or the only one that has a picture. All others but the first look past it."""
    scene, frames = walk()
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), 12)
    truth, none = scene.true_poses[12], np.zeros((scene.body.dof,) * 2)
    problem = posed_problem(tracker.state, frames[12], tracker.model, Prediction(truth, "hold", none, none))
    known = tracker.state.searches["lost body"].known
    seen = Moment(frames[11].time, truth)
    search = BodySearch(BodyRule(), LimbRule(), known, problem, known.evidence(problem), seen)
    search = replace(search, evidence=replace(search.evidence, views=[search.evidence.views[i] for i in cameras]))
    assert search._witnesses == min(2, len(cameras))
    first, *others = search.evidence.views
    past = [_looking_past(view, away_m) for view in others]
    elsewhere = replace(search, evidence=replace(search.evidence, views=[first, *past]))
    elsewhere.__dict__["_witnesses"] = search._witnesses
    assert (elsewhere._ratio(Hypothesis(truth, 0.0)) > elsewhere.rule.accepted) is believed


def _looking_past(view: EvidenceView, away_m: float) -> EvidenceView:
    """The view of a camera that stands elsewhere, sideways."""
    aside = se3.transform(np.eye(3), np.array([away_m, 0.0, 0.0]))
    return replace(view, camera=replace(view.camera, T_cam_world=aside @ view.camera.T_cam_world))


@pytest.mark.parametrize(
    ("gained", "less", "believed"), [(0.3, 0.2, True), (0.7, 0.0, True), (0.5, 0.0, False), (0.74, -0.26, False)]
)
def test_a_limb_is_not_found_where_its_contour_agrees_less(gained: float, less: float, believed: bool) -> None:
    """In 6348 of the fault bench a runner's arm was put on a passer-by, 0.48 m away, by 0.74 of its usual evidence."""
    assert LimbRule().believed(gained, less) is believed


def test_places_count_by_the_pixels_that_a_body_covers_there() -> None:
    """As many points of a body twice as far away show it, but a quarter of the pixels."""
    scene, _ = walk()
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
    scene, _ = walk()
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
    scene, frames = walk()
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), 12)
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
    scene, frames = walk()
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), 12)
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
    scene, shown = walk()
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), 12)
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


def test_images_that_are_not_believed_move_nothing_and_teach_nothing() -> None:
    """In noise the images seem to show a body anywhere."""
    scene, frames = walk()
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), 14)
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
    _, frames = walk()
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), 14)
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
    _, frames = walk()
    frozen = frames[FAULT[0]].images
    statuses = [tracker.state for _, tracker in tracked_walk(lambda frame: replace(frame, images=frozen))]
    assert not any(state.past.moments[-1].seen for state in [statuses[k] for k in FAULT][1:])
    assert statuses[-1].past.moments[-1].seen


def test_draws_about_a_pose_beyond_its_limits_have_the_evidence_of_what_is_drawn() -> None:
    """Limits are soft for a fit, and hard for a draw. Each turn has draws of its own."""
    scene, frames = walk()
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), 12)
    truth, none = scene.true_poses[12], np.zeros((scene.body.dof,) * 2)
    problem = posed_problem(tracker.state, frames[12], tracker.model, Prediction(truth, "hold", none, none))
    placing = Placing(tracker.state.searches["lost body"].known.evidence(problem), PlacingRule(near=(0.4,)))
    q, knee = truth.q.copy(), scene.body.coordinate("knee_angle_r")
    q[knee] = scene.body.limits[knee, 1] + 0.1
    q[scene.body.coordinate("arm_flex_l")] += 0.8
    start = placing.hypothesis(Pose(truth.root, q))
    found = [placing.refined(start, turn) for turn in (0, 1)]
    assert found[0].pose.q.tolist() != found[1].pose.q.tolist()
    for each in found:
        assert each.nats > start.nats
        assert each.nats == pytest.approx(placing.evidence.of(each.pose), abs=1e-3)
