"""The solver: it finds a known pose, never climbs, and says so when it cannot go on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from support.shapes import camera_at
from twistcap import se3
from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.render import SurfacePoints
from twistcap.solve import Dense, PoseProblem, Solution, covariance, minimise
from twistcap.terms import GaussianTerm, KeypointTerm, LimitTerm, Quadratic, Term

Array = np.ndarray
BODY = humanoid("legs")
VIEWS = [camera_at(eye) for eye in [(2.8, 0.7, 0.4), (-0.5, 2.9, 0.2), (-2.0, -2.0, 0.6)]]


def least_squares(posed: Posed, terms: Sequence[Term], steps: int = 1) -> Solution[Posed, Dense]:
    return minimise(PoseProblem(terms), posed, steps)


def random_pose(body: Body, seed: int, size: float = 0.25) -> Pose:
    rng = np.random.default_rng(seed)
    return Pose(se3.exp(size * rng.normal(size=6)), size * rng.normal(size=body.dof - 6))


def keypoints(truth: Pose, scale_px: float = 50.0) -> list[Term]:
    """Perfect keypoints of a pose: many surface points of every segment, in three views."""
    where = np.random.default_rng(0).choice(len(BODY.vertices), 80, replace=False)
    points = SurfacePoints(BODY.skin_segments[where], BODY.skin_weights[where], BODY.vertices[where])
    X = points.at(Posed(BODY, truth))
    return [KeypointTerm(c.P, points, c.project(X)[0], np.ones(len(points)), scale_px) for c in VIEWS]


@dataclass(frozen=True)
class Scripted:
    """A term that answers with its own quadratic, and writes down every energy it is asked for."""

    quadratic: Quadratic
    energies: tuple[float, ...] = (2.0,)
    asked: list[float] = field(default_factory=list)
    name: str = "scripted"

    def energy(self, posed: Posed) -> float:
        self.asked.append(self.energies[min(len(self.asked), len(self.energies) - 1)])
        return self.asked[-1]

    def linearize(self, posed: Posed) -> Quadratic:
        return self.quadratic


def bowl(value: float = 1.0) -> Quadratic:
    return Quadratic(value, np.full(BODY.dof, 0.1), np.eye(BODY.dof))


@pytest.mark.parametrize("seed", range(4))
def test_keypoints_lead_back_to_the_known_pose(seed: int) -> None:
    """With joint limits, as in every use: without them a weak joint may take a step of a whole turn and stay there."""
    truth = random_pose(BODY, seed)
    truth = Pose(truth.root, np.clip(truth.q, *BODY.limits.T))
    start = truth.retract(0.1 * np.random.default_rng(seed + 10).normal(size=BODY.dof))
    result = least_squares(Posed(BODY, start), [LimitTerm(), *keypoints(truth)], steps=40)
    assert result.status == "converged" and 2 <= result.steps < 40
    assert np.abs(result.x.pose.minus(truth)).max() < 1e-5
    assert result.energy < 1e-6


def test_energy_falls_with_every_step_and_is_that_of_the_pose() -> None:
    truth = random_pose(BODY, 1)
    start = truth.retract(0.3 * np.random.default_rng(2).normal(size=BODY.dof))
    terms = keypoints(truth, scale_px=5.0)  # a hard start: most points begin on the flat of the robust loss
    energies = [sum(PoseProblem(terms).energies(Posed(BODY, start)).values())]
    for steps in range(1, 8):
        result = least_squares(Posed(BODY, start), terms, steps=steps)
        assert result.energy == pytest.approx(
            sum(PoseProblem(terms).energies(Posed(BODY, result.x.pose)).values()), rel=1e-12
        )
        assert result.energy <= energies[-1] and result.steps <= steps
        energies.append(result.energy)
    assert energies[-1] < 0.7 * energies[0]


def test_no_step_is_accepted_that_raises_the_energy() -> None:
    """The quadratic promises a fall, the energy rises at every trial: the pose stays."""
    pose = random_pose(BODY, 3)
    term = Scripted(bowl(), energies=(1.5,))
    result = least_squares(Posed(BODY, pose), [term], steps=3)
    assert result.status == "stalled" and result.steps == 0
    assert result.x.pose is pose and len(term.asked) > 1
    assert result.energy == 1.5  # that of the pose, as the term tells it


def test_a_shorter_step_is_tried_when_the_first_one_climbs() -> None:
    pose = random_pose(BODY, 3)
    result = least_squares(Posed(BODY, pose), [Scripted(bowl(), energies=(1.5, float("nan"), 0.7))], steps=1)
    assert result.steps == 1 and result.energy == 0.7
    full = -bowl().gradient
    taken = result.x.pose.minus(pose)
    np.testing.assert_allclose(taken / full, (taken / full)[0], rtol=1e-6)
    assert 0 < (taken / full)[0] < 0.999


@pytest.mark.parametrize("spoilt", ["value", "gradient", "hessian"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_number_that_is_not_finite_fails_and_leaves_the_pose(spoilt: str, bad: float) -> None:
    pose, quadratic = random_pose(BODY, 4), bowl()
    array = getattr(quadratic, spoilt) * np.ones_like(getattr(quadratic, spoilt))
    if spoilt == "value":
        array = bad
    else:
        array[..., 7] = bad
    result = least_squares(Posed(BODY, pose), [Scripted(replace(quadratic, **{spoilt: array}))], steps=5)
    assert result.status == "failed" and result.steps == 0
    assert result.x.pose is pose


def test_a_term_that_breaks_later_keeps_the_last_good_pose() -> None:
    @dataclass(frozen=True)
    class Breaking(Scripted):
        calls: list[int] = field(default_factory=list)

        def linearize(self, posed: Posed) -> Quadratic:
            self.calls.append(1)
            return bowl() if len(self.calls) == 1 else replace(bowl(0.5), gradient=np.full(BODY.dof, np.nan))

    pose = random_pose(BODY, 4)
    result = least_squares(Posed(BODY, pose), [Breaking(bowl(), energies=(0.5, 0.4))], steps=5)
    assert result.steps == 1 and result.energy == 0.5 and result.status == "failed"
    assert np.all(np.isfinite(result.x.pose.q)) and np.all(np.isfinite(result.x.pose.root))
    assert np.abs(result.x.pose.minus(pose)).max() > 0.05
    assert np.all(np.isfinite(result.system.covariance()))


def test_a_term_without_information_leaves_the_pose() -> None:
    """Nothing to go by is no failure: the step is zero."""
    pose = random_pose(BODY, 5)
    result = least_squares(Posed(BODY, pose), [], steps=3)
    assert result.status == "converged" and np.abs(result.x.pose.minus(pose)).max() < 1e-12


def test_a_gaussian_alone_gives_its_mean_in_one_solve() -> None:
    mean = random_pose(BODY, 6)
    A = np.random.default_rng(7).normal(size=(BODY.dof, BODY.dof))
    term = GaussianTerm(mean, A @ A.T + np.eye(BODY.dof))
    result = least_squares(Posed(BODY, random_pose(BODY, 8)), [term], steps=30)
    assert np.abs(result.x.pose.minus(mean)).max() < 1e-5


def test_covariance_of_a_gaussian_is_its_own() -> None:
    A = np.random.default_rng(7).normal(size=(BODY.dof, BODY.dof))
    own = 1e-3 * (A @ A.T + np.eye(BODY.dof))
    mean = random_pose(BODY, 6)
    posed = Posed(BODY, mean)
    found = covariance(PoseProblem([GaussianTerm(mean, np.linalg.inv(own))]).linearised(posed))
    np.testing.assert_allclose(found, own, rtol=1e-6, atol=1e-9)
    twice = covariance(PoseProblem([GaussianTerm(mean, np.linalg.inv(own))] * 2).linearised(posed))
    np.testing.assert_allclose(twice, own / 2, rtol=1e-6, atol=1e-9)


def test_directions_without_information_are_very_uncertain_not_infinite() -> None:
    H = np.diag(np.r_[np.full(BODY.dof - 1, 100.0), 0.0])
    found = covariance(Quadratic(0.0, np.zeros(BODY.dof), H))
    np.testing.assert_allclose(np.diag(found), np.r_[np.full(BODY.dof - 1, 0.01), 100.0])


def test_covariance_predicts_the_scatter_of_noisy_keypoints() -> None:
    """Solve the same pose from 60 draws of pixel noise: the errors, whitened, have variance 1."""
    truth, rng, sigma = random_pose(BODY, 9, 0.15), np.random.default_rng(11), 1.5
    clean = [replace(t, weight=t.weight / sigma**2, scale_px=1e3) for t in keypoints(truth)]
    C = covariance(PoseProblem(clean).linearised(Posed(BODY, truth)))
    whiten = np.linalg.inv(np.linalg.cholesky(C))
    squares = []
    for _ in range(60):
        noisy = [replace(t, target=t.target + sigma * rng.normal(size=t.target.shape)) for t in clean]
        step = least_squares(Posed(BODY, truth), noisy, steps=4).x.pose.minus(truth)
        squares.append((whiten @ step) ** 2)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.15)


def test_damping_shortens_the_step_and_a_matrix_that_is_not_positive_gives_none() -> None:
    q = Dense(bowl().value, bowl().gradient, bowl().hessian)
    full, damped = q.step(0.0), q.step(1.0)
    assert full is not None and damped is not None
    np.testing.assert_allclose(full, -q.gradient, rtol=1e-6)
    np.testing.assert_allclose(damped, -q.gradient / 2, rtol=1e-6)
    assert replace(q, hessian=-np.eye(BODY.dof)).step(0.0) is None


def test_held_unknowns_stay_and_others_move_as_without_them() -> None:
    A = np.random.default_rng(1).normal(size=(5, 5))
    q = Dense(1.0, np.arange(1.0, 6.0), A @ A.T + np.eye(5), longest=1e3)
    held = np.array([False, True, False, False, True])
    step = q.holding(held).step(0.0)
    assert step is not None and not step[held].any()
    free = np.flatnonzero(~held)
    np.testing.assert_allclose(step[free], -np.linalg.solve(q.hessian[np.ix_(free, free)], q.gradient[free]), rtol=1e-6)


def test_no_entry_of_a_step_is_longer_than_its_own_unit_allows() -> None:
    q = Dense(1.0, np.array([-4.0, -4.0]), np.eye(2), longest=np.array([1.0, 0.1]))
    np.testing.assert_allclose(q.step(0.0), [0.1, 0.1])


@dataclass
class Valley:
    """Rosenbrock's, as least squares of (x, y), and every damping that was asked for."""

    asked: list[float] = field(default_factory=list)

    def rows(self, x: Array) -> Array:
        return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])

    def energies(self, x: Array) -> dict[str, float]:
        return {"valley": 0.5 * float(self.rows(x) @ self.rows(x))}

    def linearised(self, x: Array) -> Dense:
        J, asked = np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]]), self.asked

        class Watched(Dense):
            def step(self, damping: float) -> Array | None:
                asked.append(damping)
                return super().step(damping)

        return Watched(self.energies(x)["valley"], J.T @ self.rows(x), J.T @ J)

    def retract(self, x: Array, step: Array) -> Array:
        return x + step


def test_any_problem_is_minimised_and_damping_is_carried_over() -> None:
    """No step's first damping is above a tenth of what the last one took, nor below the least."""
    valley = Valley()
    result = minimise(valley, np.array([-1.2, 1.0]), steps=200)
    assert result.status == "converged"
    np.testing.assert_allclose(result.x, 1.0, atol=1e-5)
    assert max(valley.asked) > 1e-2 and min(valley.asked) == pytest.approx(1e-3)
    for before, after in zip(valley.asked[:-1], valley.asked[1:], strict=True):
        assert after == pytest.approx(10 * before) or after == pytest.approx(max(0.1 * before, 1e-3))


def test_a_small_gain_ends_it() -> None:
    start = np.array([-1.2, 1.0])
    patient, hasty = minimise(Valley(), start, 200), minimise(Valley(), start, 200, gain=0.5)
    assert hasty.status == "converged" and hasty.steps < patient.steps
