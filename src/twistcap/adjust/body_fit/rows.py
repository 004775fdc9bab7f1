"""Rows of contour distances by the twists of segments and the motions of vertices.

A distance changes with the twists of the segments that carry its point, and with the motions in the rest pose of the
two vertices of its edge. Skeleton and fields are applied once, to the sums of a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from twistcap.adjust.body_fit.observe import Observed
from twistcap.arrays import Float, Int
from twistcap.body import Posed
from twistcap.render.view import surface_points
from twistcap.terms.points import projected_rows


@dataclass(frozen=True)
class Rows:
    """Derivatives of N distances along the image normals.

    Attributes:
        twist: (N, 6 S) by the twist of each segment.
        vertex: (N, 3 V) by the motion of each vertex in the rest pose.
    """

    twist: sparse.csr_array
    vertex: sparse.csr_array


def rows(posed: Posed, views: Sequence[Observed]) -> Rows:
    """Of all views of one frame."""
    twist, segments, turned, ends = zip(*(_of_view(posed, view) for view in views), strict=True)
    by_twist = _sparse(np.concatenate(segments), np.concatenate(twist), len(posed.body.segment_names))
    return Rows(by_twist, _sparse(np.concatenate(ends), np.concatenate(turned), len(posed.body.vertices)))


def _of_view(posed: Posed, seen: Observed) -> tuple[Float, Int, Float, Int]:
    """Derivatives (N, K, 6) by the twists of segments (N, K), and (N, 2, 3) by the motions of vertices (N, 2)."""
    points = surface_points(posed.body, seen.ends, seen.shares)
    _, gradient = projected_rows(seen.camera.P, points.at(posed), seen.contour.normals, seen.contour.pixels)
    T = posed.segment_transforms[points.segments]
    carried = np.einsum("nkij,nj->nki", T[..., :3, :3], points.local) + T[..., :3, 3]
    pull = points.weights[..., None] * gradient[:, None]
    turned = np.einsum("nki,nkij->nj", pull, T[..., :3, :3])
    twist = np.concatenate([np.cross(carried, pull), pull], axis=2)
    return twist, points.segments, seen.shares[..., None] * turned[:, None], seen.ends


def _sparse(which: Int, values: Float, count: int) -> sparse.csr_array:
    """(N, w count) of values (N, K, w) of items (N, K) out of `count`; values of one item are summed."""
    N, K, w = values.shape
    columns = which[..., None] * w + np.arange(w)
    row = np.repeat(np.arange(N), K * w)
    return sparse.coo_array((values.ravel(), (row, columns.ravel())), shape=(N, count * w)).tocsr()
