"""What is claimed of a fit, on synthetic least squares: samples that err together, and samples that do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from support.twins import check_twin
from twistcap.arrays import Float
from twistcap.body import Posed
from twistcap.build import build
from twistcap.cues.observation import Agreement, Evidence, Fit, Visibility
from twistcap.predict import claims
from twistcap.predict.claims import MOST, OFFSET, claimed
from twistcap.predict.inertia import INFLATION
from twistcap.render import render, visible_contour
from twistcap.solve import inverse
from twistcap.studio import StudioConfig, capture
from twistcap.studio.config import Condition
from twistcap.terms import PointNormalTerm, PointRayTerm
from twistcap.terms.accumulate import PointTerm
from twistcap.terms.shared import NARROWEST, add_shared_variance
from twistcap.track import Tracker, step

NOISE_PX, DRAWS = 0.5, 300


def fit_of(posed: Posed, terms: Sequence[PointTerm], judging: bool = True) -> Fit:
    agreement = Agreement(np.zeros(1, np.int32), np.zeros(1), np.zeros(1)) if judging else None
    entered = [(Evidence(term, 0, agreement), *term.rows(posed)[1:]) for term in terms]
    nothing = np.zeros(len(posed.body.segment_names), np.bool_)
    fit = Fit.started(posed, Visibility(nothing, nothing))
    return replace(fit, entered=entered, energies={"contour": sum(term.energy(posed) for term in terms)})


def contours() -> tuple[Posed, list[PointNormalTerm]]:
    """A body seen by four cameras, its contour measured where it is."""
    scene = capture(StudioConfig(seed=3, views=4, frames=1))
    posed, terms = Posed(scene.body, scene.true_poses[0]), list[PointNormalTerm]()
    for camera in scene.rig.pinhole():
        contour = visible_contour(render(posed, camera))
        weight = np.full(len(contour), NOISE_PX**-2)
        terms.append(PointNormalTerm(camera.P, contour.points, contour.pixels, contour.normals, weight, 1e3))
    return posed, terms


def information_of(terms: Sequence[PointTerm], posed: Posed) -> Float:
    return np.asarray(sum(term.linearize(posed).hessian for term in terms), np.float64)


def shared_variance(terms: Sequence[PointNormalTerm], posed: Posed) -> Float:
    """Variance of the gradient where the points of each term and of its segments err together."""
    out = np.zeros((posed.body.dof, posed.body.dof))
    for term in terms:
        _, points, rows = term.rows(posed)
        check_twin(add_shared_variance, points.bound_to(posed), rows.gradient, rows.weight, posed.projector, out)
        add_shared_variance(points.bound_to(posed), rows.gradient, rows.weight, posed.projector, out)
    return out


def factor_of(terms: Sequence[PointNormalTerm], posed: Posed) -> float:
    """Mean square residual in units of its claimed variance."""
    rows = [term.rows(posed)[2] for term in terms]
    return sum(r.weight @ r.residual**2 for r in rows) / sum(np.count_nonzero(r.weight) for r in rows)


def moved(term: PointNormalTerm, along: Float) -> PointNormalTerm:
    """The contour measured (N,) px farther out."""
    return replace(term, target=term.target + along[:, None] * term.normal)


def errors(
    posed: Posed, terms: Sequence[PointNormalTerm], gain: Float, rng: np.random.Generator, offset: float, noise: float
) -> Float:
    """(DRAWS, 6 + J) steps of least squares from measurements with noise, and displacements that points share."""
    out = np.zeros((DRAWS, len(gain)))
    parts = len(posed.body.segment_names)
    slopes = [term.rows(posed)[2].gradient for term in terms]
    for draw in out:
        for term, slope in zip(terms, slopes, strict=True):
            places, by_point = term.points.at(posed), np.tile(offset * rng.standard_normal(3), (len(slope), 1))
            for part in range(parts):
                own = np.sum(term.points.weights * (term.points.segments == part), axis=1)
                if not own.any():
                    continue
                apart = places - own @ places / own.sum()
                apart /= max(np.sqrt(own @ np.sum(apart**2, axis=1) / own.sum()), NARROWEST)
                field = rng.standard_normal(3) + apart @ rng.standard_normal((3, 3))
                by_point += offset * own[:, None] * field
            apart = np.sum(slope * by_point, axis=1) + noise * rng.standard_normal(len(slope))
            draw -= gain @ moved(term, apart).linearize(posed).gradient
    return out


def within(found: Float, covariance: Float) -> float:
    """Mean over coordinates of the share within two standard deviations."""
    return float(np.mean(np.abs(found) < 2.0 * np.sqrt(np.diagonal(covariance))))


def test_of_points_that_err_together_the_variance_is_right_and_that_of_independent_samples_is_not() -> None:
    posed, terms = contours()
    rng, offset = np.random.default_rng(0), 0.01
    information, together = information_of(terms, posed), shared_variance(terms, posed)
    gain = inverse(information + np.eye(len(information)))
    assert gain is not None
    found = errors(posed, terms, gain, rng, offset, NOISE_PX)
    assert within(found, gain @ (information + offset**2 * together) @ gain) == pytest.approx(0.954, abs=0.012)
    assert within(found, gain @ information @ gain) < 0.8


def test_of_independent_samples_the_residuals_tell_the_variance() -> None:
    """Twice the noise that the weights say: the factor is four, and with it the claim is right."""
    posed, terms = contours()
    rng = np.random.default_rng(1)
    noisy = [moved(term, 2.0 * NOISE_PX * rng.standard_normal(len(term.weight))) for term in terms]
    factor = factor_of(noisy, posed)
    assert factor == pytest.approx(4.0, rel=0.1)
    information = information_of(terms, posed)
    gain = inverse(information + np.eye(len(information)))
    assert gain is not None
    found = errors(posed, terms, gain, rng, 0.0, 2.0 * NOISE_PX)
    assert within(found, factor * gain @ information @ gain) == pytest.approx(0.954, abs=0.012)


@pytest.mark.parametrize("trust", [1.0, 0.4])
def test_a_claim_is_the_variance_of_what_the_gain_makes_of_prediction_and_images(trust: float) -> None:
    posed, terms = contours()
    terms = [moved(term, np.full(len(term.weight), 1.5 * NOISE_PX)) for term in terms]
    information, together = information_of(terms, posed), shared_variance(terms, posed)
    prior = np.diag(np.linspace(50.0, 500.0, len(information)))
    share = trust / INFLATION**2
    posterior = np.asarray(np.linalg.inv(prior + share * information), np.float64)
    factor = factor_of(terms, posed)
    assert factor == pytest.approx(2.25, rel=0.05)
    gradients = share**2 / trust * factor * (information + (factor * OFFSET) ** 2 * together)
    expected = posterior @ (prior + gradients) @ posterior
    np.testing.assert_allclose(
        claimed(posterior, information, fit_of(posed, terms), trust), expected, rtol=1e-4, atol=1e-9
    )


def test_of_pictures_that_fit_worse_and_worse_no_larger_shared_error_is_claimed() -> None:
    """Residuals of three times their noise; those of a real recording are as large."""
    posed, terms = contours()
    terms = [moved(term, np.full(len(term.weight), 3.0 * NOISE_PX)) for term in terms]
    information, together = information_of(terms, posed), shared_variance(terms, posed)
    factor = factor_of(terms, posed)
    assert factor == pytest.approx(9.0, rel=0.05)
    posterior = np.asarray(np.linalg.inv(np.eye(len(information)) + information / INFLATION**2), np.float64)
    true = (factor * information + MOST**2 * together) / INFLATION**2
    expected = posterior + posterior @ (true - information) @ posterior / INFLATION**2
    found = claimed(posterior, information, fit_of(posed, terms))
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-9)


def test_a_point_that_is_pulled_to_a_ray_counts_once_though_it_has_two_rows() -> None:
    """A contour that lies one standard deviation off has the factor 1, on its normals or on rays."""
    scene = capture(StudioConfig(seed=3, views=4, frames=1))
    posed, terms = Posed(scene.body, scene.true_poses[0]), list[PointRayTerm]()
    for camera in scene.rig.pinhole():
        contour = visible_contour(render(posed, camera))
        rays = camera.rays(contour.pixels + NOISE_PX * contour.normals)
        px_per_m = camera.K[0, 0] * contour.inverse_depth
        terms.append(PointRayTerm(contour.points, *rays, px_per_m, np.full(len(contour), NOISE_PX**-2), 1e3))
    information, together = information_of(terms, posed), np.zeros((posed.body.dof, posed.body.dof))
    for term in terms:
        rows = term.rows(posed)[2]
        add_shared_variance(term.points.bound_to(posed), rows.gradient, rows.weight, posed.projector, together)
    posterior = np.eye(posed.body.dof) * 1e-4
    found = claimed(posterior, information, fit_of(posed, terms))
    true = (information + OFFSET**2 * together) / INFLATION**2
    expected = posterior + posterior @ (true - information) @ posterior / INFLATION**2
    np.testing.assert_allclose(np.diagonal(found), np.diagonal(expected), rtol=0.05)


def test_without_a_cue_that_judges_the_claim_stays() -> None:
    posed, terms = contours()
    known = np.eye(posed.body.dof)
    assert claimed(known, known, fit_of(posed, terms, judging=False)) is known


def claims_of(condition: Condition, frames: int = 6) -> Float:
    """(6 + J,) standard deviations claimed of the last frame of a walk."""
    scene = capture(StudioConfig(seed=4, views=4, frames=frames, condition=condition))
    model = build(scene.body, scene.rig)
    state, sigma = model.start(scene.first_pose), np.zeros(0)
    for k in range(frames):
        state, estimate = step(state, scene.frame(k), model)
        sigma = np.sqrt(np.diagonal(estimate.covariance))
    return sigma


def test_less_is_claimed_of_a_wrong_body() -> None:
    exact, wrong = claims_of("exact"), claims_of("mismatch")
    assert np.median(wrong / exact) > 1.2


def test_nothing_that_is_claimed_enters_the_track(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = capture(StudioConfig(seed=4, views=3, frames=4))
    model, tracks = build(scene.body, scene.rig), list[tuple[Float, Float, Float]]()
    for offset in (OFFSET, 10.0 * OFFSET):
        monkeypatch.setattr(claims, "OFFSET", offset)
        state = model.start(scene.first_pose)
        for k in range(3):
            state, _ = step(state, scene.frame(k), model)
        state, estimate = step(state, scene.frame(3), model)
        tracks.append((estimate.pose.q, state.covariance, estimate.covariance))
    np.testing.assert_array_equal(tracks[0][0], tracks[1][0])
    np.testing.assert_array_equal(tracks[0][1], tracks[1][1])
    assert np.all(np.diagonal(tracks[1][2]) > np.diagonal(tracks[0][2]))


def test_the_flag_reads_nothing_of_what_is_claimed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Claims grow where a body fits badly; a bad fit may be no loss."""
    scene = capture(StudioConfig(seed=3, views=2, frames=4, size=(192, 144)))
    said = list[Float]()
    for offset in (OFFSET, 30.0 * OFFSET):
        monkeypatch.setattr(claims, "OFFSET", offset)
        tracker = Tracker(build(scene.body, scene.rig))
        tracker.start(scene.first_pose)
        estimates = [tracker.step(frame) for frame in scene.frames()]
        said.append(np.array([(e.probability, np.median(np.diagonal(e.covariance))) for e in estimates]))
    np.testing.assert_array_equal(said[0][:, 0], said[1][:, 0])
    assert np.all(said[1][1:, 1] > 4.0 * said[0][1:, 1])
