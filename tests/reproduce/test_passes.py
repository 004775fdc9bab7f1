"""A whole sequence at once: the layers of the picture, the cheapest path, and a limb that was lost."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from itertools import product

import numpy as np
import pytest

from reproduce.experiments.brightness_walks import T2
from reproduce.layers import LimbCost, learnt
from reproduce.passes import LIMBS, PLATES, WALKING, cheapest_path, chosen, track_sequence
from reproduce.plates import NINETEEN, angles_of
from reproduce.scenes.disturbed import plates
from reproduce.scenes.walks import Walk
from twistcap.body.simplify import simplified
from twistcap.cues.view import Picture
from twistcap.differential.model import DifferentialModel
from twistcap.differential.settings import Rule
from twistcap.differential.state import State, Track, state_of
from twistcap.differential.step import followed, track
from twistcap.errors import InputError
from twistcap.render import render
from twistcap.studio import StudioConfig

WALK = Walk(
    (-90.0, -20.0),
    10.0,
    StudioConfig(size=(192, 140), frames=6, colour=False, sensor_noise=0.0),
    per_cycle=12,
    disturbed=plates,
)


@lru_cache
def scene():
    return WALK.scene(1)


@lru_cache
def plates():
    """Model, true states and pictures."""
    found, truth = scene(), scene().true_poses
    model = simplified(found.body, NINETEEN, at=truth[0].q)
    views = [state_of(pose, found.rig).views for pose in truth]
    states = [State(v, angles_of(model, found.body, p.q)) for v, p in zip(views, truth, strict=True)]
    return model, states, [[image for image in frame.images if image is not None] for frame in found.frames()]


def grey():
    return [[Picture(image).level(0)[0] for image in frame] for frame in plates()[2]]


def layers_of(v: int):
    model, states, _ = plates()
    return learnt(model, [f[v] for f in grey()], [s.posed(model) for s in states], [s.views[v] for s in states])


def test_the_cheapest_path_is_that_of_brute_force() -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        counts = rng.integers(1, 5, 5)
        costs = [rng.normal(0, 2, n) for n in counts]
        places = [rng.normal(0, 1, (n, 2)) for n in counts]

        def total(path, costs=costs, places=places) -> float:
            at = [p[k] for p, k in zip(places, path, strict=True)]
            steps = 0.5 * float(np.sum(np.diff(at, axis=0) ** 2))
            return sum(float(c[k]) for c, k in zip(costs, path, strict=True)) + steps

        best = min(product(*(range(n) for n in counts)), key=total)
        assert cheapest_path(costs, places) == list(best)


def test_the_cost_of_a_limb_is_the_change_of_the_whole_cost() -> None:
    model, states, _ = plates()
    layers, state = layers_of(0), states[2]
    which = [model.coordinate(n) for n in ("arm_flex_r", "elbow_flex_r")]
    limb = LimbCost.of(layers, 2, state.posed(model), state.views[0], model.chain[:, which[0]])
    found, wanted = [], []
    for turn in (-0.6, 0.0, 0.5, 1.2):
        q = state.q.copy()
        q[which] += turn
        posed = State(state.views, q).posed(model)
        found.append(limb(posed))
        wanted.append(layers.cost(2, render(posed, state.views[0])))
    np.testing.assert_allclose(np.diff(found), np.diff(wanted), rtol=1e-3, atol=0.5)
    assert np.ptp(wanted) > 20


def test_the_layers_bring_all_exposures_to_one_and_tell_the_body_from_what_is_behind() -> None:
    model, states, _ = plates()
    layers = layers_of(0)
    masks = np.array([render(s.posed(model), s.views[0]).mask for s in states])
    off = ~masks.any(axis=0)
    given = np.array([frame[0] for frame in grey()])
    assert np.ptp(given[:, off].mean(axis=1)) > 0.02  # the plates flicker
    assert np.ptp(layers.images[:, off].mean(axis=1)) < 0.004
    assert np.median(layers.behind[:, off]) < np.median(layers.behind[masks]) - 1.0
    right, none = states[3], states[0]
    costs = [layers.cost(3, render(s.posed(model), s.views[0])) for s in (right, none)]
    assert costs[0] < costs[1] - 100


def test_a_leg_that_was_lost_in_some_exposures_is_found_again() -> None:
    model, states, _ = plates()
    knee, hip = model.coordinate("knee_angle_r"), model.coordinate("hip_flexion_r")
    wrong = list(states)
    for n in (3, 4):
        q = states[n].q.copy()
        q[knee], q[hip] = q[knee] + np.deg2rad(50), q[hip] - np.deg2rad(25)
        wrong[n] = State(states[n].views, np.clip(q, *model.limits.T))
    found = chosen(model, wrong, grey(), 1.0, replace(PLATES, limbs=LIMBS[:1]))
    before, after = (
        np.degrees([np.abs(s.q - t.q)[[knee, hip]].max() for s, t in zip(some, states, strict=True)])
        for some in (wrong, found)
    )
    assert before.max() > 45
    assert after.max() < 22  # a step between the values tried
    assert found[0] is wrong[0] or np.array_equal(found[0].q, wrong[0].q)


def test_a_sequence_without_further_passes_is_the_trackers() -> None:
    body, states, images = plates()
    model = DifferentialModel(body, rule=Rule(levels=2, iterations=2))
    stepped = track(model, states[0], images[:3])
    found = track_sequence(model, states[0], images[:3], replace(PLATES, passes=0))
    for a, b in zip(found[1:], stepped, strict=True):
        np.testing.assert_array_equal(a.q, b.state.q)


def test_an_expected_state_is_looked_for_about() -> None:
    body, states, images = plates()
    model = DifferentialModel(body, rule=Rule(levels=2, iterations=4))
    first, _ = followed(Track.of(states[0]), images[0], model)
    off = [
        np.degrees(np.abs(followed(first, images[2], model, expected)[1].state.q - states[2].q)).max()
        for expected in (None, states[2])
    ]
    assert off[1] < 0.5 * off[0]


def test_an_oblique_walk_is_followed_with_both_legs_before_the_pinhole() -> None:
    """A short walk obliquely towards a near camera, as T-2's: its model, its view and its passes."""
    found = replace(T2.walk, studio=StudioConfig(size=(192, 140), frames=6)).scene(1)
    model, (_, config) = T2.model(found), T2.arms[0]
    assert {"ankle_r", "ankle_l", "wrist_r"} < set(model.landmarks.names)
    assert "wrist_l" not in model.landmarks.names
    truth = [state_of(pose, found.rig, config.perspective) for pose in found.true_poses]
    first = State(truth[0].views, angles_of(model, found.body, truth[0].q))
    images = [list(frame.images) for frame in found.frames()]
    states = track_sequence(DifferentialModel(model, config, Rule(levels=3)), first, images, WALKING)
    assert states[-1].views[0].K is not None
    off = np.degrees([s.q - angles_of(model, found.body, t.q) for s, t in zip(states, truth, strict=True)])
    legs = [k for k, name in enumerate(model.coordinate_names) if name[:4] in ("hip_", "knee")]
    assert len(legs) == 4
    assert np.abs(off[:, legs]).mean() < 3.0
    growth = states[-1].views[0].scale / truth[-1].views[0].scale
    assert abs(growth - 1) < 0.02


def test_a_missing_image_is_told() -> None:
    model, states, images = plates()
    with pytest.raises(InputError, match="frame 1 lacks an image"):
        track_sequence(DifferentialModel(model), states[0], [images[0], [None, *images[1][1:]]], PLATES)


def test_bad_settings_are_told() -> None:
    with pytest.raises(InputError, match="passes"):
        replace(PLATES, passes=-1)
    with pytest.raises(InputError, match="share"):
        replace(PLATES, share=0.0)
    with pytest.raises(InputError, match="every"):
        replace(PLATES, every=0)
