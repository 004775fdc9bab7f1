"""Evidence of poses that differ in one limb or branch of the body: only what that moves is drawn again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float, Float32, Int
from twistcap.body import Body, Pose, Posed
from twistcap.body.limbs import limb_parts
from twistcap.camera.projection import projected
from twistcap.render.raster import rasterise
from twistcap.search.evidence import Evidence, EvidenceView


@dataclass(frozen=True)
class _Still:
    """What one view shows of a body without what moves.

    Attributes:
        part, nearness: (h, w) visible segment, −1 for none, and its nearness, 0 there.
        nats: its evidence.
        share: what the view counts, see `EvidenceView.share`.
    """

    view: EvidenceView
    part: Int
    nearness: Float32
    nats: float
    share: float


@dataclass(frozen=True)
class RedrawnLimb:
    """A body at a pose, of which one limb or branch moves. For all poses that differ in that alone `of` equals
    `Evidence.of`.

    Attributes:
        faces, face_part: (F, 3) triangles that move, of the vertices that do, and the segment (F,) of each.
        skin: segments (V, K), weights (V, K) and places at rest (V, 3) of those vertices.
        still: all else, by view.
    """

    body: Body
    faces: Int
    face_part: Int
    skin: tuple[Int, Float, Float]
    still: Sequence[_Still]

    @staticmethod
    def at(evidence: Evidence, pose: Pose, limb: Bool) -> RedrawnLimb:
        """For the coordinates (6 + J,) of a limb or branch, with the rest of the body at a pose."""
        body, posed = evidence.body, Posed(evidence.body, pose)
        moved: Bool = np.any((body.skin_weights > 0.0) & limb_parts(body, limb)[body.skin_segments], axis=1)
        moving: Bool = np.any(moved[body.faces], axis=1)
        corners, faces = np.unique(body.faces[moving], return_inverse=True)
        still = [_still(view, posed, ~moving) for view in evidence.views]
        skin = body.skin_segments[corners], body.skin_weights[corners], body.vertices[corners]
        return RedrawnLimb(body, faces.reshape(-1, 3).astype(np.int32), body.face_part[moving], skin, still)

    def of(self, pose: Pose) -> float:
        """Nats for a body at a pose, see `Evidence.of`."""
        points, nats = Posed(self.body, pose).points(*self.skin), 0.0
        for still in self.still:
            pixels, nearness = projected(still.view.camera, points)
            first, size = window(pixels, still.view.camera.size)
            limb = rasterise(pixels, nearness, self.faces, first, size)
            more = evidence_before(still.view.maps, still.part, still.nearness, first, *limb, self.face_part)
            nats += max(still.share * (still.nats + more), 0.0)
        return nats


def _still(view: EvidenceView, posed: Posed, faces: Bool) -> _Still:
    """Some faces (F,) of a body in a view."""
    part, nearness = drawn(posed.body, faces, *projected(view.camera, posed.vertices), view.camera.size)
    rows, columns = np.nonzero(part >= 0)
    nats = float(view.maps[part[rows, columns], rows, columns].sum())
    return _Still(view, part, nearness, nats, view.share(posed.pose))


def drawn(body: Body, faces: Bool, pixels: Float, nearness: Float, size: tuple[int, int]) -> tuple[Int, Float32]:
    """(h, w) visible segment of some faces (F,), −1 for none, and its nearness, see `render.raster.rasterise`."""
    face, image = rasterise(pixels, nearness, body.faces[faces], (0, 0), size)
    return np.append(body.face_part[faces], np.int32(-1))[face], image  # −1 picks the last one


@njit(cache=True, nogil=True)
def window(pixels: Float, size: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
    """The first pixel (x, y) and the size of the part of an image in which pixels (N, 2) are."""
    first, last = np.array(size), np.array([-1, -1])
    for n in range(len(pixels)):
        for k in range(2):
            at = min(max(pixels[n, k], -1.0), float(size[k]))
            first[k], last[k] = min(first[k], int(np.floor(at))), max(last[k], int(np.ceil(at)))
    x, y = max(first[0], 0), max(first[1], 0)
    return (x, y), (max(0, min(last[0] + 1, size[0]) - x), max(0, min(last[1] + 1, size[1]) - y))


def window_reference(pixels: Float, size: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Readable twin of `window`."""
    first = np.clip(np.floor(pixels.min(axis=0)).astype(int), 0, size)
    end = np.clip(np.ceil(pixels.max(axis=0)).astype(int) + 1, first, np.maximum(first, size))
    return (int(first[0]), int(first[1])), (int(end[0] - first[0]), int(end[1] - first[1]))


@njit(cache=True, nogil=True)
def evidence_before(
    maps: Float32, part: Int, nearness: Float32, first: tuple[int, int],
    face: Int, face_nearness: Float32, face_part: Int,
) -> float:  # fmt: skip
    """Evidence (S, H, W) that triangles add to parts (H, W) of some nearness: they hide what is less near.

    Args:
        first: (x, y) pixel of the window (h, w) in which the triangles are.
        face, face_nearness: (h, w) visible triangle, −1 for none, and its nearness.
        face_part: (F,) segment of each triangle.
    """
    total = 0.0
    for i in range(face.shape[0]):
        for j in range(face.shape[1]):
            r, c = first[1] + i, first[0] + j
            if face[i, j] >= 0 and face_nearness[i, j] > nearness[r, c]:
                total += maps[face_part[face[i, j]], r, c]
                if part[r, c] >= 0:
                    total -= maps[part[r, c], r, c]
    return float(total)


def evidence_before_reference(
    maps: Float32, part: Int, nearness: Float32, first: tuple[int, int],
    face: Int, face_nearness: Float32, face_part: Int,
) -> float:  # fmt: skip
    """Readable twin of `evidence_before`."""
    rows, columns = (slice(a, a + n) for a, n in zip(first[::-1], face.shape, strict=True))
    maps, part, nearness = maps[:, rows, columns], part[rows, columns], nearness[rows, columns]
    before = (face >= 0) & (face_nearness > nearness)
    added: Float32 = np.take_along_axis(maps, face_part[face][None], axis=0)[0]
    hidden: Float32 = np.take_along_axis(maps, np.maximum(part, 0)[None], axis=0)[0]
    return float(added[before].sum() - hidden[before & (part >= 0)].sum())
