"""The studio: same seed same pixels, exact half-pixel geometry, mismatches of the promised size, options that act."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.twins import check_twin
from twistcap import se3
from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.body.shape import joint_coordinates
from twistcap.camera import Camera, look_at
from twistcap.errors import InputError
from twistcap.io.calibration import read_rig
from twistcap.io.synthetic import write_session
from twistcap.studio import Capture, StudioConfig, capture, ring
from twistcap.studio import mismatch as M
from twistcap.studio.config import stream
from twistcap.studio.look import Look, look
from twistcap.studio.motion import gait
from twistcap.studio.picture import OCTAVES, paint_rectangles, render_body, replace_pixels, solid_noise
from twistcap.studio.scene import PERSON_HEIGHT

SMALL = StudioConfig(seed=3, views=2, frames=3, size=(192, 140))


@lru_cache(maxsize=1)
def walker() -> Body:
    return humanoid()


@lru_cache(maxsize=4)
def walk(fps: float) -> list[Pose]:
    return gait(walker(), fps=fps, frames=60)


@lru_cache(maxsize=64)
def captured(config: StudioConfig) -> Capture:
    """One person and one walk for all: making them takes longer than most tests."""
    return capture(config, walker(), walk(config.fps))


def sphere(radius: float, centre: tuple[float, float, float], n: int = 160) -> Body:
    """A rigid ball as a body of one segment."""
    polar, azimuth = np.linspace(0, np.pi, n + 1), np.arange(2 * n) * np.pi / n
    p, a = np.meshgrid(polar, azimuth, indexing="ij")
    points = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], axis=-1).reshape(-1, 3)
    row, col = (i.ravel() for i in np.meshgrid(np.arange(n), np.arange(2 * n), indexing="ij"))
    a, b = row * 2 * n + col, row * 2 * n + (col + 1) % (2 * n)
    faces = np.concatenate([np.stack([a, a + 2 * n, b], 1), np.stack([b, a + 2 * n, b + 2 * n], 1)])
    V = len(points)
    return Body(
        name="ball",
        coordinate_names=(),
        parent=np.zeros(0, np.int32),
        twists=np.zeros((0, 6)),
        limits=np.zeros((0, 2)),
        segment_names=("ball",),
        segment_joint=np.array([-1], np.int32),
        vertices=radius * points + np.array(centre),
        faces=faces.astype(np.int32),
        skin_segments=np.zeros((V, 1), np.int32),
        skin_weights=np.ones((V, 1)),
    )


def test_same_seed_gives_the_same_pixels_in_any_order():
    in_turn = [frame.images for frame in capture(SMALL).frames()]
    alone = capture(SMALL).frame(2)
    assert all(np.array_equal(a, b) for a, b in zip(in_turn[2], alone.images, strict=True))
    other = captured(replace(SMALL, seed=4)).frame(2)
    assert not np.array_equal(captured(SMALL).frame(2).images[0], other.images[0])
    assert not np.array_equal(in_turn[0][0], in_turn[1][0])


def test_options_do_not_disturb_one_another():
    """Noise options leave the scene itself as it was: each purpose has its own random numbers."""
    clean = captured(replace(SMALL, sensor_noise=0.0)).frame(1).images[0]
    spoilt = captured(replace(SMALL, sensor_noise=0.0, uniform_noise=0.25)).frame(1).images[0]
    assert clean is not None and spoilt is not None
    changed = np.any(clean != spoilt, axis=-1).mean()
    assert 0.23 < changed < 0.27


def test_silhouette_of_a_sphere_lies_on_its_analytic_outline():
    """Half a pixel wrong would double a tracker's error: area and centroid agree to 0.02 px."""
    camera = Camera(
        "c", np.array([[500.0, 0, 190.2], [0, 500.0, 141.7], [0, 0, 1]]), look_at([3, 0.2, 1], [0, 0, 1]), (384, 280)
    )
    centre, radius = (0.11, -0.23, 1.07), 0.25
    layer = render_body(Posed(body := sphere(radius, centre), Pose.rest(body)), camera, plain(body))
    alpha = np.zeros((280, 384))
    h, w = layer.pixels.shape[:2]
    alpha[layer.y : layer.y + h, layer.x : layer.x + w] = layer.pixels[..., 3]
    area, middle = outline_of_sphere(camera, np.array(centre), radius)
    y, x = np.mgrid[:280, :384]
    seen = np.array([(alpha * x).sum(), (alpha * y).sum()]) / alpha.sum()
    assert np.abs(seen - middle).max() < 0.02
    assert abs(np.sqrt(alpha.sum() / np.pi) - np.sqrt(area / np.pi)) < 0.02


