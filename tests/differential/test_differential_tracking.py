"""Walks followed from brightness alone, and the support maps."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

from reproduce.plates import NINETEEN, angles_of
from reproduce.scenes.walks import Walk
from twistcap.body.simplify import simplified
from twistcap.camera import ScaledView
from twistcap.cues.background import STILL, dominant_motion, under_motion
from twistcap.differential.model import DifferentialModel
from twistcap.differential.search import limbs_of, searched
from twistcap.differential.settings import DifferentialConfig, Rule
from twistcap.differential.state import State, Track, state_of, world_pose
from twistcap.differential.step import followed, track
from twistcap.differential.support_maps import Neighbourhood, posterior, robust_scale
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.studio import StudioConfig
from twistcap.track import Tracker

WALK = Walk((-90.0, -20.0), 10.0, StudioConfig(size=(192, 140), frames=6))
FEW = Rule(levels=3, iterations=4)


@lru_cache
def scene():
    return WALK.scene(1)


@lru_cache
def images():
    return tuple(frame.images for frame in scene().frames())


def the_model():
    found, truth = scene(), scene().true_poses
    model = simplified(found.body, NINETEEN, at=truth[0].q)
    start = state_of(truth[0], found.rig)
    return model, State(start.views, angles_of(model, found.body, start.q))


def few(model) -> DifferentialModel:
    return DifferentialModel(model, rule=FEW)


def errors_deg(model, states, frames) -> np.ndarray:
    truth = angles_of(model, scene().body, np.array([scene().true_poses[k].q for k in frames]))
    return np.abs(np.degrees(np.array([s.q for s in states]) - truth))


def test_two_views_follow_a_walk() -> None:
    model, start = the_model()
    found = track(few(model), start, images())
    errors, still = (
        errors_deg(model, [e.state for e in found], range(1, 6)),
        errors_deg(model, [start] * 5, range(1, 6)),
    )
    legs = [model.coordinate(n) for n in model.coordinate_names if "knee" in n or "hip_flexion" in n]
    assert errors[:, legs].mean() < 2.0
    assert errors[-1, legs].mean() < 0.35 * still[-1, legs].mean()
    assert all(np.all(np.linalg.eigvalsh(e.covariance) > 0) for e in found)
    assert min(e.support.min() for e in found) > 0.5


def test_a_dropped_image_is_passed_over() -> None:
    model, start = the_model()
    frames = [(image[0], None) if k == 1 else image for k, image in enumerate(images())]
    found = track(few(model), start, frames)
    assert found[0].support[1] == 0.0 < found[1].support[1]
    states = [e.state for e in found]
    legs = [model.coordinate(n) for n in model.coordinate_names if "knee" in n or "hip_flexion" in n]
    assert errors_deg(model, states, range(1, 6))[:, legs].mean() < 3.0


def test_a_view_that_begins_late_takes_part_from_then_on() -> None:
    """Its turn and place are those of the start, carried along by the joints' limits alone, until it is seen."""
    model, start = the_model()
    late = Track.of(start)
    for k, image in enumerate(images()[:4]):
        late, found = followed(late, (image[0], None) if k == 0 else image, few(model))
    assert found.support[1] > 0.5
    assert np.all(np.isfinite(found.state.q))


def test_a_change_of_exposure_is_found() -> None:
    model, start = the_model()
    brighter = tuple(np.clip(1.1 * image.astype(np.float32) / 255 + 0.02, 0, 1) for image in images()[0])
    followed = replace(few(model), config=DifferentialConfig(colour=False))
    found = track(followed, start, [tuple(i.astype(np.float32) / 255 for i in images()[0]), brighter])[0]
    np.testing.assert_allclose(found.exposure[:, 0], 0.1, atol=0.03)
    assert np.degrees(np.abs(found.state.q - start.q)).max() < 1.0


@pytest.mark.parametrize("perspective", [False, True])
def test_the_model_gives_poses_in_the_world(perspective) -> None:
    found = scene()
    tracker = Tracker(DifferentialModel(found.body, DifferentialConfig(perspective=perspective), FEW, found.rig))
    tracker.start(found.true_poses[0])
    estimates = [tracker.step(Frame(k, k / 60, image)) for k, image in enumerate(images()[:3])]
    np.testing.assert_array_equal(estimates[0].pose.q, found.true_poses[0].q)
    last = estimates[-1]
    assert np.linalg.norm(last.pose.root[:3, 3] - found.true_poses[2].root[:3, 3]) < 0.03
    assert last.covariance.shape == (found.body.dof, found.body.dof)
    assert not last.lost


def test_the_world_pose_of_a_state_is_the_pose() -> None:
    pose = scene().true_poses[0]
    for perspective in (False, True):
        state = state_of(pose, scene().rig, perspective)
        assert all((view.K is not None) == perspective for view in state.views)
        np.testing.assert_allclose(world_pose(state, list(scene().rig)).root, pose.root, atol=1e-9)


