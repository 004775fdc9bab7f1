"""The pose prior: density, term, files, in the tracker and in sessions."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from reproduce.scenes.disturbed import Board, boarded
from reproduce.scenes.subjects import squats, walks_of_another
from support.finite_differences import check_jacobian, numeric_jacobian
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.build import build
from twistcap.cli import main
from twistcap.errors import InputError
from twistcap.hindsight import tracked
from twistcap.io.motion_files import write_mot
from twistcap.io.prior_file import adjusted, read_prior, trained_prior, write_prior
from twistcap.io.session import load_session
from twistcap.priors import ParzenPrior, PriorRule, kernel_width, matched
from twistcap.solve import PoseProblem, minimise
from twistcap.studio import StudioConfig, capture
from twistcap.studio.motion import gait

BODY = humanoid()
NAMES = ("hip_flexion_r", "knee_angle_r", "elbow_flex_l")
RNG = np.random.default_rng(0)
SAMPLES = RNG.normal(0.3, 0.4, size=(40, 3))
SCALE = np.array([1.0, 0.5, 2.0])
PRIOR = ParzenPrior(NAMES, SAMPLES, 0.35, SCALE)


def flow(prior: ParzenPrior, q: np.ndarray) -> np.ndarray:
    """Eq. 11.31."""
    return (prior.mean(q) - q) * prior.information


def posed(q: np.ndarray | None = None) -> Posed:
    return Posed(BODY, Pose(np.eye(4), RNG.normal(0, 0.3, BODY.dof - 6) if q is None else q))


def test_energy_is_the_paper_s_density() -> None:
    q = np.array([0.1, 0.6, -0.2])
    d = (SAMPLES - q) / SCALE
    p = np.mean(np.exp(-np.sum(d**2, axis=1) / (2 * PRIOR.sigma**2)))
    assert PRIOR.energy(q) == pytest.approx(-np.log(p), rel=1e-12)
    assert ParzenPrior(("a",), np.array([[0.2], [0.2]]), 1.0).energy(np.array([0.2])) == pytest.approx(0.0)


def test_flow_is_minus_the_derivative_of_the_energy() -> None:
    for q in (np.array([0.1, 0.6, -0.2]), np.array([2.0, -3.0, 1.0])):
        check_jacobian(lambda x: np.array(PRIOR.energy(x)), -flow(PRIOR, q), q)


def test_flow_is_equation_31_where_its_weights_do_not_underflow() -> None:
    q = np.array([0.1, 0.6, -0.2])
    prior = ParzenPrior(NAMES, SAMPLES, 0.35)
    w = np.exp(-np.sum((SAMPLES - q) ** 2, axis=1) / (2 * 0.35**2))
    np.testing.assert_allclose(flow(prior, q), w @ (SAMPLES - q) / (0.35**2 * w.sum()), rtol=1e-12)


def test_far_from_all_samples_it_still_leads_back() -> None:
    q = np.array([300.0, 0.0, 0.0])  # every w_i is exp(-300000)
    assert np.isfinite(PRIOR.energy(q)) and PRIOR.weights(q).sum() == pytest.approx(1.0)
    assert flow(PRIOR, q)[0] < 0 and np.all(np.isfinite(flow(PRIOR, q)))


def test_mean_shift_climbs_to_a_mode() -> None:
    q, energies = np.array([2.0, 2.0, 2.0]), list[float]()
    for _ in range(200):
        energies.append(PRIOR.energy(q))
        q = PRIOR.mean(q)
    assert np.all(np.diff(energies) <= 1e-12)
    np.testing.assert_allclose(flow(PRIOR, q), 0.0, atol=1e-6)


def test_spread_is_between_one_kernel_and_all_samples() -> None:
    sharp = ParzenPrior(NAMES, SAMPLES, 1e-3)
    np.testing.assert_allclose(sharp.spread(SAMPLES[3]), np.eye(3) * 1e-6, atol=1e-12)
    wide = ParzenPrior(NAMES, SAMPLES, 1e3)
    np.testing.assert_allclose(wide.spread(SAMPLES[3]), np.cov(SAMPLES.T, bias=True) + 1e6 * np.eye(3), rtol=1e-4)


@pytest.mark.parametrize("step", [1.0, 0.125])
def test_the_term_s_gradient_and_majorising_quadratic(step: float) -> None:
    here = posed()
    term = replace(matched(PRIOR, BODY), weight=7.0, step=step)
    quadratic = term.linearize(here)
    assert quadratic.value == pytest.approx(term.energy(here))

    def at(delta: np.ndarray) -> np.ndarray:
        return np.array(term.energy(Posed(BODY, here.pose.retract(delta))))

    check_jacobian(at, quadratic.gradient, np.zeros(BODY.dof))
    exact = numeric_jacobian(lambda d: numeric_jacobian(at, d, 1e-4), np.zeros(BODY.dof), 1e-4)
    assert np.linalg.eigvalsh(quadratic.hessian - exact).min() > -1e-3
    assert np.linalg.eigvalsh(quadratic.hessian).min() >= 0.0
    for delta in RNG.normal(0, 0.5, size=(50, BODY.dof)):
        model = quadratic.value + quadratic.gradient @ delta + 0.5 * delta @ quadratic.hessian @ delta
        assert at(delta) <= model + 1e-9


def test_alone_a_step_goes_to_the_weighted_mean_or_the_paper_s_share_of_it() -> None:
    here = posed()
    for step in (1.0, 0.125):
        term = replace(matched(PRIOR, BODY), weight=50.0, step=step)
        moved = minimise(PoseProblem([term]), here, damping=0.0).x.pose.q - here.pose.q
        q = here.pose.q[term.columns]
        np.testing.assert_allclose(moved[term.columns], step * (PRIOR.mean(q) - q), rtol=1e-4, atol=1e-6)
        others = np.setdiff1d(np.arange(len(moved)), term.columns)
        np.testing.assert_allclose(moved[others], 0.0, atol=1e-12)


def test_coordinates_are_matched_by_name() -> None:
    prior = ParzenPrior(("tail", *NAMES), np.column_stack([SAMPLES[:, 0], SAMPLES]), 0.35)
    term = matched(prior, BODY)
    assert [BODY.coordinate_names[k] for k in term.columns] == list(NAMES) == list(term.prior.names)
    np.testing.assert_array_equal(term.prior.samples, SAMPLES)
    with pytest.raises(InputError, match="none of its coordinates"):
        matched(ParzenPrior(("tail",), SAMPLES[:, :1], 0.3), BODY)


def test_width_is_the_largest_distance_to_a_nearest_neighbour() -> None:
    line = np.array([[0.0, 0], [0.1, 0], [0.4, 0], [0.45, 0]])
    assert kernel_width(line) == pytest.approx(0.1)
    assert kernel_width(np.vstack([line, line, line + 1e-9])) == pytest.approx(0.1)  # a file given twice
    assert kernel_width(np.vstack([line, [[2.0, 0]]])) == pytest.approx(1.55)  # the rule's weakness: one stray
    with pytest.raises(InputError, match="give sigma"):
        kernel_width(np.zeros((5, 2)))
    scaled = ParzenPrior.trained(("a", "b"), line, scale=np.array([2.0, 1.0]))
    assert scaled.sigma == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"samples": np.full((3, 3), np.nan)}, "not finite"),
        ({"samples": np.zeros((3, 2))}, r"\(N, 3\)"),
        ({"samples": np.zeros((0, 3))}, "no samples"),
        ({"sigma": 0.0}, "sigma is 0"),
        ({"sigma": np.nan}, "sigma is nan"),
        ({"scale": np.array([1.0, 0.0, 1.0])}, "scales"),
        ({"names": ("a", "a", "b")}, "names"),
    ],
)
def test_bad_priors_are_told(change: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        replace(PRIOR, **change)
    for rule in ({"strength": -1.0}, {"strength": np.nan}, {"step": 0.0}, {"step": 1.5}):
        with pytest.raises(InputError, match=next(iter(rule))):
            PriorRule(**rule)


def test_files_keep_a_prior(tmp_path: Path) -> None:
    back = read_prior(write_prior(tmp_path / "a.npz", PRIOR))
    assert (back.names, back.sigma) == (PRIOR.names, PRIOR.sigma)
    np.testing.assert_array_equal(back.samples, PRIOR.samples)
    np.testing.assert_array_equal(back.scale, PRIOR.scale)


def test_files_that_are_no_priors_are_told(tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    with pytest.raises(InputError, match="does not exist"):
        read_prior(path)
    path.write_bytes(b"PK\x03\x04 nonsense")
    with pytest.raises(InputError, match="cannot be read"):
        read_prior(path)
    np.savez(path, q=np.zeros((2, 2)))
    with pytest.raises(InputError, match="no twistcap prior"):
        read_prior(path)
    good = {"format": "twistcap-prior", "names": np.array(NAMES), "samples": SAMPLES, "sigma": 0.3, "scale": np.ones(3)}
    for change in (
        {"samples": SAMPLES * np.nan},
        {"names": np.array(["a"])},
        {"sigma": -1.0},
        {"sigma": np.array("x")},
    ):
        np.savez(path, **{**good, **change})  # type: ignore[arg-type]
        with pytest.raises(InputError, match=r"bad\.npz"):
            read_prior(path)


def test_training_reads_mot_with_its_own_signs_and_orders(tmp_path: Path) -> None:
    poses = gait(BODY, frames=30)
    write_mot(tmp_path / "walk.mot", BODY, np.arange(30) / 60, poses)
    prior = trained_prior([tmp_path / "walk.mot"], every=2)
    ours = np.stack([pose.q for pose in poses])[::2]
    columns = [BODY.coordinate(name) for name in prior.names]
    assert set(prior.names) == set(BODY.coordinate_names)
    np.testing.assert_allclose(prior.samples, ours[:, columns], atol=1e-6)
    assert prior.sigma == pytest.approx(kernel_width(ours), rel=1e-4)


def test_training_takes_what_all_files_have(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", q=SAMPLES, coordinate_names=np.array(NAMES))
    np.savez(tmp_path / "b.npz", q=SAMPLES[:, 1:] + 1, coordinate_names=np.array(NAMES[1:]))
    both = trained_prior([tmp_path / "a.npz", tmp_path / "b.npz"], scale={"knee_angle_r": 2.0})
    assert both.names == NAMES[1:] and both.samples.shape == (80, 2)
    np.testing.assert_array_equal(both.scale, [2.0, 1.0])
    with pytest.raises(InputError, match="'hip_flexion_r'"):
        trained_prior([tmp_path / "b.npz"], coordinates=["hip_flexion_r"])
    with pytest.raises(InputError, match="scale names 'tail'"):
        trained_prior([tmp_path / "a.npz"], scale={"tail": 2.0})
    np.savez(tmp_path / "c.npz", q=np.full((2, 3), np.inf), coordinate_names=np.array(NAMES))
    with pytest.raises(InputError, match="q holds a value that is not finite"):
        trained_prior([tmp_path / "c.npz"])
    with pytest.raises(InputError, match="ending"):
        trained_prior([tmp_path / "walk.xyz"])


def test_other_widths_and_scales_of_a_trained_prior() -> None:
    assert adjusted(PRIOR, None, None) is PRIOR
    assert adjusted(PRIOR, 0.2, None).sigma == 0.2
    np.testing.assert_array_equal(adjusted(PRIOR, 0.2, None).scale, PRIOR.scale)  # type: ignore[arg-type]
    wider = adjusted(PRIOR, None, {"knee_angle_r": 3.0})
    assert wider.sigma == pytest.approx(kernel_width(SAMPLES / [1.0, 3.0, 1.0]))


def test_the_command_trains_a_prior(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savez(tmp_path / "a.npz", q=SAMPLES, coordinate_names=np.array(NAMES))
    with pytest.raises(SystemExit) as done:
        main(["prior", "train", str(tmp_path / "p.npz"), str(tmp_path / "a.npz"), "--every", "2", "--json"])
    told = json.loads(capsys.readouterr().out)
    assert not done.value.code and told["samples"] == 20 and told["coordinates"] == list(NAMES)
    assert told["sigma_deg"] == pytest.approx(np.degrees(read_prior(tmp_path / "p.npz").sigma))
    with pytest.raises(SystemExit) as failed:
        main(["prior", "train", str(tmp_path / "p.npz"), str(tmp_path / "missing.mot")])
    assert failed.value.code == 2


SESSION = """
[cameras]
calibration = "Calib.toml"
[videos]
cam01 = "a.mp4"
[first_pose]
file = "pose.json"
"""


def test_a_session_names_a_prior(tmp_path: Path) -> None:
    write_prior(tmp_path / "p.npz", PRIOR)
    path = tmp_path / "s.toml"
    path.write_text(SESSION)
    assert load_session(path).pose_prior is None
    path.write_text(SESSION + '[prior]\npath = "p.npz"\nsigma = 0.2\nstrength = 0.5\nscale = { knee_angle_r = 2.0 }\n')
    session = load_session(path)
    assert session.tracker_settings.prior_strength == 0.5
    prior = session.pose_prior
    assert prior is not None and prior.sigma == 0.2
    np.testing.assert_array_equal(prior.scale, [1.0, 2.0, 1.0])
    path.write_text(SESSION + '[prior]\npath = "p.npz"\nweight = 1\n')
    with pytest.raises(InputError, match="unknown key 'weight'"):
        load_session(path)
    path.write_text(SESSION + '[prior]\npath = "p.npz"\nstrength = -1\n')
    with pytest.raises(InputError, match="strength"):
        load_session(path)


def test_a_hidden_leg_follows_the_rest_of_the_body() -> None:
    """Frames 3 to 7 show no right leg: with a prior it goes on as it should, and its claimed error stays small."""
    leg = ("femur_r", "tibia_r", "foot_r")
    scene = boarded(capture(StudioConfig(seed=2, views=3, frames=8, fps=30)), (Board(leg, 3, 7),))
    prior = ParzenPrior.trained(scene.body.coordinate_names, walks_of_another(scene.body, 3))
    frames, knee = list(scene.frames()), scene.body.coordinate("knee_angle_r")
    errors, claims = dict[bool, float](), dict[bool, float]()
    for helped in (False, True):
        model = build(scene.body, scene.rig, prior=prior if helped else None)
        last = list(tracked(frames, model, scene.first_pose))[-1]
        errors[helped] = float(np.degrees(np.abs(last.pose.q[knee] - scene.true_poses[-1].q[knee])))
        claims[helped] = float(np.degrees(np.sqrt(last.covariance[6 + knee, 6 + knee])))
        assert ("prior" in last.energies) == helped and np.linalg.eigvalsh(last.covariance).min() > 0
    assert errors[True] < 15.0 and errors[True] < 0.5 * errors[False], errors
    assert claims[True] < np.degrees(np.sqrt(np.linalg.eigvalsh(prior.spread(scene.true_poses[-1].q)).max())), claims


def test_boards_hide_what_they_should_and_when() -> None:
    board = Board(("femur_r", "tibia_r", "foot_r"), 1, 1, cameras=(0,))
    without = capture(StudioConfig(seed=2, views=2, frames=3, size=(192, 140)))
    with_board = boarded(without, (board,))
    for frame in range(3):
        for camera in range(2):
            same = np.array_equal(with_board.image(frame, camera), without.image(frame, camera))  # type: ignore[arg-type]
            assert same == ((frame, camera) != (1, 0))
    with pytest.raises(InputError, match="boards"):
        boarded(without, (Board(("foot_r",), 1, 3),))


def test_other_walkers_differ_and_stay_within_limits() -> None:
    first, again, other = (walks_of_another(BODY, seed, walks=1, frames=20) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.degrees(np.abs(first - other).mean()) > 1.0
    for q in (first, squats(BODY)):
        assert np.all((q >= BODY.limits[:, 0]) & (q <= BODY.limits[:, 1]))
