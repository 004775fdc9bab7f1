"""Bodies whose build a few parameters choose: rates, another body's lengths, the fit; Anny where it is installed."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest

from reproduce.measures.surfaces import surface_distances, surface_samples
from support.commands import refusal, run
from support.finite_differences import check_jacobian
from twistcap.adjust.body_fit import FitRule, Take, fit_body, parametric
from twistcap.adjust.body_fit.fields import deformed
from twistcap.adjust.body_fit.parametric import LengthsTerm, Parametric, carried_pose, matched, rates_at
from twistcap.adjust.body_fit.symmetry import mirrored_vertices
from twistcap.body import Pose, Posed, rescaled
from twistcap.body.anny import _check_surface
from twistcap.body.gltf import load_glb, save_glb
from twistcap.body.humanoid import humanoid
from twistcap.camera import Camera, Rig, look_at
from twistcap.errors import InputError
from twistcap.solve import BlockProblem, Variables, Vector
from twistcap.studio import StudioConfig, capture
from twistcap.studio.scene import ring

needs_anny = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("anny", "torch", "warp")),
    reason="the extra twistcap[anny] is not installed",
)


@dataclass(frozen=True)
class Named:
    name: str
    usual: float
    spread: float
    low: float = -1.0
    high: float = 1.0


class Stout:
    """The built-in humanoid by three parameters, of which the first acts by its square too."""

    parameters = (Named("tall", 0.0, 0.5), Named("legs", 0.0, 0.5), Named("stout", 0.0, 0.5))

    def bodies(self, values):
        return [self._body(*row) for row in values]

    def _body(self, tall, legs, stout):
        body = humanoid()
        lengths = {f"{s}_{side}": 1 + 0.2 * legs for s in ("femur", "tibia") for side in "rl"}
        girths = {name: float(np.exp(0.4 * stout)) for name in body.segment_names}
        return rescaled(body, lengths, girths, 1 + 0.1 * tall + 0.05 * tall**2)


def test_rates_are_the_derivatives_of_the_model() -> None:
    model, at = Stout(), np.array([0.3, -0.2, 0.1])
    vertices, joints, marks = rates_at(model, at)
    step = np.array([1e-4, -2e-4, 1.5e-4])
    old, new = model.bodies(np.stack([at, at + step]))
    for rates, moved in (
        (vertices, new.vertices - old.vertices),
        (joints, new.joint_origins - old.joint_origins),
        (marks, new.landmarks.points - old.landmarks.points),
    ):
        assert np.abs(np.tensordot(step, rates, 1) - moved).max() < 2e-3 * np.abs(moved).max()


def test_lengths_pull_the_parameters_as_their_energy_says() -> None:
    """The term's gradient and value, by finite differences of its energy."""
    model, at = Stout(), np.array([0.3, -0.2, 0.1])
    rng, count = np.random.default_rng(1), len(parametric._SIGMAS)
    wanted = parametric._log_lengths(humanoid()) + 0.1 * rng.normal(size=count)
    term = LengthsTerm(model, wanted, rng.uniform(0.01, 0.1, count))

    def energy(values: np.ndarray) -> float:
        return term.energy(Variables({"build": Vector(values)}, ("build",)))

    system = BlockProblem([term]).linearised(Variables({"build": Vector(at)}, ("build",)))
    assert system.value == pytest.approx(energy(at))
    check_jacobian(energy, system.gradient, at, step=1e-4, rtol=2e-3)


def test_steps_stay_within_the_bounds_and_are_exact() -> None:
    model = Stout()
    build = Parametric(model, np.array([0.8, 0.0, 0.0]))
    amounts = np.array([0.1, 0.0, 0.0])
    body = model.bodies((build.start + amounts)[None])[0]
    fields = build.fields(body, {"tall": 0.1})
    change, motions = build.moved(fields, amounts, np.array([0.5, -0.4, 0.2]))
    assert np.allclose(change, [0.1, -0.4, 0.2])
    there = model.bodies(np.array([[1.0, -0.4, 0.2]]))[0]
    moved = deformed(body, *motions)
    assert np.abs(moved.vertices - there.vertices).max() < 1e-9
    assert np.abs(moved.joint_origins - there.joint_origins).max() < 1e-9
    assert np.abs(moved.landmarks.points - there.landmarks.points).max() < 1e-12
    assert build.summary({"legs": -0.4}) == {"tall": 0.8, "legs": -0.4, "stout": 0.0}


