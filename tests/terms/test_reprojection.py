"""Keypoints with poses and shape free: derivatives, and the systems that sum their rows with those of others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.blocks import step_between, whole_matrix
from support.finite_differences import check_jacobian
from support.shapes import camera_at
from twistcap import se3
from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.camera import Camera, pinhole
from twistcap.solve import BlockProblem, CameraBlock, PoseTrack, Variables, Vector
from twistcap.solve.problem import ArrowSums, DenseSums
from twistcap.terms import BlockGaussian, LimitTerm, OnPose, Place, ReprojectionTerm, Slope

Array = np.ndarray
BODY = humanoid("legs")
CAMERA = camera_at((2.8, 0.7, 0.4))
FREE = ("poses", "camera", "clock", "shape")  # of camera and clock the term knows nothing


class Grown(Vector):
    """A body that grows about its origin by one log-factor: a shape block that can be worked out by hand."""

    @property
    def body(self) -> Body:
        marks = BODY.landmarks
        twists = BODY.twists.copy()
        twists[:, 3:] *= np.exp(self.values[0])
        return replace(BODY, twists=twists, landmarks=replace(marks, points=np.exp(self.values[0]) * marks.points))

    def rates(self, posed: Posed) -> Array:
        return (posed.landmarks - posed.pose.root[:3, 3])[:, :, None]


def a_track(frames: int = 3, seed: int = 0) -> PoseTrack:
    rng = np.random.default_rng(seed)
    pose = Pose(se3.exp(0.2 * rng.normal(size=6)), 0.2 * rng.normal(size=BODY.dof - 6))
    poses = [pose]
    for _ in range(frames - 1):
        poses.append(poses[-1].retract(0.05 * rng.normal(size=BODY.dof)))
    return PoseTrack(tuple(poses), 0.04 * np.arange(frames))


def a_point() -> Variables:
    blocks = {"poses": a_track(), "camera": CameraBlock(CAMERA), "clock": Vector(np.array([0.013]))}
    return Variables({**blocks, "shape": Grown(np.array([0.05]))}, FREE)


def a_term(x: Variables, camera: Camera = CAMERA, frame: int = 1) -> ReprojectionTerm:
    marks = np.arange(len(BODY.landmarks.names), dtype=np.int32)
    rng = np.random.default_rng(5)
    target = CAMERA.project(Posed(x["shape"].body, x["poses"].poses[1]).landmarks)[0] + 4 * rng.normal(
        size=(len(marks), 2)
    )
    weight, sigma = rng.uniform(0.3, 1.0, len(marks)), rng.uniform(1.0, 3.0, len(marks))
    return ReprojectionTerm(camera.P, marks, target, weight, sigma, 3.0, frame)


def test_rows_are_the_derivatives_of_the_residuals() -> None:
    """By the poses and the shape together."""
    x = a_point()
    term = replace(a_term(x), weight=np.ones(len(BODY.landmarks.names)), reach=1e9)
    J = np.zeros((2 * len(term.marks), x.dof))

    def residuals(x: Variables) -> Array:
        points = Posed(x["shape"].body, x["poses"].poses[1]).landmarks[term.marks]
        return ((pinhole(CAMERA.P, points)[0] - term.target) / term.sigma[:, None]).ravel()

    class Gathered:
        def add_rows(self, energy: float, slopes: list[Slope], weight: Array, residual: Array) -> None:
            np.testing.assert_allclose(weight, 1.0)
            np.testing.assert_allclose(residual, residuals(x))
            for slope in slopes:
                start = x.slices[slope.block].start + slope.first
                J[:, start : start + slope.by.shape[1]] += slope.by

    term.add_to(Gathered(), x)
    check_jacobian(lambda d: residuals(x.retract(d)), J, np.zeros(x.dof), rtol=1e-5, atol=1e-5)
    assert np.abs(J[:, x.slices["shape"]]).max() > 1 and np.abs(J[:, x.slices["poses"]]).max() > 1


@pytest.mark.parametrize("free", [FREE, ("poses",), ("shape",)])
def test_the_gradient_is_that_of_the_energy(free: tuple[str, ...]) -> None:
    x = replace(a_point(), free=free)
    limits = OnPose(LimitTerm(0.1), BODY, frame=1)
    problem = BlockProblem([a_term(x), limits, BlockGaussian("shape", np.zeros(1), np.array([0.1]))])
    system = problem.dense(x)
    assert system.value == pytest.approx(sum(problem.energies(x).values()))

    def energy(step: Array) -> Array:
        return np.array(sum(problem.energies(x.retract(step)).values()))

    check_jacobian(energy, system.gradient, np.zeros(x.dof), rtol=1e-4, atol=1e-4 * np.abs(system.gradient).max())


def test_arrow_and_dense_are_one_system() -> None:
    x = a_point()
    terms = [a_term(x), a_term(x, frame=2), OnPose(LimitTerm(0.1), BODY, frame=2)]
    problem = BlockProblem([*terms, BlockGaussian("shape", np.zeros(1), np.array([0.1]))])
    dense, arrow = problem.dense(x), problem.arrow(x, reach=1)
    np.testing.assert_allclose(whole_matrix(arrow), dense.hessian, atol=1e-9 * np.abs(dense.hessian).max())
    np.testing.assert_allclose(np.r_[arrow.pull.ravel(), arrow.shared_pull], dense.gradient, rtol=1e-9, atol=1e-9)
    assert arrow.value == pytest.approx(dense.value)
    assert isinstance(ArrowSums(x, 1).arrow.shared_longest, np.ndarray) and DenseSums(x).value == 0.0


@pytest.mark.parametrize("free", [FREE, ("poses", "shape"), ("poses",)])
def test_a_quadratic_of_several_blocks_is_added_in_both_systems(free: tuple[str, ...]) -> None:
    """To its free numbers only."""
    x, D = replace(a_point(), free=free), BODY.dof
    A = np.random.default_rng(4).normal(size=(D + 3, D + 3))
    places, q, H = (
        [Place("clock", 1), Place("poses", D, 2 * D), Place("camera", 1, 2), Place("shape", 1)],
        A[0],
        A @ A.T,
    )
    dense, arrow = DenseSums(x), ArrowSums(x, 1)
    for sums in (dense, arrow):
        sums.add_quadratic(places, 0.5, q, H)
    step = np.random.default_rng(5).normal(size=x.dof)
    full = step_between(x.retract(step), x)
    pick = lambda name, k: full[x.slices[name].start + k] if name in free else 0.0  # noqa: E731
    d = np.r_[pick("clock", 0), full[2 * D : 3 * D], pick("camera", 2), pick("shape", 0)]
    assert dense.gradient @ step == pytest.approx(q @ d) and step @ dense.hessian @ step == pytest.approx(d @ H @ d)
    np.testing.assert_allclose(whole_matrix(arrow.arrow), dense.hessian)
    np.testing.assert_allclose(np.r_[arrow.arrow.pull.ravel(), arrow.arrow.shared_pull], dense.gradient)
    assert arrow.arrow.value == dense.value == 0.5


def test_the_one_projection_derivative() -> None:
    points = np.random.default_rng(3).normal(0, 0.4, (4, 5, 3))
    P = np.stack([camera_at(eye).P for eye in [(2.8, 0.7, 0.4), (-0.5, 2.9, 0.2), (-2, -2, 0.6), (2, -2, 0)]])
    pixels, depth, by_point = pinhole(P, points)
    for c, matrix in enumerate(P):
        alone = pinhole(matrix, points[c])
        for one, many in zip(alone, (pixels[c], depth[c], by_point[c]), strict=True):
            np.testing.assert_allclose(one, many, atol=1e-10)
    x = points[1, 2]
    check_jacobian(lambda p: pinhole(P[1], p[None])[0][0], by_point[1, 2], x, rtol=1e-6, atol=1e-4)


def test_behind_the_camera_a_keypoint_is_wrong_and_counts_for_nothing() -> None:
    x = a_point()
    behind = replace(CAMERA, T_cam_world=np.diag([1.0, -1.0, -1.0, 1.0]) @ CAMERA.T_cam_world)
    problem = BlockProblem([a_term(x, behind)])
    system = problem.dense(x)
    assert np.isfinite(system.value) and not system.gradient.any()
    assert system.value == pytest.approx(0.5 * 9.0 * a_term(x).weight.sum(), rel=1e-6)
