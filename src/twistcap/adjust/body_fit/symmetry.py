"""The mean of a body and its mirror image: people are nearly alike on both sides."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from twistcap.adjust.body_fit.fields import deformed, joint_centres
from twistcap.adjust.first_pose import girth_groups
from twistcap.arrays import Int
from twistcap.body import Body

_MIRROR = np.array([1.0, -1.0, 1.0])  # in the plane that parts left (+y) from right


def symmetric(body: Body, tolerance: float = 0.015) -> Body:
    """The mean of a body and its mirror image; the body itself where its mesh has no mirrored pairs.

    Args:
        body: of any mesh.
        tolerance: m, greatest mean distance between mirrored vertices.
    """
    partner = mirrored_vertices(body)
    mirrored = body.vertices[partner] * _MIRROR
    paired = np.array_equal(partner[partner], np.arange(len(partner)))
    if not paired or np.linalg.norm(mirrored - body.vertices, axis=1).mean() > tolerance:
        return body
    centres, marks = joint_centres(body), body.landmarks.points
    joints = centres[_partners(body.segment_names)] * _MIRROR
    landmarks = marks[_partners(body.landmarks.names)] * _MIRROR
    return deformed(body, 0.5 * (mirrored - body.vertices), 0.5 * (joints - centres), 0.5 * (landmarks - marks))


def mirrored_vertices(body: Body) -> Int:
    """(V,) nearest vertex of the other side to the mirror image of each; in the middle, itself or a neighbour."""
    partner = np.zeros(len(body.vertices), np.int32)
    for segments in girth_groups(body).values():
        own = [np.flatnonzero(body.vertex_part == body.segment(s)) for s in segments]
        for here, there in zip(own, own[::-1], strict=True):
            if len(here) and len(there):
                partner[here] = there[KDTree(body.vertices[there]).query(body.vertices[here] * _MIRROR)[1]]
    return partner


def _partners(names: tuple[str, ...]) -> list[int]:
    other = {"_r": "_l", "_l": "_r"}
    mirrored = [name[:-2] + other.get(name[-2:], name[-2:]) for name in names]
    return [names.index(m) if m in names else n for n, m in enumerate(mirrored)]
