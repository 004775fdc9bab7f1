"""The mean of a body and its mirror image: people are nearly alike on both sides."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from twistcap.adjust.body_fit.fields import deformed
from twistcap.adjust.first_pose import girth_groups
from twistcap.arrays import Float, Int
from twistcap.body import Body
from twistcap.body.model import partners

_MIRROR = np.array([1.0, -1.0, 1.0])  # in the plane that parts left (+y) from right
_APART = 0.015  # m, mean distance of mirrored pairs, at most


def symmetric(body: Body) -> Body:
    """The mean of a body and its mirror image; the body itself where its mesh has no mirrored pairs."""
    partner = mirrored_vertices(body)
    mirrored = body.vertices[partner] * _MIRROR
    if not _in_pairs(partner) or np.linalg.norm(mirrored - body.vertices, axis=1).mean() > _APART:
        return body
    centres, marks = body.joint_origins, body.landmarks.points
    joints = centres[partners(body.segment_names)] * _MIRROR
    landmarks = marks[partners(body.landmarks.names)] * _MIRROR
    return deformed(body, 0.5 * (mirrored - body.vertices), 0.5 * (joints - centres), 0.5 * (landmarks - marks))


def mirrored_vertices(body: Body) -> Int:
    """(V,) vertex of the other side that mirrors each; in the middle, itself or a neighbour.

    Where the mesh is rough, the nearest one of two vertices may have a nearer one of its own. Those that are left over
    are assigned to one another with the least sum of squared distances, so that pairs stay pairs.
    """
    partner = np.zeros(len(body.vertices), np.int32)
    for segments in girth_groups(body).values():
        own = [np.flatnonzero(body.vertex_part == body.segment(s)) for s in segments]
        for here, there in zip(own, own[::-1], strict=True):
            if len(here) and len(there):
                partner[here] = there[_assigned(body.vertices[here] * _MIRROR, body.vertices[there])]
    return partner


def alike(precision: sparse.csr_array, body: Body, apart: float) -> sparse.csr_array:
    """(V, V) precision of offsets whose difference between the sides is held; the same where nothing is paired.

    Offsets are the sum of a part that both sides have in common and of one with opposite signs, whose standard
    deviation has the factor `apart` against that of the `precision` (V, V) given.
    """
    partner = mirrored_vertices(body)
    if not _in_pairs(partner):
        return precision
    half = 0.5 * (precision - precision[:, partner])
    return precision + (apart**-2.0 - 1.0) * 0.5 * (half - half[partner])


def _in_pairs(partner: Int) -> bool:
    return np.array_equal(partner[partner], np.arange(len(partner)))


def _assigned(points: Float, others: Float) -> Int:
    """(N,) the nearest of the others (M, 3) to each point (N, 3); one to one where there are as many."""
    nearest, back = (np.asarray(KDTree(a).query(b)[1], np.int32) for a, b in ((others, points), (points, others)))
    if len(points) != len(others):
        return nearest
    alone = np.flatnonzero(back[nearest] != np.arange(len(points)))
    free = np.flatnonzero(nearest[back] != np.arange(len(others)))
    nearest[alone] = free[linear_sum_assignment(cdist(points[alone], others[free], "sqeuclidean"))[1]]
    return nearest
