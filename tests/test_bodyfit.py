"""Fitting a body to contours: fields, rows, the joint solve and the whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.bodyfit import fields as f
from twistcap.bodyfit.observe import Observed
from twistcap.bodyfit.solve import Shape, reshaped, rows
from twistcap.render import contour_on_edges, render
from twistcap.render.view import surface_points
from twistcap.studio.ring import ring


@pytest.fixture(scope="module")
def body():
    return humanoid()


def all_fields(body):
    return f.stretch_fields(body, 0.1, 0.1, 0.1) + f.profile_fields(body, 0.1, 4) + f.joint_fields(body, 0.01, 0.01)


def shape_of(body):
    fields = all_fields(body)
    M, V = len(fields.names), len(body.vertices)
    return Shape(fields, f.offset_directions(body), np.eye(M + V))


def a_pose(body, seed=0):
    rng = np.random.default_rng(seed)
    q = np.clip(rng.uniform(-0.5, 0.7, len(body.coordinate_names)), *body.limits.T)
    return Pose.rest(body).retract(np.concatenate([rng.normal(0, 0.3, 6), q]))


def test_rows_are_the_derivatives_of_the_projected_points(body) -> None:
    shape, pose = shape_of(body), a_pose(body)
    posed = Posed(body, pose)
    camera = ring(3, 4.0, 1.0, np.zeros(3), (400, 300), 500.0, 0.0)[1]
    contour, ends, shares = contour_on_edges(render(posed, camera), 3.0)
    seen = Observed(camera, contour, ends, shares, np.zeros(len(contour)), np.ones(len(contour)), 100.0)
    found = rows(posed, shape, seen)
    rng = np.random.default_rng(1)

    def along(body, pose):
        points = replace(contour.points, local=surface_points(body, ends, shares).local)
        pixels, _ = camera.project(points.at(Posed(body, pose)))
        return np.sum(contour.normals * pixels, axis=1)

    step = 1e-6
    names = shape.fields.names
    chosen = [0, names.index("length femur"), names.index("girth torso"), names.index("section tibia 2 1")]
    chosen += [k for k, name in enumerate(names) if name.startswith("joint")]
    chosen += [len(names) + int(v) for v in rng.choice(ends.ravel(), 10)]
    worst = {}
    for k in chosen:
        amounts = np.zeros(shape.size)
        amounts[k] = step
        there = along(f.deformed(body, *reshaped(body, shape, amounts)), pose)
        amounts[k] = -step
        back = along(f.deformed(body, *reshaped(body, shape, amounts)), pose)
        unit = np.eye(shape.size)[:, k : k + 1]
        ours = found.field @ unit[: len(names), 0] + found.vertex @ unit[len(names) :, 0]
        worst[names[k] if k < len(names) else k] = np.abs(ours - (there - back) / (2 * step)).max()
    assert max(worst.values()) < 1e-3, worst
    for k in range(6, 6 + len(pose.q)):
        d = step * np.eye(len(found.pose[0]))[k]
        slope = (along(body, pose.retract(d)) - along(body, pose.retract(-d))) / (2 * step)
        assert np.abs(found.pose[:, k] - slope).max() < 1e-3
