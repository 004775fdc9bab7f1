"""The light on a surface, learnt from images: turns about long axes are followed although the shading stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.build import build
from twistcap.cues.light import (
    TERMS,
    Light,
    light_equations,
    light_equations_reference,
    light_on,
    light_on_reference,
)
from twistcap.hindsight import tracked
from twistcap.studio import StudioConfig, capture

Array = np.ndarray
BODY = humanoid()
POSED = Posed(BODY, Pose.rest(BODY).retract(np.linspace(-0.3, 0.4, BODY.dof)))


def points(seed: int, count: int = 600) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(count, 3))
    return normal / np.linalg.norm(normal, axis=1, keepdims=True), rng.integers(0, 6, count).astype(np.int32)


def lambert(normal: Array, part: Array) -> Array:
    """Two lights and what comes from everywhere, on normals in the rest pose of their parts."""
    world = np.einsum("nij,nj->ni", POSED.segment_transforms[part, :3, :3], normal)
    lights = np.array([[0.6, 0.3, 0.74], [-0.5, 0.8, 0.33]])
    return 0.6 + np.maximum(world @ lights.T, 0.0) @ np.array([0.5, 0.2])


def test_kernels_are_their_twins() -> None:
    rng = np.random.default_rng(0)
    normal, part = points(1)
    coefficients, transforms = rng.normal(0, 0.2, TERMS), POSED.segment_transforms
    arguments = normal, part, transforms, coefficients
    np.testing.assert_allclose(light_on(*arguments), light_on_reference(*arguments), rtol=1e-12)
    brightness = rng.uniform(0.0, 0.8, len(part))
    brightness[::50] = np.nan
    found = light_equations(normal, part, transforms, brightness, coefficients)
    expected = light_equations_reference(normal, part, transforms, brightness, coefficients)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_the_light_is_found_under_clothes_of_any_colour() -> None:
    rng = np.random.default_rng(2)
    cloth, light = rng.uniform(0.2, 0.8, 6), Light.even()
    for view in range(8):
        normal, part = points(view)
        texture = np.exp(rng.normal(0, 0.1, len(part)))
        light = light.learnt(
            [(normal, part, cloth[part] * texture * lambert(normal, part))], POSED.segment_transforms, 3
        )
    normal, part = points(99)
    ratio = np.log(lambert(normal, part) / light.on(normal, part, POSED.segment_transforms))
    before = np.log(lambert(normal, part))
    assert before.std() > 0.15 and (ratio - ratio.mean()).std() < 0.035


def test_nothing_is_learnt_where_nothing_is_seen() -> None:
    normal, part = points(3, 40)
    dark = Light.even().learnt([(normal, part, np.full(40, np.nan))], POSED.segment_transforms, 3)
    assert not dark.coefficients.any()
    np.testing.assert_array_equal(dark.on(normal, part, POSED.segment_transforms), np.ones(40))


def test_turns_about_long_axes_are_followed_although_shading_stays() -> None:
    """Root mean squares were 2.3° and 2.5° where the shading counted as texture."""
    scene = capture(StudioConfig(seed=9, frames=60))
    model = replace(build(scene.body, scene.rig), searches=())
    found = np.array([e.pose.q for e in tracked(scene.frames(), model, scene.first_pose)])
    error = np.degrees(found - np.array([pose.q for pose in scene.true_poses]))
    of = scene.body.coordinate
    hips = error[10:, [of("hip_rotation_r"), of("hip_rotation_l")]]
    ankles = error[10:, [of("subtalar_angle_r"), of("subtalar_angle_l")]]
    assert np.sqrt(np.mean(hips**2)) < 1.6
    assert np.sqrt(np.mean(ankles**2)) < 1.9