@pytest.mark.parametrize("away", [(0, 3), (0, -3), (3, 0), (-3, 0)])
def test_a_body_beyond_an_edge_leaves_the_picture_as_it_is(away: tuple[int, int]):
    """Also above and below, where the window has no rows."""
    K = np.array([[300.0, 0, 64], [0, 300.0, 48], [0, 0, 1]])
    camera = Camera("c", K, look_at([3, 0, 0], [0, 0, 0]), (128, 96))
    layer = render_body(Posed(body := sphere(0.2, (0.0, *away), n=20), Pose.rest(body)), camera, plain(body))
    picture = np.full((96, 128, 3), 0.25, np.float32)
    layer.over(picture)
    assert layer.pixels.size == 0
    assert (picture == 0.25).all()


def outline_of_sphere(camera: Camera, centre: np.ndarray, radius: float) -> tuple[float, np.ndarray]:
    """Area and centroid (px) of the ellipse that a sphere's tangent cone cuts out of the image."""
    c = se3.apply(camera.T_cam_world, centre[None])[0]
    cone = np.outer(c, c) - (c @ c - radius**2) * np.eye(3)  # rays d with dᵀ cone d ≥ 0 meet the sphere
    Q = np.linalg.inv(camera.K).T @ cone @ np.linalg.inv(camera.K)
    middle = -np.linalg.solve(Q[:2, :2], Q[:2, 2])
    value = Q[2, 2] + Q[:2, 2] @ middle
    return float(np.pi * abs(value) / np.sqrt(np.linalg.det(Q[:2, :2]))), middle


def plain(body: Body) -> Look:
    """White, without texture, lit the same from all sides."""
    ambient = np.array([[0.0, 0.0, 0.0, 1.0, 1.0, 1.0]])
    return Look(
        np.ones((len(body.vertices), 1)), np.ones((1, 3)), np.zeros(1), np.zeros((32**3, 3), np.float32), ambient
    )


def test_noise_kernel_agrees_with_its_readable_twin():
    points = np.random.default_rng(0).uniform(-2.0, 2.0, (500, 3))
    found = check_twin(solid_noise, look(walker(), SMALL).lattice, OCTAVES, points, atol=1e-10)
    assert found.std() > 0.1


def test_the_texture_sticks_to_the_surface():
    """A surface point keeps its texture when the body moves: without lights, a moved ball looks the same."""
    body = sphere(0.25, (0.0, 0.0, 0.0), n=40)
    dress = replace(
        plain(body), contrast=np.full(1, 0.2), lattice=look(body, SMALL).lattice, albedo=np.full((1, 3), 0.5)
    )
    camera = Camera(
        "c",
        np.array([[300.0, 0, 64], [0, 300.0, 64], [0, 0, 1]]),
        look_at([3, 0.1, 0.2], [0.003, 0.01, 0.02]),
        (129, 129),
    )
    still = render_body(Posed(body, Pose.rest(body)), camera, dress)
    shift = se3.transform(np.eye(3), [0, 0.2, 0])
    seen_moved = replace(camera, T_cam_world=camera.T_cam_world @ se3.inverse(shift))
    moved = render_body(Posed(body, Pose(shift, np.zeros(0))), seen_moved, dress)
    np.testing.assert_allclose(still.pixels, moved.pixels, atol=1e-5)
    assert still.pixels[..., 0][still.pixels[..., 3] == 1].std() > 0.03


@pytest.mark.parametrize("views", [1, 2, 4, 8])
def test_the_person_stays_in_view_at_the_promised_height(views: int):
    take = captured(StudioConfig(seed=views, views=views))
    heights = []
    for k in (0, 30, 59):
        for camera in take.true_rig:
            pixels, _ = camera.project(Posed(take.true_body, take.true_poses[k]).vertices)
            assert pixels.min() > 3 and np.all(pixels.max(axis=0) < np.array(camera.size) - 4)
            heights.append(np.ptp(pixels[:, 1]))
    assert 175 < np.mean(heights) < 205
    assert min(heights) > 140


def test_ring_angles():
    for views, wanted in ((2, 135.0), (4, 90.0), (8, 45.0)):
        a, b = (c.centre[:2] - [1, 2] for c in ring(views, 3.0, 1.2, (1, 2, 1), (384, 280)).cameras[:2])
        assert np.isclose(np.rad2deg(np.arccos(a @ b / 9.0)), wanted)
    focal = ring(1, 3.0, 1.2, (0, 0, 1), (384, 280))[0].K[0, 0]
    assert np.isclose(focal * 1.75 / 3.0, PERSON_HEIGHT * 280)