def test_bad_input_is_told() -> None:
    model, start = the_model()
    with pytest.raises(InputError, match="1 images for 2 views"):
        track(few(model), start, [images()[0][:1]])
    with pytest.raises(InputError, match="angles"):
        track(few(model), State(start.views, start.q[:3]), [images()[0]])
    with pytest.raises(InputError, match="not finite"):
        track(few(model), start, [[np.full((140, 192), np.nan)] * 2])
    with pytest.raises(InputError, match="stray_deg"):
        DifferentialConfig(stray_deg=0.0)


def test_support_tells_the_body_from_what_is_still_and_from_neither() -> None:
    rows, columns = (i.ravel().astype(np.int32) for i in np.mgrid[:30, :30])
    near = Neighbourhood(rows, columns, (30, 30))
    rng = np.random.default_rng(0)
    noise, large = rng.normal(0, 0.01, (900, 1)), rng.normal(0, 0.15, (900, 1))
    which = columns // 10  # the body, what is still, neither
    residual = np.where(which[:, None] == 0, noise, large)
    behind = np.where(which[:, None] == 1, noise, large)
    w = posterior(residual, behind, np.full(900, 0.7), np.full((900, 1), 0.01), np.array([0.01]), near)
    middle = columns % 10 - 5
    for part, least, most in ((0, 0.9, 1.0), (1, 0.0, 0.1), (2, 0.0, 0.1)):
        own = w[(which == part) & (np.abs(middle) < 3)]
        assert least <= own.mean() <= most


def test_robust_scale_is_that_of_the_noise() -> None:
    rng = np.random.default_rng(0)
    r = rng.normal(0, 0.03, 4000)
    r[::4] = 0.5
    scale = robust_scale(r, np.zeros(4000, np.int32), 2, np.ones(4000))
    assert 0.03 < scale[0] < 0.045


def test_the_dominant_motion_is_that_of_the_room() -> None:
    rng = np.random.default_rng(0)
    before = cv2.GaussianBlur(rng.random((140, 192)).astype(np.float32), (0, 0), 1.5)
    true = np.array([[1.01, 0.02, 1.5], [-0.02, 1.01, -2.0]])
    after = cv2.warpAffine(before, true, (192, 140), borderMode=cv2.BORDER_REFLECT)
    body = np.zeros((140, 192), bool)
    body[50:90, 60:120] = True
    after[50:90, 60:120] = before[50:90, 60:120]
    found = dominant_motion(before, after, body)
    corners = np.array([[20.0, 20], [170, 20], [20, 120], [170, 120]])
    np.testing.assert_allclose(under_motion(corners, found), under_motion(corners, true), atol=0.3)
    assert dominant_motion(np.zeros((140, 192), np.float32), before, body) is STILL


def test_the_search_finds_a_limb_that_is_far_off() -> None:
    model, start = the_model()
    truth = start.q.copy()
    truth[model.coordinate("knee_angle_r")] += np.deg2rad(35)

    def misfit(trial: State, segments: np.ndarray) -> float:
        assert segments[model.segment("tibia_r")] or segments[model.segment("tibia_l")] or segments.any()
        return float(np.sum((trial.q - truth) ** 2))

    found = searched(model, start, misfit, np.deg2rad(30), np.deg2rad(12))
    assert len(limbs_of(model)) == 4
    assert abs(found.q - truth).max() < np.deg2rad(11)


def test_a_view_of_a_camera_beside_its_axis() -> None:
    camera = scene().rig[0]
    pose = scene().true_poses[0]
    view = ScaledView.of(camera, pose.root)
    marks = state_of(pose, [camera]).posed(scene().body).landmarks
    there = camera.project(scene().landmarks[0])[0]
    assert np.abs(view.pixels(marks) - there).max() < 2.0  # of 95 px; perspective is what is left


def test_the_light_before_each_camera_is_learnt() -> None:
    model, start = the_model()
    found = Track.of(start)
    for pair in images():
        found, _ = followed(found, pair, few(model))
    for light, memory, view, camera in zip(found.lights, found.memories, found.state.views, scene().rig, strict=True):
        assert memory is not None
        turns = view.rotation @ found.state.posed(model).segment_transforms[memory.points.part, :3, :3]
        normal = np.einsum("nij,nj->ni", turns, memory.normal)
        lamps, world = scene().look.lights, normal @ camera.T_cam_world[:3, :3]
        shaded = np.maximum(world @ lamps[:-1, :3].T, 0.0) @ lamps[:-1, 3:].mean(axis=1)
        true = np.log(shaded + lamps[-1, 3:].mean() * (0.85 + 0.15 * world[:, 2]))
        still = np.tile(np.eye(4), (len(model.segment_names), 1, 1))
        learnt = np.log(light.on(normal, np.zeros(len(normal), np.int32), still))
        assert np.std(true - learnt) < 0.85 * np.std(true)
