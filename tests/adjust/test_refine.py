"""Refining whole tracks: equations against dense ones, derivatives against differences, and a small scene."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from support.finite_differences import check_jacobian
from twistcap.body import Body, Pose, Posed, rescaled
from twistcap.body.humanoid import humanoid
from twistcap.body.kinematics import skin_points
from twistcap.body.shape import (
    hinge_middles,
    joint_distances,
    joint_origin,
    joints_moved,
    rest_motion,
    stretch_maps,
)
from twistcap.camera import Camera, Rig, look_at
from twistcap.cli import main
from twistcap.cues.brightness import Brightness
from twistcap.cues.view import View
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame
from twistcap.io.result import ResultWriter, read_result
from twistcap.predict import MotionNoise
from twistcap.refine import RefineConfig, refine
from twistcap.refine.evidence import Instant, Sight, add_brightness, followed_points, row_jacobian
from twistcap.refine.motion import add_accelerations
from twistcap.render import SurfacePoints, render
from twistcap.settings import TrackerConfig
from twistcap.solve import Arrow
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.subjects import limbering
from twistcap.track import track

Array = NDArray[np.float64]
BODY = humanoid("full")


def a_pose(seed: int) -> Pose:
    rng = np.random.default_rng(seed)
    q = rng.uniform(-0.5, 0.5, len(BODY.coordinate_names))
    return Pose.rest(BODY).retract(np.concatenate([rng.uniform(-0.3, 0.3, 6), q]))


def test_derivatives_by_the_shape() -> None:
    """Lengths, girths and joint centres, on blended surface points of a bent body."""
    rng = np.random.default_rng(0)
    pose, moved = a_pose(0), ("tibia_r", "torso", "ulna_l")
    groups = [{"femur_r": 1.0, "femur_l": 1.0}, {"pelvis": 1.0}], [{"torso": 1.0}]
    some = rng.integers(0, len(BODY.vertices), 200)
    segments, weights, local = BODY.skin_segments[some], BODY.skin_weights[some], BODY.vertices[some]
    gradient = rng.normal(size=(200, 3))

    def residual(x: Array) -> Array:
        lengths = {name: float(np.exp(v)) for v, g in zip(x[:2], groups[0], strict=True) for name in g}
        girths = {name: float(np.exp(x[2])) for name in groups[1][0]}
        there = skin_points(stretch_maps(BODY, lengths, girths), segments, weights, local)
        other = joints_moved(rescaled(BODY, lengths, girths), dict(zip(moved, x[3:].reshape(-1, 3), strict=True)))
        return np.einsum("ni,ni->n", gradient, Posed(other, pose).points(segments, weights, there))

    motion = rest_motion(BODY, *groups, [BODY.segment(name) for name in moved])
    rates = motion.rates(Posed(BODY, pose), segments, weights, local, gradient)
    check_jacobian(residual, rates, np.zeros(12), rtol=1e-5, atol=1e-5)


def test_derivatives_by_the_pose() -> None:
    rng = np.random.default_rng(2)
    some = rng.integers(0, len(BODY.vertices), 100)
    points = SurfacePoints(BODY.skin_segments[some], BODY.skin_weights[some], BODY.vertices[some])
    posed, gradient = Posed(BODY, a_pose(3)), rng.normal(size=(100, 3))
    J, _ = row_jacobian(posed, rest_motion(BODY, [], [], [1]), points, gradient)
    twin = posed.point_jacobian(points.segments, points.weights, points.local)
    np.testing.assert_allclose(J, np.einsum("ni,nid->nd", gradient, twin), atol=1e-12)


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
        return np.array([add_accelerations(Arrow(4, D, 0, 2), moved, times, noise)])

    system = Arrow(4, D, 0, 2)
    add_accelerations(system, poses, times, noise)
    check_jacobian(energy, system.pull.reshape(1, -1), np.zeros(4 * D), step=1e-5, rtol=1e-5, atol=1e-4)


def test_even_motion_has_no_acceleration() -> None:
    step = a_pose(1).minus(Pose.rest(BODY))
    poses = [Pose.rest(BODY)]
    for _ in range(3):
        poses.append(poses[-1].retract(step))
    assert add_accelerations(Arrow(4, BODY.dof, 0, 2), poses, [0.0, 1.0, 2.0, 3.0], MotionNoise()) < 1e-12


def test_brightness_is_the_slope_of_its_energy() -> None:
    """By both frames' poses and by the shape, with smooth images."""
    earlier, later, motion, energy = _two_instants()
    system = Arrow(2, BODY.dof, motion.joints.shape[0], 2)
    add_brightness(system, earlier, later, motion, Brightness(), 0.01, 1.0, 0.015)
    for t in (0, 1):
        for k in (1, 4, 6 + BODY.coordinate("knee_angle_r"), 6 + BODY.coordinate("lumbar_rotation")):
            x = np.zeros((2, BODY.dof))
            x[t, k] = 1e-3
            slope = (energy(x, BODY) - energy(-x, BODY)) / 2e-3
            assert system.pull[t, k] == pytest.approx(slope, rel=0.05, abs=0.02 * float(np.abs(system.pull[t]).max()))