def test_a_model_takes_another_bodys_lengths() -> None:
    model = Stout()
    wanted = rescaled(humanoid(), {f"femur_{s}": 1.06 for s in "rl"} | {f"tibia_{s}": 1.06 for s in "rl"}, None, 1.05)
    body = model.bodies(matched(model, wanted).start[None])[0]

    def lengths(of):
        marks = of.landmarks
        at = {name: marks.points[marks.index(name)] for name in marks.names}
        ends = (("hip_r", "knee_r"), ("knee_l", "ankle_l"), ("shoulder_r", "elbow_r"), ("mid_hip", "head_top"))
        return np.array([np.linalg.norm(at[a] - at[b]) for a, b in ends])

    assert np.abs(lengths(body) / lengths(wanted) - 1).max() < 0.004


def test_a_body_without_landmarks_is_told() -> None:
    with pytest.raises(InputError, match=r"humanoid-legs.* has no landmarks .*shoulder_r.*elbow_l"):
        matched(Stout(), humanoid("legs"))


def test_a_surface_of_another_release_is_told() -> None:
    _check_surface(1229)
    with pytest.raises(InputError, match="a surface of 1230 vertices instead of 1229"):
        _check_surface(1230)


def test_a_pose_is_carried_over_to_a_body_of_another_size() -> None:
    given, rig = humanoid(stature=1.7), ring(3, 4.0, 1.0, np.array([0.0, 0.0, 0.9]), (400, 300), 350.0)
    pose = Pose.rest(given)
    q = pose.q.copy()
    for name, angle in (("hip_flexion_r", 0.5), ("knee_angle_r", 0.8), ("arm_add_l", -0.9), ("lumbar_bending", 0.2)):
        q[given.coordinate(name)] = angle
    root = pose.root.copy()
    root[2, 3] = 0.95
    pose = Pose(root, q)
    body = rescaled(given, None, None, 1.02)
    found = carried_pose(given, pose, body, rig)
    off = np.linalg.norm(Posed(body, found).landmarks - Posed(given, pose).landmarks, axis=1)
    assert off.max() < 0.03 and off.mean() < 0.012
    behind = Camera("behind", rig[0].K, look_at([0.1, 0, 3.0], [0.1, 0, 4.0], (1, 0, 0)), rig[0].size)  # sees nothing
    again = carried_pose(given, pose, body, Rig((*rig, behind)))
    assert np.allclose(again.q, found.q, atol=1e-6)
    with pytest.raises(InputError, match="two cameras"):
        carried_pose(given, pose, body, Rig((rig[0], behind)))


def test_the_parameters_of_a_person_are_found_in_a_few_frames() -> None:
    model, true = Stout(), np.array([0.0, 0.0, 0.35])
    person = model.bodies(true[None])[0]
    scene = capture(StudioConfig(seed=3, views=4, frames=2), person)
    build = Parametric(model, np.zeros(3))
    body = model.bodies(np.zeros((1, 3)))[0]
    take = Take(scene.rig, list(scene.frames()), scene.first_pose)
    fitted = fit_body(body, [take], FitRule(rounds=1, steps=3, frames=2), build=build)
    assert list(fitted.factors) == ["tall", "legs", "stout"]
    assert abs(fitted.factors["stout"] - 0.35) < 0.07
    assert abs(fitted.factors["tall"]) < 0.15 and abs(fitted.factors["legs"]) < 0.1
    gone, left = (
        surface_distances(b.vertices, b.faces, person.vertices, person.faces).mean() for b in (body, fitted.body)
    )
    assert left < 0.4 * gone