def test_exact_scenes_tell_the_tracker_the_truth():
    take = captured(SMALL)
    assert take.body is take.true_body and take.rig is take.true_rig and take.first_pose is take.true_poses[0]


def test_mismatch_of_the_surface():
    take = captured(replace(SMALL, condition="mismatch"))
    fat = M.fattened(take.true_body, M.GIRTH)
    thigh = take.true_body.segment("femur_r")
    own = (take.true_body.skin_segments[:, 0] == thigh) & (take.true_body.skin_weights[:, 0] > 0.99)
    widths = [np.ptp(b.vertices[own], axis=0)[:2].mean() for b in (take.true_body, fat)]
    assert np.isclose(widths[1] / widths[0], 1.04, atol=0.01)
    bumps = np.linalg.norm(M.bumpy(fat, M.BUMPS, stream(1, "x")).vertices - fat.vertices, axis=1)
    assert np.isclose(np.sqrt(np.mean(bumps**2)), 0.004, atol=0.0004)
    assert bumps.max() < 0.0081


def test_mismatch_of_the_joints():
    """Every joint centre is 6 mm away from where it was, and its landmark went along."""
    body = captured(SMALL).true_body
    noisy = M.with_joint_noise(body, M.JOINT_NOISE, stream(1, "x"))
    for name in ("hip_r", "knee_l", "shoulder_l", "elbow_r", "ankle_r", "wrist_l"):
        i = body.landmarks.index(name)
        shift = noisy.landmarks.points[i] - body.landmarks.points[i]
        assert np.isclose(np.linalg.norm(shift), 0.006, atol=1e-9), name
        for k in joint_coordinates(body, int(body.landmarks.segments[i])):
            at = np.cross(noisy.twists[k, :3], noisy.landmarks.points[i])
            assert np.linalg.norm(noisy.twists[k, 3:] + at) < 1e-9 + np.linalg.norm(
                body.twists[k, 3:] + np.cross(body.twists[k, :3], body.landmarks.points[i])
            ), "the axis passes the landmark as it did before"
    still = body.landmarks.index("nose")
    assert np.array_equal(noisy.landmarks.points[still], body.landmarks.points[still])


def test_mismatch_of_cameras_and_first_pose():
    take = captured(replace(SMALL, condition="mismatch"))
    for true, known in zip(take.true_rig, take.rig, strict=True):
        turn = known.T_cam_world @ se3.inverse(true.T_cam_world)
        assert np.isclose(np.rad2deg(np.linalg.norm(se3.log_rotation(turn[:3, :3]))), 0.05, atol=1e-6)
        assert np.allclose(known.centre, true.centre)
        assert np.isclose(abs(known.K[0, 0] / true.K[0, 0] - 1), 0.002)
    truth = take.true_poses[0]
    off = np.rad2deg(np.abs(take.first_pose.q - truth.q))
    assert 0.3 < off.mean() < 0.7 and off.max() <= 1.0
    turn = take.first_pose.root @ se3.inverse(truth.root)
    middle = Posed(take.true_body, truth).vertices.mean(axis=0)
    assert np.isclose(np.linalg.norm(se3.apply(turn, middle[None])[0] - middle), 0.005)
    assert np.isclose(np.rad2deg(np.linalg.norm(se3.log_rotation(turn[:3, :3]))), 1.0)


def test_masks_are_where_the_person_is():
    take = captured(replace(SMALL, sensor_noise=0.0))
    mask, image = take.masks(0)[0], take.frame(0).images[0]
    assert image is not None and mask.shape == (140, 192)
    room = np.clip(np.rint(take.rooms[0] * 255), 0, 255).astype(np.uint8)
    near = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3))) > 0
    assert np.array_equal(image[~near], room[~near])
    assert np.any(image[mask] != room[mask], axis=-1).mean() > 0.95


def test_dropped_frames():
    take = captured(replace(SMALL, dropped=((0, 1), (2, 2, 1))))
    assert [[i is None for i in f.images] for f in take.frames()] == [[True] * 2, [True] * 2, [False, True]]


def test_uniform_noise_schedule():
    config = replace(SMALL, frames=11, uniform_noise=(0.0, 1.0, 0.0))
    assert np.allclose([config.noise_fraction(k) for k in (0, 5, 10)], [0, 1, 0])
    picture = np.full((200, 200, 3), 0.5, np.float32)
    replace_pixels(picture, 0.25, stream(0, "x"))
    hit = np.any(picture != 0.5, axis=-1)
    assert abs(hit.mean() - 0.25) < 0.01
    assert abs(picture[hit].mean() - 0.5) < 0.02 and picture[hit].max() > 0.99


