"""Refining whole tracks: equations against dense ones, derivatives against differences, and a small scene."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from reproduce.scenes.subjects import limbering
from support.finite_differences import check_jacobian
from twistcap.adjust.refine import RefineConfig, refine
from twistcap.adjust.refine.evidence import BrightnessPair, reshaped
from twistcap.adjust.refine.measure import CameraRound, design_effect, followed_points
from twistcap.adjust.refine.problem import RefineProblem, Standing, Track, accelerations
from twistcap.adjust.refine.refine import with_support
from twistcap.adjust.refine.shape import Shape
from twistcap.adjust.refine.sums import (
    FrameSums,
    add_products,
    derivatives,
    flat,
    projection,
    stacked,
)
from twistcap.body import Body, Pose, Posed, rescaled
from twistcap.body.humanoid import humanoid
from twistcap.body.kinematics import skin_points
from twistcap.body.shape import (
    RestMotion,
    carried,
    hinge_middles,
    joint_distances,
    joint_origin,
    joints_moved,
    rest_motion,
    stretch_maps,
)
from twistcap.build import build
from twistcap.camera import Camera, look_at
from twistcap.camera.projection import projected
from twistcap.cues.view import View
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame
from twistcap.hindsight import tracked
from twistcap.predict import MotionNoise
from twistcap.render import SurfacePoints, render
from twistcap.solve import Arrow
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.terms import PointNormalTerm
from twistcap.terms.photometric import sampled
from twistcap.track import Settings

Array = NDArray[np.float64]
BODY = humanoid("full")
CAMERA = Camera("c", np.array([[300.0, 0, 95], [0, 300.0, 140], [0, 0, 1]]), look_at([3, 1, 0], [0, 0, 0]), (190, 280))


def a_pose(seed: int) -> Pose:
    rng = np.random.default_rng(seed)
    q = rng.uniform(-0.5, 0.5, len(BODY.coordinate_names))
    return Pose.rest(BODY).retract(np.concatenate([rng.uniform(-0.3, 0.3, 6), q]))


def some_points(count: int, seed: int = 0) -> SurfacePoints:
    some = np.random.default_rng(seed).integers(0, len(BODY.vertices), count)
    return SurfacePoints(BODY.skin_segments[some], BODY.skin_weights[some], BODY.vertices[some])


def row_reference(posed: Posed, motion: RestMotion, points: SurfacePoints, gradient: Array) -> Array:
    """(N, 6 + J + K) readable twin of the rows after their projection: one way through the skeleton, one through rest.

    A joint centre that moves by d below parent p carries all below it by (R_p - R_s) d: it moves with the parent, and
    the segment turns about it. The surface itself moves in the rest pose and is skinned after.
    """
    jacobian = posed.point_jacobian(points.segments, points.weights, points.local)
    by_pose = np.einsum("ni,nid->nd", gradient, jacobian)
    R = np.einsum("nk,nkij->nij", points.weights, posed.segment_transforms[points.segments][..., :3, :3])
    moved = np.einsum("nk,nkmi->nmi", points.weights, carried(posed, motion.joints).transpose(1, 0, 2)[points.segments])
    at_rest = motion.velocities(points.local)[np.arange(len(points))[:, None], points.segments]
    by_shape = moved + np.einsum("nij,nk,nkmj->nmi", R, points.weights, at_rest)
    return np.concatenate([by_pose, np.einsum("ni,nmi->nm", gradient, by_shape)], axis=1)


def test_derivatives_by_pose_and_shape() -> None:
    """Lengths, girths and joint centres, on blended surface points of a bent body."""
    pose, moved, D = a_pose(0), ("tibia_r", "torso", "ulna_l"), BODY.dof
    groups = [{"femur_r": 1.0, "femur_l": 1.0}, {"pelvis": 1.0}], [{"torso": 1.0}]
    points, gradient = some_points(200), np.random.default_rng(1).normal(size=(200, 3))

    def residual(x: Array) -> Array:
        by_pose, x = x[:D], x[D:]
        lengths = {name: float(np.exp(v)) for v, g in zip(x[:2], groups[0], strict=True) for name in g}
        girths = {name: float(np.exp(x[2])) for name in groups[1][0]}
        there = skin_points(stretch_maps(BODY, lengths, girths), points.segments, points.weights, points.local)
        other = joints_moved(rescaled(BODY, lengths, girths), dict(zip(moved, x[3:].reshape(-1, 3), strict=True)))
        world = Posed(other, pose.retract(by_pose)).points(points.segments, points.weights, there)
        return np.einsum("ni,ni->n", gradient, world)

    motion = rest_motion(BODY, *groups, [BODY.segment(name) for name in moved])
    posed = Posed(BODY, pose)
    rows = derivatives(posed, motion, points, gradient)
    J = stacked(*rows, len(BODY.segment_names)) @ projection(posed, motion)
    check_jacobian(residual, J, np.zeros(D + 12), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(J, row_reference(posed, motion, points, gradient), atol=1e-12)


def test_sums_by_segment_are_those_of_the_rows() -> None:
    rng, motion, S = np.random.default_rng(2), rest_motion(BODY, [{"femur_r": 1.0}], [], [1]), len(BODY.segment_names)
    posed, points, weight = Posed(BODY, a_pose(3)), some_points(100), rng.uniform(0.0, 2.0, 200)
    weight[::5] = 0.0
    one, other = (derivatives(posed, motion, points, rng.normal(size=(200, 3))) for _ in range(2))
    blocks = np.zeros((S, S, 11, 11))
    add_products(*one, *other, weight, blocks)
    expected = stacked(*one, S).T @ (weight[:, None] * stacked(*other, S))
    np.testing.assert_allclose(flat(blocks), expected, atol=1e-9)
    sums, residual = FrameSums(posed, motion), rng.normal(size=200)
    sums.add(one, weight, residual)
    gradient, matrix = sums.projected()
    J = stacked(*one, S) @ projection(posed, motion)
    np.testing.assert_allclose(gradient, J.T @ (weight * residual), atol=1e-9)
    np.testing.assert_allclose(matrix, J.T @ (weight[:, None] * J), atol=1e-9)


def test_joints_move_and_their_marks_with_them() -> None:
    shift = np.array([0.01, -0.02, 0.005])
    other = joints_moved(BODY, {"tibia_r": shift})
    s, mark = BODY.segment("tibia_r"), BODY.landmarks.index("knee_r")
    np.testing.assert_allclose(joint_origin(other, s) - joint_origin(BODY, s), shift, atol=1e-12)
    moved = other.landmarks.points - BODY.landmarks.points
    np.testing.assert_allclose(moved[mark], shift)
    assert not np.delete(moved, mark, axis=0).any() and other.vertices is BODY.vertices
    bent = Pose(np.eye(4), np.where(np.array(BODY.coordinate_names) == "knee_angle_r", 1.0, 0.0))
    knee = Posed(other, bent).landmarks[mark]
    np.testing.assert_allclose(knee, other.landmarks.points[mark], atol=1e-12)  # what a joint turns about stays
    with pytest.raises(InputError, match="no segment 'pelvis' with a joint"):
        joints_moved(BODY, {"pelvis": shift})


def test_the_middle_of_a_hinge_is_found_again() -> None:
    off = hinge_middles(joints_moved(BODY, {"tibia_r": np.array([0.004, 0.012, 0.0])}))
    assert set(off) == {"tibia_r", "tibia_l", "ulna_r", "ulna_l"}  # the forearm's twist lies along it
    axis, middle = off["tibia_r"]
    np.testing.assert_allclose(axis * middle, [0.0, -0.012, 0.0], atol=5e-4)
    assert abs(off["tibia_l"][1]) < 1e-4


def test_distances_between_joints() -> None:
    longer = joint_distances(rescaled(BODY, {"femur_r": 1.1}))
    assert longer["femur_r"] == pytest.approx(1.1 * joint_distances(BODY)["femur_r"])
    assert longer["femur_l"] == pytest.approx(joint_distances(BODY)["femur_l"]) and "pelvis" not in longer


@pytest.mark.parametrize("turning", [True, False])
def test_accelerations_are_the_slope_of_their_energy(turning: bool) -> None:
    """Turns without shifts and the other way round: the place about which turns count is held in each step."""
    free, times = np.ones(BODY.dof), [0.0, 0.1, 0.25, 0.3]
    free[slice(3, 6) if turning else slice(0, 3)] = 0.0
    rest, D = Pose.rest(BODY), BODY.dof
    poses = [rest.retract(free * a_pose(k).minus(rest)) for k in range(4)]
    noise = MotionNoise(shift=1e6) if turning else MotionNoise()

    def energy(x: Array) -> Array:
        moved = [p.retract(step) for p, step in zip(poses, x.reshape(4, D), strict=True)]
        return np.array([accelerations(moved, times, noise)])

    system = Arrow(4, D, 0, 2)
    assert accelerations(poses, times, noise, system) == pytest.approx(energy(np.zeros(4 * D))[0])
    check_jacobian(energy, system.pull.reshape(1, -1), np.zeros(4 * D), step=1e-5, rtol=1e-5, atol=1e-4)


def test_even_motion_has_no_acceleration() -> None:
    step = a_pose(1).minus(Pose.rest(BODY))
    poses = [Pose.rest(BODY)]
    for _ in range(3):
        poses.append(poses[-1].retract(step))
    assert accelerations(poses, [0.0, 1.0, 2.0, 3.0], MotionNoise()) < 1e-12


def test_brightness_is_what_the_images_show() -> None:
    """Value and slope of its energy by both poses against the images themselves, which are smooth."""
    pair, poses, views = _a_pair()

    def difference(x: Array) -> Array:
        at = [Posed(BODY, p.retract(s)) for p, s in zip(poses, x, strict=True)]
        a, b = (sampled(v.grey, projected(v.camera, pair.points.at(p))[0])[0] for v, p in zip(views, at, strict=True))
        return b - a

    at = [Posed(BODY, p) for p in poses]
    _, one, other, _, residual = pair.rows(*at, rest_motion(BODY, [], [], []))
    np.testing.assert_allclose(residual, difference(np.zeros((2, BODY.dof))), atol=1e-6)
    for t, rows in enumerate((one, other)):
        J = stacked(*rows, len(BODY.segment_names)) @ projection(at[t], rest_motion(BODY, [], [], []))
        for k in (1, 4, 6 + BODY.coordinate("knee_angle_r"), 6 + BODY.coordinate("lumbar_rotation")):
            x = np.zeros((2, BODY.dof))
            x[t, k] = 1e-3
            slope = (difference(x) - difference(-x)) / 2e-3
            assert np.median(np.abs(J[:, k] - slope)) < 0.02 * np.abs(slope).max()


def _a_pair() -> tuple[BrightnessPair, list[Pose], list[View]]:
    rng = np.random.default_rng(0)
    images = [cv2.GaussianBlur(rng.random((280, 190)).astype(np.float32), (0, 0), 6.0) * 4 for _ in range(2)]
    poses = [a_pose(5), a_pose(5).retract(0.02 * rng.normal(size=BODY.dof))]
    views = [View(CAMERA, image, "grey") for image in images]
    earlier, later = ((v, render(Posed(BODY, p), CAMERA)) for v, p in zip(views, poses, strict=True))
    points = followed_points(*earlier, 200)
    return BrightnessPair.of((0, 2), points, earlier, later, 0.0, (1.0, 0.03, 0.012)), poses, views


def test_the_problem_is_the_slope_of_its_energy() -> None:
    """All terms together, by the poses of three frames and the shape."""
    pair, poses, _ = _a_pair()
    config = RefineConfig()
    shape = Shape.of(BODY, {"femur": ("femur_r", "femur_l"), "torso": ("torso",)}, config)
    track = Track((poses[0], a_pose(5), poses[1]), shape.stepped(np.full(len(shape.sigma), 0.003)))
    rng, points = np.random.default_rng(4), some_points(60)
    term = PointNormalTerm(
        CAMERA.P, points, CAMERA.project(points.at(Posed(BODY, poses[0])))[0] + rng.normal(size=(60, 2)),
        np.tile([0.6, 0.8], (60, 1)), rng.uniform(0.5, 1.0, 60),
    )  # fmt: skip
    tallies = [(np.zeros(1), np.zeros(1))] * 3
    look = CameraRound([term, None, term], [pair], tallies, None)  # pyright: ignore[reportArgumentType]
    standing = Standing([0.0, 0.1, 0.2], 0.0, 3.0, 0.7, MotionNoise(shift=1e6))
    problem = RefineProblem(track, [look], standing)
    arrow = problem.linearised(track)
    assert arrow.value == pytest.approx(sum(problem.energies(track).values()))
    gradient = np.concatenate([arrow.pull.ravel(), arrow.shared_pull])

    def energy(x: Array) -> float:
        return sum(problem.energies(problem.retract(track, x)).values())

    tried = [4, 6 + 3, BODY.dof + 12, 2 * BODY.dof + 5, *(3 * BODY.dof + np.array([0, 1, 2, 5, 12, 20]))]
    for k in tried:
        step = 1e-5 * np.eye(len(gradient))[k]
        slope = (energy(step) - energy(-step)) / 2e-5
        assert gradient[k] == pytest.approx(slope, rel=1e-3, abs=1e-6 * np.abs(gradient).max()), k
    assert reshaped(pair, None) is pair


@pytest.fixture(scope="module")
def scene() -> Capture:
    config = StudioConfig(seed=0, views=3, frames=12, fps=15.0, size=(288, 210))
    body = humanoid("full")
    return capture(config, body, limbering(body, 90)[::2])


@pytest.fixture(scope="module")
def wrong(scene: Capture) -> tuple[list[Frame], Body, list[Estimate]]:
    """A track with thighs and upper arms 6 % too long."""
    body = rescaled(scene.true_body, dict.fromkeys(("femur_r", "femur_l", "humerus_r", "humerus_l"), 1.06))
    frames = list(scene.frames())
    return frames, body, list(tracked(frames, build(body, scene.rig), scene.first_pose))


def joint_error(scene: Capture, body: Body, estimates: list[Estimate] | tuple[Estimate, ...]) -> float:
    """Median over landmarks and frames, m: a foot that tracking left behind for some frames stays behind."""
    found = np.stack([Posed(body, e.pose).landmarks for e in estimates])
    return float(np.median(np.linalg.norm(found - scene.landmarks[[e.index for e in estimates]], axis=2)))


def test_lengths_and_poses_are_put_right(scene: Capture, wrong: tuple[list[Frame], Body, list[Estimate]]) -> None:
    frames, body, estimates = wrong
    found = refine(frames, body, scene.rig, estimates, RefineConfig(rounds=6, coarse_rounds=1, joint=0.0))
    true, given, now = (joint_distances(b) for b in (scene.true_body, body, found.body))
    for bone in ("femur_r", "femur_l", "humerus_r", "humerus_l"):
        assert abs(now[bone] / true[bone] - 1) < 0.5 * abs(given[bone] / true[bone] - 1)
    before, after = joint_error(scene, body, estimates), joint_error(scene, found.body, found.estimates)
    assert after < 0.4 * before
    assert found.lengths["femur"] < 0.97 and 0.0 < found.length_sigmas["femur"] < 0.04
    assert not any(e.lost for e in found.estimates) and found.moved[-1] < found.moved[0]
    assert all(np.linalg.eigvalsh(e.covariance)[0] > 0 for e in found.estimates)


def test_another_track_goes_on_from_the_shape_found(
    scene: Capture, wrong: tuple[list[Frame], Body, list[Estimate]]
) -> None:
    frames, body, estimates = wrong
    few = RefineConfig(rounds=2, coarse_rounds=1, joint=0.0)
    first = refine(frames, body, scene.rig, estimates, few)
    anew = list(tracked(frames, build(first.body, scene.rig), first.estimates[0].pose))
    assert joint_error(scene, first.body, anew) < joint_error(scene, body, estimates)
    second = refine(frames, first.body, scene.rig, anew, few, shape=first.shape)
    given, now = joint_distances(body), joint_distances(second.body)
    assert now["femur_r"] / given["femur_r"] == pytest.approx(second.lengths["femur"])  # against the first body
    assert abs(second.lengths["femur"] / first.lengths["femur"] - 1) < 0.02


def test_a_lost_frame_is_found_between_its_neighbours(
    scene: Capture, wrong: tuple[list[Frame], Body, list[Estimate]]
) -> None:
    frames, body, estimates = wrong
    astray = estimates[5].pose.retract(0.35 * np.ones(body.dof) * (np.arange(body.dof) >= 6))
    spoilt = [*estimates[:5], replace(estimates[5], pose=astray, lost=True), *estimates[6:]]
    found = refine(frames, body, scene.rig, spoilt, RefineConfig(rounds=4, coarse_rounds=1, joint=0.0))
    assert joint_error(scene, found.body, [found.estimates[5]]) < 0.3 * joint_error(scene, body, [spoilt[5]])
    assert not found.estimates[5].lost and found.estimates[5].probability < 0.5


@pytest.mark.parametrize(
    ("was_lost", "support", "is_lost"),
    [(True, 0.3, True), (True, 0.45, True), (True, 0.9, False), (False, 0.45, False), (False, 0.3, True)],
)
def test_what_the_tracker_lost_stays_lost_unless_the_contours_agree_well(
    was_lost: bool, support: float, is_lost: bool
) -> None:
    parts, covariance = np.full(len(BODY.segment_names), 0.9), 1e-5 * np.eye(BODY.dof)
    given = Estimate(0, 0.0, a_pose(1), covariance, lost=was_lost, probability=0.9, part_probability=parts)
    of_part = np.where(np.arange(len(parts)) == 3, support, 1.0)
    judged = with_support(given, Posed(BODY, given.pose), of_part)
    assert (judged.lost, judged.support) == (is_lost, support)
    assert (judged.probability == 0.9) == (is_lost or not was_lost)  # only what was found again is judged anew
    assert judged.part_probability is not None and (judged.part_probability.max() < 0.75) == (was_lost and not is_lost)


def test_what_one_camera_alone_showed_stays_lost() -> None:
    """Its contours agree with a limb that is bent the wrong way in depth."""
    parts, covariance = np.full(len(BODY.segment_names), 0.9), 1e-5 * np.eye(BODY.dof)
    given = Estimate(0, 0.0, a_pose(1), covariance, lost=True, probability=0.9, part_probability=parts)
    for brightness, lost in (([0.4, np.nan, np.nan], True), ([0.4, np.nan, 0.4], False)):
        seen = replace(given, brightness=np.array(brightness))
        assert with_support(seen, Posed(BODY, given.pose), np.ones(len(parts))).lost == lost
    left_out = replace(given, brightness=np.array([0.4, 0.4, np.nan]), left_out=(1,))
    assert with_support(left_out, Posed(BODY, given.pose), np.ones(len(parts))).lost


def test_points_that_err_alike_count_as_fewer() -> None:
    """Contours off by their noise in 20 frames, and with an error of each part that stays the same in all of them."""
    rng, posed, points = np.random.default_rng(0), [Posed(BODY, a_pose(1))] * 20, some_points(300)
    pixels, normal = CAMERA.project(points.at(posed[0]))[0], np.tile([0.6, 0.8], (300, 1))

    def contours(same: float) -> list[CameraRound]:
        common = rng.normal(0.0, same, len(BODY.segment_names))[points.part]
        off = [0.5 * rng.normal(size=300) + common for _ in posed]
        terms = [
            PointNormalTerm(CAMERA.P, points, pixels + o[:, None] * normal, normal, np.full(300, 4.0)) for o in off
        ]
        return [CameraRound(terms, [], [], None)]  # pyright: ignore[reportArgumentType]

    assert design_effect(contours(0.0), posed, 1.0) == pytest.approx(1.0, abs=0.5)
    assert design_effect(contours(0.5), posed, 1.0) > 50.0
    assert (
        Shape.of(BODY, {"femur": ("femur_r", "femur_l")}, RefineConfig()).girths_alone().motion().joints.shape[0] == 1
    )


def test_a_track_that_cannot_be_bettered_is_kept(scene: Capture) -> None:
    frames, body = list(scene.frames()), scene.true_body
    exact = [Estimate(f.index, f.time, scene.true_poses[f.index], np.eye(body.dof)) for f in frames]
    shaken = RefineConfig(rounds=1, coarse_rounds=1, contour=0.0, brightness=0.0)
    found = refine(
        frames, body, scene.rig, exact, shaken
    )  # images that count for nothing: motion alone, to a standstill
    assert not found.helped and found.body is body
    assert all(a is b for a, b in zip(found.estimates, exact, strict=True))


def test_what_is_held_stays(scene: Capture, wrong: tuple[list[Frame], Body, list[Estimate]]) -> None:
    frames, body, estimates = wrong
    held = RefineConfig(rounds=1, length=0.0, girth=0.0, joint=0.0)
    found = refine(frames[:4], body, scene.rig, estimates[:4], held)
    np.testing.assert_allclose(found.body.vertices, body.vertices, atol=1e-12)
    assert found.lengths == {} and found.joint_shifts == {} and found.moved[0] > 0.0


def test_where_contours_err_together_only_poses_and_girths_are_refined(
    scene: Capture, wrong: tuple[list[Frame], Body, list[Estimate]], monkeypatch: pytest.MonkeyPatch
) -> None:
    frames, body, estimates = wrong
    monkeypatch.setattr(import_module("twistcap.adjust.refine.refine"), "_ALIKE", 0.0)
    found = refine(frames[:4], body, scene.rig, estimates[:4], RefineConfig(rounds=2, coarse_rounds=1))
    assert found.lengths == {} and found.joint_shifts == {} and len(found.girths) > 5
    assert max(abs(factor - 1.0) for factor in found.girths.values()) > 1e-4
    before, after = joint_distances(body), joint_distances(found.body)
    thighs = [(before[name], after[name]) for name in ("femur_r", "femur_l")]
    np.testing.assert_allclose(*np.transpose(thighs), atol=1e-9)


def test_a_track_by_brightness_is_refined_by_brightness(
    scene: Capture, wrong: tuple[list[Frame], Body, list[Estimate]]
) -> None:
    """From true poses that are each disturbed by themselves: what binds the frames together takes that out."""
    frames, _, estimates = wrong
    rng, body = np.random.default_rng(0), scene.true_body
    noise = np.deg2rad(1.5) * (np.arange(body.dof) >= 6)
    shaken = [replace(e, pose=scene.true_poses[e.index].retract(noise * rng.normal(size=body.dof))) for e in estimates]
    config = RefineConfig(rounds=4, coarse_rounds=1, length=0.0, girth=0.0, joint=0.0)
    found = refine(frames, body, scene.rig, shaken, config, Settings(method="differential"))
    assert joint_error(scene, body, found.estimates) < 0.8 * joint_error(scene, body, shaken)
    assert "photometric" in found.estimates[-1].energies and "contour" not in found.estimates[-1].energies


def test_bad_input(scene: Capture, wrong: tuple[list[Frame], Body, list[Estimate]]) -> None:
    frames, body, estimates = wrong
    with pytest.raises(InputError, match="give at least 3"):
        refine(frames[:2], body, scene.rig, estimates[:2])
    with pytest.raises(InputError, match="not those of the estimates"):
        refine(frames[:4], body, scene.rig, estimates[:5])
    with pytest.raises(InputError, match="not those of the estimates"):
        refine(frames[:5], body, scene.rig, estimates[:4])
    with pytest.raises(InputError, match="not those of the estimates"):
        refine(frames[1:5], body, scene.rig, estimates[:4])
    bad = replace(estimates[1], pose=Pose(estimates[1].pose.root, np.full_like(estimates[1].pose.q, np.nan)))
    with pytest.raises(InputError, match="pose of frame 1 is not finite"):
        refine(frames[:3], body, scene.rig, [estimates[0], bad, estimates[2]])
    with pytest.raises(InputError, match="strides are"):
        RefineConfig(strides=())
    for value in (np.nan, np.inf, -0.1):
        with pytest.raises(InputError, match="finite number"):
            RefineConfig(joint=value)
    with pytest.raises(InputError, match="rounds is 0; it must be a whole number"):
        RefineConfig(rounds=0)