def _two_instants():
    rng = np.random.default_rng(0)
    camera = Camera(
        "c", np.array([[300.0, 0, 95], [0, 300.0, 140], [0, 0, 1]]), look_at([3, 1, 0], [0, 0, 0]), (190, 280)
    )
    import cv2

    images = [cv2.GaussianBlur(rng.random((280, 190)).astype(np.float32), (0, 0), 6.0) * 4 for _ in range(2)]
    poses = [a_pose(5), a_pose(5).retract(0.02 * rng.normal(size=BODY.dof))]
    instants = list[Instant]()
    for t, (image, pose) in enumerate(zip(images, poses, strict=True)):
        view = View(camera, image, "grey")
        seen = render(Posed(BODY, pose), camera)
        instants.append(Instant(t, Posed(BODY, pose), {0: Sight(view, seen, followed_points(view, seen, 200))}))
    motion = rest_motion(BODY, [{"femur_r": 1.0}], [], [BODY.segment("tibia_r")])

    def energy(x: Array, body: Body) -> float:
        moved = [replace(i, posed=Posed(body, p.retract(s))) for i, p, s in zip(instants, poses, x, strict=True)]
        return add_brightness(Arrow(2, body.dof, 4, 2), moved[0], moved[1], motion, Brightness(), 0.01, 1.0, 0.015)

    return instants[0], instants[1], motion, energy


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
    return frames, body, list(track(frames, body, scene.rig, scene.first_pose))


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
    anew = list(track(frames, first.body, scene.rig, first.estimates[0].pose))
    assert joint_error(scene, first.body, anew) < joint_error(scene, body, estimates)
    second = refine(frames, first.body, scene.rig, anew, few, shape=first.shape)
    given, now = joint_distances(body), joint_distances(second.body)
    assert now["femur_r"] / given["femur_r"] == pytest.approx(second.lengths["femur"])  # told against the first body
    assert abs(second.lengths["femur"] / first.lengths["femur"] - 1) < 0.02


def test_a_lost_frame_is_found_between_its_neighbours(
    scene: Capture, wrong: tuple[list[Frame], Body, list[Estimate]]
) -> None:
    frames, body, estimates = wrong
    astray = estimates[5].pose.retract(0.35 * np.ones(body.dof) * (np.arange(body.dof) >= 6))
    spoilt = [*estimates[:5], replace(estimates[5], pose=astray, lost=True), *estimates[6:]]
    found = refine(frames, body, scene.rig, spoilt, RefineConfig(rounds=4, coarse_rounds=1, joint=0.0))
    assert joint_error(scene, found.body, [found.estimates[5]]) < 0.3 * joint_error(scene, body, [spoilt[5]])


