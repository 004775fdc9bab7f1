"""First pose: readers of keypoints, the scalable skeleton, the robust fit and the refinement on silhouettes."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.finite_differences import check_jacobian
from twistcap import se3
from twistcap.adjust.first_pose import (
    FirstPose,
    Skeleton,
    fit_keypoints,
    fit_keypoints_sequence,
    girth_groups,
    pose_at,
    refine_on_silhouettes,
)
from twistcap.adjust.first_pose.keypoints import COORDINATE, KeypointProblem, evidence, truncated
from twistcap.adjust.first_pose.outline import Girths, OutlineTerm, outline_of
from twistcap.adjust.first_pose.triangulate import rigid_fit, triangulate
from twistcap.body import Body, Pose
from twistcap.body.humanoid import humanoid
from twistcap.body.kinematics import Posed
from twistcap.body.shape import rescaled
from twistcap.camera import Camera, Rectifier, Rig, look_at
from twistcap.errors import InputError
from twistcap.estimate import Keypoints
from twistcap.io.keypoints import LAYOUTS, openpose_files, read_clicks, read_openpose
from twistcap.io.session_tables import Grid
from twistcap.region.compare import iou
from twistcap.render import render, visible_contour
from twistcap.solve import BlockProblem, PoseTrack, Variables

POSES = {
    "t": {"arm_add": -85},
    "crouch": {"hip_flexion": 95, "knee_angle": 110, "ankle_angle": 25, "lumbar_extension": -30, "elbow_flex": 50},
    "overhead": {"arm_add_r": -150, "arm_flex_l": 150, "elbow_flex_r": 40},
    "balance": {"lumbar_bending": 25, "hip_flexion_r": 20, "hip_adduction_r": -45, "arm_add": -80, "elbow_flex": 20},
}
JOINTS = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")


@pytest.fixture(scope="module")
def body() -> Body:
    return humanoid("full")


def ring(views: int) -> Rig:
    """Views around the origin, 384×280, a person about 190 px tall."""
    K = np.array([[434.0, 0, 191.5], [0, 434.0, 139.5], [0, 0, 1]])
    angles = np.deg2rad({4: [20, 110, 200, 290], 2: [20, 155], 1: [20]}[views])
    eyes = [(4 * np.cos(a), 4 * np.sin(a), 1.4) for a in angles]
    return Rig(tuple(Camera(f"c{i}", K, look_at(e, (0, 0, 0.9)), (384, 280)) for i, e in enumerate(eyes)))


def stem(name: str) -> str:
    return name.removesuffix("_r").removesuffix("_l")


def posed_like(body: Body, name: str, rng: np.random.Generator) -> Pose:
    wanted = POSES[name]
    q = np.deg2rad([wanted.get(n, wanted.get(stem(n), 0.0)) for n in body.coordinate_names])
    lower, upper = body.limits.T
    q = np.clip(q + np.deg2rad(10) * rng.standard_normal(len(q)), lower + 0.02, upper - 0.02)
    root = se3.exp(np.r_[0, 0, rng.uniform(-np.pi, np.pi), 0, 0, 0])
    height = Posed(body, Pose(root, q)).landmarks[:, 2].mean()
    root[:3, 3] = [*rng.normal(0, 0.1, 2), 0.95 - height]
    return Pose(root, q)


def seen(rig: Rig, points: np.ndarray, names: tuple[str, ...], noise: float, rng: np.random.Generator) -> Keypoints:
    pixels = np.stack([camera.project(points)[0] for camera in rig])
    return Keypoints(names, pixels + noise * rng.standard_normal(pixels.shape), np.ones(pixels.shape[:2]))


def another(body: Body, rng: np.random.Generator, by: float) -> Body:
    factor = {s: 1 + rng.choice([-by, by]) for s in sorted({stem(n) for n in body.segment_names})}
    return rescaled(body, {n: factor[stem(n)] for n in body.segment_names})


def joint_errors(fit: FirstPose, truth: Posed) -> np.ndarray:
    names = fit.body.landmarks.names
    which = [i for i, n in enumerate(names) if stem(n) in JOINTS]
    return 1000 * np.linalg.norm(Posed(fit.body, fit.pose).landmarks - truth.landmarks, axis=1)[which]


# ---------------------------------------------------------------- skeleton and problem


def test_skeleton_is_the_rescaled_body(body: Body) -> None:
    skeleton, rng = Skeleton(body), np.random.default_rng(0)
    f = 0.1 * rng.standard_normal(skeleton.size)
    p = skeleton.proportions(f)
    full, bare = rescaled(body, p.lengths, p.girths, p.stature), skeleton.scaled(f)
    pose = posed_like(body, "crouch", rng)
    np.testing.assert_allclose(Posed(bare, pose).landmarks, Posed(full, pose).landmarks, atol=1e-9)
    assert p.lengths["femur_r"] == p.lengths["femur_l"]


def test_skeleton_jacobian(body: Body) -> None:
    skeleton, rng = Skeleton(body), np.random.default_rng(1)
    f, pose, h = 0.1 * rng.standard_normal(skeleton.size), posed_like(body, "t", rng), 1e-6
    J = skeleton.jacobian(Posed(skeleton.scaled(f), pose), f)
    for k, step in enumerate(h * np.eye(skeleton.size)):
        after, before = (Posed(skeleton.scaled(f + s), pose).landmarks for s in (step, -step))
        np.testing.assert_allclose(J[:, :, k], (after - before) / (2 * h), atol=1e-7)


def test_gradient_of_the_problem(body: Body) -> None:
    rng, rig = np.random.default_rng(2), ring(2)
    pose = posed_like(body, "balance", rng)
    keypoints = seen(rig, Posed(body, pose).landmarks, body.landmarks.names, 3.0, rng)
    skeleton = Skeleton(body)
    frame = evidence(body, rig, keypoints)
    problem = KeypointProblem(skeleton, (frame,), 1e6, True)
    x = problem.start([Pose(pose.root, pose.q + 0.05 * rng.standard_normal(len(pose.q)))], np.full(skeleton.size, 0.02))
    g = problem.problem.dense(x).gradient
    for k, step in enumerate(1e-6 * np.eye(len(g))):
        slope = (problem.energy(x.retract(step)) - problem.energy(x.retract(-step))) / 2e-6
        assert slope == pytest.approx(g[k], rel=1e-4, abs=1e-2)


def test_triangulation_outvotes_a_gross_error() -> None:
    rng, rig = np.random.default_rng(3), ring(4)
    points = rng.uniform(-0.5, 0.5, (6, 3)) + np.array([0, 0, 0.9])
    keypoints = seen(rig, points, tuple("abcdef"), 0.0, rng)
    keypoints.pixels[1, 2] += 40
    found, inliers = triangulate(rig, keypoints.pixels, keypoints.confidence, np.full((4, 6), 2.0))
    np.testing.assert_allclose(found, points, atol=1e-6)
    assert not inliers[1, 2]
    assert inliers.sum() == 23


def test_rigid_fit_does_not_mirror() -> None:
    rng = np.random.default_rng(4)
    flat, motion = rng.standard_normal((5, 3)) * [1, 1, 0], se3.exp(rng.standard_normal(6))
    np.testing.assert_allclose(rigid_fit(flat, se3.apply(motion, flat), np.ones(5)), motion, atol=1e-9)


# ---------------------------------------------------------------- the fit


@pytest.mark.parametrize("name", POSES)
def test_strange_poses_other_lengths_4_views(body: Body, name: str) -> None:
    rng, rig = np.random.default_rng(5), ring(4)
    true = another(body, rng, 0.08)
    truth = Posed(true, posed_like(true, name, rng))
    fit = fit_keypoints(body, rig, seen(rig, truth.landmarks, body.landmarks.names, 3.0, rng))
    assert joint_errors(fit, truth).mean() < 32
    assert np.all(fit.pose.q >= body.limits[:, 0]) and np.all(fit.pose.q <= body.limits[:, 1])


def test_without_noise_lengths_and_pose_come_back(body: Body) -> None:
    rng, rig = np.random.default_rng(6), ring(2)
    true = another(body, rng, 0.08)
    truth = Posed(true, posed_like(true, "balance", rng))
    keypoints = seen(rig, truth.landmarks, body.landmarks.names, 0.0, rng)
    fit = fit_keypoints(body, rig, keypoints, sigma_px=0.05)
    assert joint_errors(fit, truth).max() < 3
    assert np.nanmax(fit.residual_px) < 0.5


def test_outliers_are_named(body: Body) -> None:
    rng, rig = np.random.default_rng(7), ring(4)
    truth = Posed(body, posed_like(body, "balance", rng))
    keypoints = seen(rig, truth.landmarks, body.landmarks.names, 2.0, rng)
    names = list(keypoints.names)
    a, b, c = names.index("ankle_l"), names.index("ankle_r"), names.index("elbow_l")
    keypoints.pixels[0, [a, b]] = keypoints.pixels[0, [b, a]]
    keypoints.pixels[2, c] += 60
    fit = fit_keypoints(body, rig, keypoints, fit_lengths=False)
    assert joint_errors(fit, truth).mean() < 30
    assert {("c0", "ankle_l"), ("c0", "ankle_r"), ("c2", "elbow_l")} <= set(fit.rejected)


def test_several_instants_share_their_lengths_and_say_more(body: Body) -> None:
    rng, rig = np.random.default_rng(8), ring(4)
    true = another(body, rng, 0.08)
    poses = [posed_like(true, name, rng) for name in ("t", "balance", "crouch")]
    keypoints = [seen(rig, Posed(true, p).landmarks, body.landmarks.names, 3.0, rng) for p in poses]
    fits = fit_keypoints_sequence(body, rig, keypoints)
    assert all(f.body is fits[0].body for f in fits)
    for f, p in zip(fits, poses, strict=True):
        assert joint_errors(f, Posed(true, p)).mean() < 28


def test_what_nobody_saw_stays_neutral_and_single_views_do_no_harm(body: Body) -> None:
    rng, rig = np.random.default_rng(9), ring(4)
    truth = Posed(body, posed_like(body, "t", rng))
    keypoints = seen(rig, truth.landmarks, body.landmarks.names, 1.0, rng)
    hand = [i for i, n in enumerate(keypoints.names) if n in ("elbow_r", "wrist_r")]
    keypoints.pixels[:, hand], keypoints.confidence[:, hand] = np.nan, 0.0
    fit = fit_keypoints(body, rig, keypoints)
    elbow = body.coordinate("elbow_flex_r")
    neutral, sigma = truncated(body.limits, COORDINATE)
    assert abs(fit.pose.q[elbow] - neutral[elbow]) < 0.1
    assert np.sqrt(fit.covariance[6 + elbow, 6 + elbow]) == pytest.approx(sigma[elbow], rel=0.2)


def test_a_hinge_is_expected_a_little_bent_and_a_ball_joint_straight() -> None:
    """Against draws of a normal distribution of which those outside the limits are thrown away."""
    limits = np.array([[0.0, 2.4], [-1.5, 1.5], [-0.2, 0.3], [0.4, 1.0]])
    draws = 0.5 * np.random.default_rng(0).standard_normal(400_000)
    for mean, sigma, (lower, upper) in zip(*truncated(limits, 0.5), limits, strict=True):
        kept = draws[(draws >= lower) & (draws <= upper)]
        assert mean == pytest.approx(kept.mean(), abs=0.003) and sigma == pytest.approx(kept.std(), abs=0.003)


def test_constant_velocity(body: Body) -> None:
    start, step = posed_like(body, "t", np.random.default_rng(10)), np.full(body.dof, 0.01)
    poses = [start, start.retract(step), start.retract(2 * step)]
    np.testing.assert_allclose(pose_at(poses, [1.3, 2.3, 3.3], 0.3).minus(start), -step, atol=1e-9)


# ---------------------------------------------------------------- silhouettes


def test_outline_runs_between_the_pixels() -> None:
    mask = np.zeros((80, 100), bool)
    mask[20:60, 30:71] = True
    outline = outline_of(mask, 1.0)
    straight = (np.abs(outline.points[:, 0] - 50) < 10) | (np.abs(outline.points[:, 1] - 40) < 10)
    away = np.minimum(
        np.abs(outline.points[:, 0] - [[29.5], [70.5]]).min(0), np.abs(outline.points[:, 1] - [[19.5], [59.5]]).min(0)
    )
    assert away[straight].max() < 0.15


def test_rows_of_an_outline_are_the_derivatives_of_its_energy(body: Body) -> None:
    """By the pose and by the girths, about the shape at which the samples were taken."""
    rng, camera = np.random.default_rng(13), ring(1)[0]
    groups = {"thigh": ("femur_r", "femur_l"), "trunk": ("torso", "pelvis")}
    girths = Girths(np.array([0.05, -0.03]), generic=body, groups=groups)
    pose = posed_like(body, "balance", rng)
    contour = visible_contour(render(Posed(girths.body, pose), camera), 3.0)
    target = contour.pixels + 4.0 * rng.standard_normal((len(contour), 2))
    term = OutlineTerm(
        camera.P, contour.points, girths, girths.rest_motion(), contour.normals, target, 1.5, np.ones(len(contour)), 0
    )
    x = Variables({"poses": PoseTrack((pose,), np.zeros(1)), "girths": girths}, ("poses", "girths"))
    problem = BlockProblem([term])
    g = problem.dense(x).gradient
    check_jacobian(
        lambda d: np.array(problem.energies(x.retract(d))["outline"]),
        g, np.zeros(x.dof), step=1e-6, rtol=2e-3, atol=1e-3 * np.abs(g).max(),
    )  # fmt: skip
    assert np.abs(g[-2:]).min() > 1e-3 * np.abs(g).max()


def test_refinement_on_silhouettes(body: Body) -> None:
    rng, rig = np.random.default_rng(11), ring(4)
    truth = Posed(body, posed_like(body, "balance", rng))
    fit = fit_keypoints(body, rig, seen(rig, truth.landmarks, body.landmarks.names, 3.0, rng), fit_lengths=False)
    masks = [render(truth, camera).mask for camera in rig]
    refined = refine_on_silhouettes(body, rig, [fit.pose], [masks])
    names = body.landmarks.names
    which = [i for i, n in enumerate(names) if stem(n) in JOINTS]
    found = Posed(refined.body, refined.poses[0])
    error = 1000 * np.linalg.norm(found.landmarks - truth.landmarks, axis=1)[which]
    assert error.mean() < 10
    assert min(iou(render(found, camera).mask, mask) for camera, mask in zip(rig, masks, strict=True)) > 0.96


def test_girths_from_silhouettes(body: Body) -> None:
    rng, rig = np.random.default_rng(12), ring(4)
    thick = rescaled(body, girths={"femur_r": 1.15, "femur_l": 1.15, "tibia_r": 0.9, "tibia_l": 0.9})
    truth = Posed(thick, posed_like(thick, "t", rng))
    masks = [render(truth, camera).mask for camera in rig]
    found = refine_on_silhouettes(body, rig, [truth.pose], [masks], groups=girth_groups(body))
    assert found.girths["femur_r"] == pytest.approx(1.15, abs=0.05)
    assert found.girths["tibia_l"] == pytest.approx(0.90, abs=0.05)


# ---------------------------------------------------------------- readers and bad input


def write_person(path: Path, xyc: np.ndarray) -> Path:
    path.write_text(json.dumps({"people": [{"pose_keypoints_2d": xyc.ravel().tolist()}]}))
    return path


def test_openpose_names_grid_and_gaps(tmp_path: Path) -> None:
    xyc = np.stack([np.arange(25.0), np.arange(25.0) + 100, np.ones(25)], axis=1)
    xyc[16] = 0
    files = {"a": write_person(tmp_path / "a.json", xyc)}
    grid = {"a": Grid(scale=(2.0, 4.0), offset=(1.0, -8.0))}
    for layout, knee in (("body_25b", 13), ("body_25", 13), ("coco_17", 13)):
        names = LAYOUTS[layout]
        if len(names) == 17:
            continue
        k = read_openpose(files, ["a", "b"], layout, grids=grid)
        assert k.names[knee] == "knee_l"
        np.testing.assert_allclose(k.pixels[0, knee], [(knee - 1) / 2, (knee + 108) / 4])
        assert np.isnan(k.pixels[0, 16]).all() and k.confidence[0, 16] == 0
        assert not k.confidence[1].any()


def test_clicks_csv_and_json_agree(tmp_path: Path) -> None:
    (tmp_path / "c.csv").write_text("camera,joint,x,y\nb,knee_r,1.5,2\na,knee_r,3,4\n")
    (tmp_path / "c.json").write_text('{"b": {"knee_r": [1.5, 2]}, "a": {"knee_r": [3, 4, 0.5]}}')
    one, two = (read_clicks(tmp_path / f, ["a", "b"]) for f in ("c.csv", "c.json"))
    np.testing.assert_array_equal(one.pixels, two.pixels)
    assert one.pixels[0, 0].tolist() == [3, 4] and two.confidence[0, 0] == 0.5


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("camera,joint,x\na,knee_r,1\n", "column 'y' is missing"),
        ("camera,joint,x,y\nz,knee_r,1,2\n", "camera 'z' has no calibration"),
        ("camera,joint,x,y\na,knee_r,1,nan\n", "finite number"),
        ("camera,joint,x,y\na,knee_r,1,two\n", "finite number"),
        ("camera,joint,x,y\na,knee_r,1,2\na,knee_r,1,2\n", "given twice"),
        ("camera,joint,x,y\na,kneee_r,1,2\n", "joint 'kneee_r' is unknown"),
        ("camera,joint,x,y\na,knee_r,1\n", "finite number"),
        (
            "camera,joint,x,y\na,knee_r,1,5,2,5\n",
            "the line of knee_r in a has more fields .* write numbers with a point",
        ),
        ("", "is missing"),
    ],
)
def test_bad_clicks(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "c.csv").write_text(text)
    with pytest.raises(InputError, match=says):
        read_clicks(tmp_path / "c.csv", ["a", "b"], joints=["knee_r"])


def test_bad_openpose(tmp_path: Path) -> None:
    good = write_person(tmp_path / "good.json", np.ones((25, 3)))
    for path, kwargs, says in (
        (
            write_person(tmp_path / "short.json", np.ones((17, 3))),
            {},
            "51 numbers; format 'body_25b' has 75, so set .* = 'coco_17'",
        ),
        (good, {"layout": "coco_17"}, "75 numbers; .* has 51, so set format = 'body_25' or 'body_25b'"),
        (write_person(tmp_path / "nan.json", np.full((25, 3), np.nan)), {}, "write a finite number"),
        (tmp_path / "none.json", {}, "cannot be read"),
        (good, {"person": 3}, "holds 1"),
        (good, {"layout": "body_99"}, "unknown"),
    ):
        with pytest.raises(InputError, match=says):
            read_openpose({"a": path}, ["a"], **kwargs)
    with pytest.raises(InputError, match="no calibration"):
        read_openpose({"z": good}, ["a"])
    with pytest.raises(InputError, match="JSON files"):
        openpose_files({"a": tmp_path}, 99)


def test_bad_input_to_the_fit(body: Body) -> None:
    rng, rig = np.random.default_rng(13), ring(4)
    truth, names = Posed(body, posed_like(body, "t", rng)), body.landmarks.names
    good = seen(rig, truth.landmarks, names, 1.0, rng)
    with pytest.raises(InputError, match="alone gives no first pose"):
        fit_keypoints(body, Rig(rig.cameras[:1]), Keypoints(names, good.pixels[:1], good.confidence[:1]))
    with pytest.raises(InputError, match="need"):
        fit_keypoints(body, rig, Keypoints(names, good.pixels[:3], good.confidence))
    with pytest.raises(InputError, match="finite"):
        fit_keypoints(body, rig, Keypoints(names, good.pixels * np.nan, good.confidence))
    others = tuple(f"bone {k}" for k in range(len(names)))
    with pytest.raises(InputError, match=r"has 0 of their \d+ joints, and no bone 0, bone 1, .* needs a rig file"):
        fit_keypoints(body, rig, Keypoints(others, good.pixels, good.confidence))
    few = good.confidence * (np.arange(len(names)) < 4)
    with pytest.raises(InputError, match="only 4 joints"):
        fit_keypoints(body, rig, Keypoints(names, good.pixels, few))
    with pytest.raises(InputError, match="rig"):
        fit_keypoints_sequence(body, [rig], [good, good])
    with pytest.raises(InputError, match="not all None"):
        refine_on_silhouettes(body, rig, [truth.pose], [[None] * 4])
    with pytest.raises(InputError, match="camera has"):
        refine_on_silhouettes(body, rig, [truth.pose], [[np.ones((5, 5))] * 4])


# ---------------------------------------------------------------- real recordings

BALANCE_GRIDS = {
    "cam01": Grid(scale=(1.0075, 1.0076), offset=(-0.10, -7.29)),
    "cam02": Grid(scale=(1.0076, 1.0075), offset=(-0.10, -7.25)),
}


def balance_rig(folder: Path) -> Rig:
    table = tomllib.loads((folder / "Calib.toml").read_text())
    cameras: list[Camera] = []
    for name in ("cam01", "cam02", "cam03", "cam04"):
        c = table[name]
        T = se3.transform(se3.exp_rotation(c["rotation"]), c["translation"])
        width, height = (int(x) for x in c["size"])
        cameras.append(Camera(name, np.array(c["matrix"]), T, (width, height), np.r_[c["distortions"], 0.0]))
    return Rig(tuple(cameras))


def test_balance_first_frames(body: Body, shared_data: Path) -> None:
    folder = shared_data / "balance_4view"
    rig, trial = balance_rig(folder), folder / "reference" / "S00_P00_T01_BalancingTrial" / "pose"
    folders = {n: trial / f"{n}_json" for n in rig.names}
    keypoints = [read_openpose(openpose_files(folders, j), rig.names, grids=BALANCE_GRIDS) for j in (0, 2)]
    fits = fit_keypoints_sequence(body, rig, keypoints)
    reference = np.load(folder / "reference" / "keypoints3d_world.npz")["X"][0]
    ours = Posed(fits[0].body, fits[0].pose).landmarks[[body.landmarks.index(n) for n in LAYOUTS["body_25b"]]]
    assert np.nanmedian(np.linalg.norm(ours - reference, axis=1)) < 0.03
    pose = pose_at([f.pose for f in fits], [1.3, 3.3], 0.0)
    for camera in rig:
        mask = cv2.imread(str(folder / "masks" / camera.name / "frame_0000.png"), cv2.IMREAD_GRAYSCALE)
        theirs = Rectifier(camera)(mask, nearest=True) > 127
        our = render(Posed(fits[0].body, pose), camera.pinhole()).mask
        assert (our & theirs).sum() / (our | theirs).sum() > 0.75


def leewalk_rig(folder: Path) -> Rig:
    cameras: list[Camera] = []
    for c in range(1, 5):
        v = np.loadtxt(folder / "CALIB" / f"Camera{c}.cal")
        K = np.array([[v[0], v[4] * v[0], v[2]], [0, v[1], v[3]], [0, 0, 1]])
        T = se3.transform(v[10:19].reshape(3, 3), v[19:22] / 1000)
        cameras.append(Camera(f"CAM{c}", K, T, (640, 480), v[5:10]))
    return Rig(tuple(cameras))


def test_leewalk_clicks_and_silhouettes(body: Body, shared_data: Path) -> None:
    folder = shared_data / "leewalk_frame" / "sequenceB_1"
    rig = leewalk_rig(folder)
    clicks = Path(__file__).parents[2] / "examples" / "leewalk_clicks.csv"
    fit = fit_keypoints(body, rig, read_clicks(clicks, rig.names, body.landmarks.names), sigma_px=4.0)
    noisy = [cv2.imread(str(folder / f"FG{c}" / "image0000.bmp"), cv2.IMREAD_GRAYSCALE) for c in range(1, 5)]
    masks = [person(m) for m in noisy]
    found = refine_on_silhouettes(fit.body, rig, [fit.pose], [masks], groups=girth_groups(body))
    overlap: list[float] = []
    for camera, m in zip(rig, noisy, strict=True):
        theirs = Rectifier(camera)(m, nearest=True) > 0
        our = render(Posed(found.body, found.poses[0]), camera.pinhole()).mask
        overlap.append((our & theirs).sum() / (our | theirs).sum())
    # The supplied cylinder body reaches 0.63 to 0.73 (README of the data).
    assert min(overlap) > 0.63 and float(np.mean(overlap)) > 0.73


def person(mask: np.ndarray) -> np.ndarray:
    """The largest piece of a noisy mask, small holes closed."""
    _, label, stats, _ = cv2.connectedComponentsWithStats(mask)
    largest = (label == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])).astype(np.uint8)
    return cv2.morphologyEx(largest, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