def test_rectangles_are_counted():
    picture = np.zeros((280, 384), np.float32)
    paint_rectangles(picture, 50, stream(0, "x"))
    assert 30 < len(np.unique(picture)) <= 51  # some lie beneath others
    assert 0.1 < (picture > 0).mean() < 0.5


def test_one_colour_and_grey():
    assert np.ptp(captured(replace(SMALL, one_colour=True)).look.albedo, axis=0).max() == 0
    assert not captured(replace(SMALL, one_colour=True)).look.contrast.any()
    image = captured(replace(SMALL, colour=False)).frame(0).images[0]
    assert image is not None and image.shape == (140, 192) and image.dtype == np.uint8


def test_hard_scenes_have_the_same_greys_before_and_behind():
    def overlap(hard: bool) -> float:
        shares = []
        for seed in range(4):
            take = captured(replace(SMALL, seed=seed, hard=hard))
            mask, image = take.masks(0)[0], take.frame(0).images[0]
            assert image is not None
            grey = image.mean(axis=-1) / 255
            shares.append(abs(grey[mask].mean() - grey[~mask].mean()) + grey[~mask].std())
        return float(np.mean(shares))

    assert overlap(hard=True) < 0.11
    assert overlap(hard=False) > 0.2


def test_motion_blur_widens_what_moves():
    sharp, blurred = (captured(replace(SMALL, fps=10.0, motion_blur=n, sensor_noise=0.0)) for n in (1, 5))
    moved = np.any(sharp.frame(1).images[0] != blurred.frame(1).images[0], axis=-1)
    assert moved.sum() > 0.5 * sharp.masks(1)[0].sum()


def test_occluders_hide_and_masks_do_not_know():
    free, hidden = (captured(replace(SMALL, occluders=n, sensor_noise=0.0)) for n in (0, 4))
    assert any(np.any(a != b) for a, b in zip(free.frame(0).images, hidden.frame(0).images, strict=True))
    assert all(np.array_equal(a, b) for a, b in zip(free.masks(0), hidden.masks(0), strict=True))


def test_speed_factor_plays_faster():
    slow, fast = (capture(replace(SMALL, frames=5, speed_factor=f)) for f in (1.0, 2.0))
    assert np.allclose(slow.true_poses[4].q, fast.true_poses[2].q)


@pytest.mark.parametrize(
    "wrong", [{"views": 9}, {"uniform_noise": 1.5}, {"dropped": ((3, 1),)}, {"condition": "nearly"}, {"fps": 0.0}]
)
def test_wrong_configurations_are_told(wrong: dict[str, object]):
    with pytest.raises(InputError, match=next(iter(wrong))):
        StudioConfig(**wrong)  # pyright: ignore[reportArgumentType]


def test_too_few_poses_are_told():
    take = captured(SMALL)
    with pytest.raises(InputError, match="2 poses"):
        capture(SMALL, take.true_body, take.true_poses[:2])


def test_written_session_holds_everything(tmp_path: Path):
    take = captured(replace(SMALL, dropped=((1, 1, 0),)))
    session = write_session(take, tmp_path / "walk")
    assert session.read_text().count("videos/") == 2
    assert sorted(p.name for p in (tmp_path / "walk" / "videos" / "cam01").iterdir()) == ["0000.png", "0002.png"]
    stored = cv2.imread(str(tmp_path / "walk" / "videos" / "cam02" / "0001.png"))[..., ::-1]
    assert np.array_equal(stored, take.frame(1).images[1])
    rig = read_rig(tmp_path / "walk" / "Calib.toml")
    assert np.allclose(rig[1].T_cam_world, take.rig[1].T_cam_world)
    with np.load(tmp_path / "walk" / "truth.npz") as truth:
        assert truth["landmarks"].shape == (3, len(truth["names"]), 3)
        assert np.allclose(truth["q"][2], take.true_poses[2].q)
    mask = cv2.imread(str(tmp_path / "walk" / "masks" / "cam01" / "frame_0001.png"), cv2.IMREAD_GRAYSCALE)
    assert np.array_equal(mask > 127, take.masks(1)[0])


def test_written_video_is_close_to_the_pixels(tmp_path: Path):
    from twistcap.io.sources import VideoSource

    take = captured(SMALL)
    write_session(take, tmp_path, masks=False)
    images = list(VideoSource(tmp_path / "videos" / "cam01.mp4").read(range(3)))
    true = take.frame(2).images[0]
    assert len(images) == 3 and images[2] is not None and true is not None
    assert np.abs(images[2].astype(float) - true).mean() < 6


def test_a_video_cannot_hold_dropped_frames(tmp_path: Path):
    with pytest.raises(InputError, match="PNG"):
        write_session(captured(replace(SMALL, dropped=((1, 1),))), tmp_path, images="video")