def test_what_is_held_stays(scene: Capture, wrong: tuple[list[Frame], Body, list[Estimate]]) -> None:
    frames, body, estimates = wrong
    held = RefineConfig(rounds=1, length=0.0, girth=0.0, joint=0.0)
    found = refine(frames[:4], body, scene.rig, estimates[:4], held)
    np.testing.assert_allclose(found.body.vertices, body.vertices, atol=1e-12)
    assert found.lengths == {} and found.joint_shifts == {} and found.moved[0] > 0.0


def test_a_track_by_brightness_is_refined_by_brightness(
    scene: Capture, wrong: tuple[list[Frame], Body, list[Estimate]]
) -> None:
    """From true poses that are each disturbed by themselves: what binds the frames together takes that out."""
    frames, _, estimates = wrong
    rng, body = np.random.default_rng(0), scene.true_body
    noise = np.deg2rad(1.5) * (np.arange(body.dof) >= 6)
    shaken = [replace(e, pose=scene.true_poses[e.index].retract(noise * rng.normal(size=body.dof))) for e in estimates]
    config = RefineConfig(rounds=4, coarse_rounds=1, length=0.0, girth=0.0, joint=0.0)
    found = refine(frames, body, scene.rig, shaken, config, TrackerConfig(method="differential"))
    assert joint_error(scene, body, found.estimates) < 0.8 * joint_error(scene, body, shaken)
    assert "photometric" in found.estimates[-1].energies and "contour" not in found.estimates[-1].energies


def test_bad_input(scene: Capture, wrong: tuple[list[Frame], Body, list[Estimate]]) -> None:
    frames, body, estimates = wrong
    with pytest.raises(InputError, match="takes at least 3"):
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
    with pytest.raises(InputError, match="rounds and strides 1 or more"):
        RefineConfig(rounds=0)


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as done:
        main([str(a) for a in arguments])
    return int(done.value.code or 0)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk, out = tmp_path / "walk", tmp_path / "out"
    assert run("studio", walk, "--size", "192x140", "--views", "2", "--frames", "6") == 0
    assert run("track", walk / "session.toml", "--out", out, "--set", "output.overlay=false") == 0
    capsys.readouterr()
    few = ("--set", "rounds=2", "--set", "points=100")
    assert run("refine", out / "result.h5", "--frames", "1:5", "--json", *few) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["frames"] == 5 and len(told["moved_mm"]) == 2
    refined = read_result(told["result"])
    assert list(refined.indices) == [1, 2, 3, 4, 5] and "refined" in refined.config
    assert Path(told["result"]) == out / "refined" / "refined.h5" and (out / "refined" / "angles.png").is_file()
    assert run("refine", told["result"], "--out", tmp_path / "once more", *few) == 0
    capsys.readouterr()
    again = ("--again", "--out", tmp_path / "again", "--json")
    assert run("refine", out / "result.h5", "--frames", "1:5", *again, *few) == 0
    twice = json.loads(capsys.readouterr().out)
    assert twice["frames"] == 5 and twice["lengths"] != told["lengths"]  # against the same body, after more rounds
    assert run("view", told["result"], "--images", 0, "--save", tmp_path / "page.html") == 0
    assert run("export", told["result"], "--to", "mot") == 0
    assert run("evaluate", told["result"], "--reference", walk / "truth.npz", "--json") == 0


def test_the_command_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("refine", tmp_path / "none.h5") == 2
    assert "does not exist" in capsys.readouterr().err
    path = tmp_path / "result.h5"
    with ResultWriter(path, BODY, Rig((Camera("c", np.eye(3), np.eye(4), (8, 8)),)), {}) as writer:
        writer.append(Estimate(0, 0.0, a_pose(0), np.eye(BODY.dof)))
    assert run("refine", path) == 2
    assert "names no videos; give one with --session" in capsys.readouterr().err
    assert run("refine", path, "--set", "round=3") == 2
    assert "did you mean 'rounds'?" in capsys.readouterr().err