def test_a_lifted_surface_is_as_far_off_as_its_normals_say() -> None:
    body = humanoid()
    out = replace(body, vertices=body.vertices + np.array([0.0, 0.0, 0.004]))
    points, face = surface_samples(body.vertices, body.faces, 2000)
    a, b, c = (body.vertices[body.faces[face, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    assert np.abs(np.einsum("ni,ni->n", points - a, normal)).max() < 1e-9
    found = surface_distances(body.vertices, body.faces, body.vertices, body.faces)
    assert found.mean() < 2e-4
    lifted = surface_distances(out.vertices, out.faces, body.vertices, body.faces)
    expected = np.abs(0.004 * (normal / np.linalg.norm(normal, axis=1, keepdims=True))[:, 2]).mean()
    assert abs(lifted.mean() - expected) < 3e-4


def test_without_the_extra_one_sentence_says_how_to_get_it(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "anny", None)  # an import of it fails, whether it is installed or not
    walk = tmp_path / "walk"
    assert run("studio", walk, "--size", "96x70", "--views", "2", "--frames", "1") == 0
    said = refusal(capsys, "body", "fit", walk / "session.toml", "--model", "anny", "--out", tmp_path / "body")
    assert "pip install 'twistcap[anny]'" in said


@pytest.fixture(scope="module")
def anny():
    from twistcap.body.anny import AnnyModel

    return AnnyModel()


@needs_anny
def test_anny_is_a_body_like_the_built_in_one(anny, tmp_path) -> None:
    usual = np.array([p.usual for p in anny.parameters])
    body, ours = anny.bodies(usual[None])[0], humanoid()
    assert set(body.coordinate_names) == set(ours.coordinate_names)
    assert set(body.segment_names) == set(ours.segment_names)
    assert set(body.landmarks.names) == set(ours.landmarks.names)
    for name in ours.coordinate_names:
        a, b = body.coordinate(name), ours.coordinate(name)
        assert body.twists[a, :3] @ ours.twists[b, :3] > 0.99, name
    at = dict(zip(body.landmarks.names, body.landmarks.points, strict=True))
    assert np.allclose(at["mid_hip"], 0.0, atol=1e-9) and 1.5 < at["head_top"][2] - at["heel_r"][2] < 1.95
    for name, point in at.items():
        if name.endswith("_r"):
            assert np.allclose(point * [1, -1, 1], at[f"{name[:-2]}_l"], atol=1e-6), name
    assert at["toe_r"][0] > at["ankle_r"][0] > at["heel_r"][0] and at["nose"][0] > at["ear_r"][0]
    edges, faces = body.edges
    assert len(body.vertices) - len(edges) + len(body.faces) == 2 and np.all(faces >= 0)
    partner = mirrored_vertices(body)
    assert (
        np.abs(body.vertices[partner] * [1, -1, 1] - body.vertices).max() < 1.5e-3
    )  # Anny's binding is not quite alike
    save_glb(body, tmp_path / "anny.glb")
    again = load_glb(tmp_path / "anny.glb")
    assert again.coordinate_names == body.coordinate_names
    assert np.abs(again.vertices - body.vertices).max() < 1e-6


@needs_anny
def test_annys_parameters_do_what_they_say(anny) -> None:
    names = [p.name for p in anny.parameters]
    usual = np.array([p.usual for p in anny.parameters])
    assert len(set(names)) == len(names) and not any(name.startswith(("l-", "r-", "nose", "eye")) for name in names)
    wide = usual.copy()
    wide[names.index("weight")], tall = 0.9, usual.copy()
    tall[names.index("height")] = 0.7
    plain, heavy, high = anny.bodies(np.stack([usual, wide, tall]))

    def volume(body):
        a, b, c = (body.vertices[body.faces[:, k]] for k in range(3))
        return float(np.einsum("ni,ni->", a, np.cross(b, c))) / 6

    assert 0.04 < volume(plain) < 0.1
    assert volume(heavy) > 1.05 * volume(plain)
    assert np.ptp(high.vertices[:, 2]) > 1.05 * np.ptp(plain.vertices[:, 2])
    for body in (heavy, high):
        assert np.abs(np.mean(body.vertices[:, 1])) < 1e-4  # both sides change alike, as far as the binding does


@needs_anny
def test_anny_takes_the_lengths_of_a_person(anny) -> None:
    person = humanoid(stature=1.82)
    body = anny.bodies(matched(anny, person).start[None])[0]
    marks, theirs = body.landmarks, person.landmarks
    for a, b in (("hip_r", "knee_r"), ("knee_r", "ankle_r"), ("shoulder_l", "elbow_l"), ("mid_hip", "head_top")):
        ours = np.linalg.norm(marks.points[marks.index(a)] - marks.points[marks.index(b)])
        wanted = np.linalg.norm(theirs.points[theirs.index(a)] - theirs.points[theirs.index(b)])
        assert abs(ours / wanted - 1) < 0.02, a
