"""Clocks: coarse offsets from signals, fine ones from a tracked body, and those of keypoints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.walks import in_a_circle
from twistcap import se3
from twistcap.adjust.clocks import Signal, coincidence, estimate_clocks, fine, keypoint_clock, sound_signal
from twistcap.adjust.clocks.fine import Clocked, ClockProblem, moments_posed
from twistcap.adjust.refine.measure import SequenceImages
from twistcap.adjust.refine.settings import RefineConfig
from twistcap.body import Posed
from twistcap.camera import Rig, look_at
from twistcap.estimate import Estimate, Frame, Keypoints
from twistcap.flow import image_between
from twistcap.settings import Settings
from twistcap.solve.blocks import PoseTrack
from twistcap.studio import Capture, StudioConfig, capture


def test_signals_are_brought_together() -> None:
    rng, times = np.random.default_rng(1), np.arange(0, 20, 0.01)
    wave = np.convolve(rng.normal(size=len(times)), np.ones(30), "same")
    true = np.array([0.0, 1.234, -2.1])
    cut = [(times >= 5 + o) & (times < 13 + o) for o in true]
    signals = [Signal(times[c] - times[c][0], wave[c] + rng.normal(size=c.sum())) for c in cut]
    found = coincidence(signals, 240, 2.0, 0.15)
    np.testing.assert_allclose(found.offsets, true, atol=0.02)
    assert found.margin.min() > 0.05


def test_a_clap_is_heard() -> None:
    rng, rate = np.random.default_rng(0), 16_000
    sounds = [0.01 * rng.normal(size=4 * rate) for _ in range(2)]
    for sound, at in zip(sounds, (1.5, 2.25), strict=True):
        sound[int(at * rate) : int(at * rate) + 800] += rng.normal(size=800)
    found = coincidence([sound_signal(s, rate) for s in sounds], 500, 1.0, 0.15)
    assert abs(found.offsets[1] + 0.75) < 0.004


@pytest.mark.parametrize("seed", range(6))
def test_claps_that_fall_between_two_samples_are_the_same_in_all_cameras(seed: int) -> None:
    rng, rate, signals = np.random.default_rng(seed), 48_000, list[Signal]()
    starts, claps = rng.permutation([0.0, 2.5, *rng.uniform(0, 2.5, 2)]), rng.uniform(2.5, 5.5, 3)
    for start in starts:
        sound = 0.01 * rng.normal(size=6 * rate)
        for k in np.rint((claps - start) * rate).astype(int):
            tail = np.exp(-np.arange(min(4800, len(sound) - k)) / (0.01 * rate))
            sound[k : k + len(tail)] += 0.8 * tail * rng.normal(size=len(tail))
        signals.append(sound_signal(np.clip(sound, -1, 1), rate))
    found = coincidence(signals, 500.0, 2.4, 0.15)
    np.testing.assert_allclose(found.offsets, starts - starts[0], atol=0.004)
    assert found.margin.min() > 0.1


def test_a_late_camera_is_found_by_the_body(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fine, "_ROUNDS", 4)
    scene = capture(StudioConfig(seed=3, frames=16))
    late = np.array([0, 2, 0, 0])  # frames: the second camera shows what is to come
    frames = [Frame(k, k / 60, tuple(scene.image(k + n, c) for c, n in enumerate(late))) for k in range(12)]
    given = [Estimate(k, k / 60, scene.true_poses[k], np.eye(scene.body.dof)) for k in range(12)]
    found = estimate_clocks(frames, scene.body, scene.rig, given, np.zeros((4, 12)), 0)
    np.testing.assert_allclose(60 * found.late, late, atol=0.26)  # of 12 frames; 0.13 is measured
    assert found.sigma[0] == 0 and np.all(found.sigma[1:] > 0)


@pytest.fixture(scope="module")
def circle() -> Capture:
    return in_a_circle()


def test_a_camera_that_is_turned_a_little_does_not_pass_for_late(circle: Capture) -> None:
    scene = circle
    frames = list(scene.frames())
    given = [Estimate(k, k / 60, pose, np.eye(scene.body.dof)) for k, pose in enumerate(scene.true_poses)]
    camera = scene.rig[2]
    turned = replace(camera, T_cam_world=se3.exp(np.deg2rad([0, 0.3, 0, 0, 0, 0])) @ camera.T_cam_world)
    rig = replace(scene.rig, cameras=(*scene.rig.cameras[:2], turned, scene.rig[3]))
    found = estimate_clocks(frames, scene.body, rig, given, np.zeros((4, 40)), 0)
    np.testing.assert_allclose(60 * found.late, 0.0, atol=0.02)  # 0.006 is measured; 0.7 if cameras cannot turn


def test_the_quadratic_of_clocks_is_that_of_their_energy(circle: Capture) -> None:
    """By central differences, of a pose, a clock and a turn."""
    scene, rng = circle, np.random.default_rng(0)
    given = [Estimate(k, k / 60, scene.true_poses[k], np.eye(scene.body.dof)) for k in range(3)]
    images = SequenceImages(scene.rig, RefineConfig(), Settings(method="direct"), scene.body)
    assert list(images.read((scene.frame(k) for k in range(3)), given)) == [1, 2, 3]
    track, lags = PoseTrack(tuple(e.pose for e in given), np.arange(3) / 60), np.full((4, 3), 0.004)
    x = Clocked(track, 0.002 * rng.normal(size=4), 0.001 * rng.normal(size=(4, 3)))
    problem = ClockProblem(scene.body, images.contours(moments_posed(scene.body, x, lags), True), lags, 0, scene.rig)  # pyright: ignore[reportArgumentType]
    arrow, D = problem.linearised(x), track.pose_dof
    gradient = np.concatenate([arrow.pull.ravel(), arrow.shared_pull])
    for k in (1, D + 4, D + 9, 3 * D + 2, 3 * D + 4, 3 * D + 12):
        step = np.zeros(3 * D + 16)
        step[k] = 1e-6
        up, down = (sum(problem.energies(problem.retract(x, s)).values()) for s in (step, -step))
        assert (up - down) / 2e-6 == pytest.approx(gradient[k], rel=1e-5)


def test_keypoints_that_are_early_are_found_in_cameras_that_are_not_in_step() -> None:
    scene = capture(StudioConfig(seed=2, frames=60))
    names = scene.body.landmarks.names
    rng, numbers = np.random.default_rng(0), np.arange(60, dtype=float)
    track, late = PoseTrack(scene.true_poses, numbers), np.array([0.0, -0.5, -0.4, -0.3])
    given = list[Keypoints]()
    for k in numbers:
        points = [Posed(scene.body, track.at(k + 1.3 + own).pose).landmarks for own in late]
        pixels = np.stack([camera.project(p)[0] for camera, p in zip(scene.rig, points, strict=True)])
        pixels += rng.normal(size=pixels.shape)
        given.append(Keypoints(names, pixels + 3.0, np.ones((4, len(names)))))  # joints of another body
    found = keypoint_clock(scene.body, scene.rig, track, given, np.repeat(late[:, None], 60, axis=1))
    assert abs(found.offset - 1.3) < 0.05 and found.sigma < 0.1


def test_landmarks_behind_a_camera_tell_nothing_of_a_clock() -> None:
    scene, numbers = capture(StudioConfig(seed=2, frames=60)), np.arange(60, dtype=float)
    names, track = scene.body.landmarks.names, PoseTrack(scene.true_poses, numbers)
    amid = replace(
        scene.rig[0], T_cam_world=look_at(scene.true_poses[30].root[:3, 3] + [0.2, 0.0, 0.0], (5.0, 0.0, 1.0))
    )
    rig, given = Rig((amid, *scene.rig[1:])), list[Keypoints]()
    for k in numbers:
        points = Posed(scene.body, track.at(k + 1.3).pose).landmarks
        pixels = np.stack([camera.project(points)[0] for camera in rig])
        given.append(Keypoints(names, pixels, np.isfinite(pixels).all(axis=2).astype(float)))
    assert not all(np.isfinite(k.pixels[0]).all() for k in given)
    assert abs(keypoint_clock(scene.body, rig, track, given, np.zeros((4, 60))).offset - 1.3) < 0.2


def test_keypoints_whose_error_changes_slowly_do_not_pass_for_late_ones() -> None:
    scene = capture(StudioConfig(seed=2, frames=60))
    names, numbers, given = scene.body.landmarks.names, np.arange(60, dtype=float), list[Keypoints]()
    track, rng = PoseTrack(scene.true_poses, numbers), np.random.default_rng(0)
    toward = rng.normal(size=(len(names), 2))
    for k in numbers:
        points = Posed(scene.body, track.at(k + 1.3).pose).landmarks
        pixels = np.stack([camera.project(points)[0] for camera in scene.rig]) + 10.0 * (k / 60) ** 2 * toward
        given.append(Keypoints(names, pixels + 0.3 * rng.normal(size=pixels.shape), np.ones((4, len(names)))))
    found = keypoint_clock(scene.body, scene.rig, track, given, np.zeros((4, 60)))
    assert abs(found.offset - 1.3) < 0.025  # 0.008 is measured; 0.05 without the autoregression


def test_an_image_between_two_is_nearer_than_either() -> None:
    scene = capture(StudioConfig(seed=1, frames=6))
    first, middle, last = (np.asarray(scene.image(k, 0)) for k in (2, 3, 4))
    made = image_between(first, last, 0.5)

    def off(image: np.ndarray) -> float:
        return float(np.abs(image.astype(float) - middle)[scene.masks(3)[0]].mean())

    assert off(made) < 0.5 * min(off(first), off(last))
