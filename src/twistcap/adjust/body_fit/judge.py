"""Agreement of a body with a recording: distances to edges, overlap with a segmentation and of visual hulls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twistcap.adjust.body_fit.observe import MARGIN, cropped, observe
from twistcap.arrays import AnyArray, Bool, Float
from twistcap.body import Body, Pose, Posed
from twistcap.body.model import unsided
from twistcap.camera import Camera, Rig
from twistcap.cues.levelset import LevelSetContour
from twistcap.estimate import Frame
from twistcap.region.compare import iou
from twistcap.render import render, visible_contour

_CLEAR = 1.0  # 1/px²: information from which an edge counts as seen
_VOXEL = 0.02  # m


@dataclass(frozen=True)
class Agreement:
    """Of one body with one recording, over the frames of the fit.

    `px` and `mm` (N,) are distances from points of the silhouettes, on segments `part`, to clear edges in the images;
    `iou` is the mean overlap with the tracker's own segmentation, `hull` that of the visual hulls, as volumes.
    """

    px: Float
    mm: Float
    part: Sequence[str]
    iou: float
    hull: float

    def by_part(self) -> dict[str, tuple[float, float]]:
        """Mean and 95th percentile, mm, of each kind of segment that is seen."""
        kinds = np.array(list(map(unsided, self.part)))
        own = {str(kind): self.mm[kinds == kind] for kind in dict.fromkeys(kinds.tolist())}
        return {kind: (float(mm.mean()), float(np.percentile(mm, 95))) for kind, mm in own.items()}


def agreement(body: Body, rig: Rig, frames: Mapping[int, Frame], poses: Mapping[int, Pose]) -> Agreement:
    """Agreement in the frames, by number, that have a pose, with the images alone: given silhouettes do not count."""
    px, mm, part, ious, hulls = list[Float](), list[Float](), list[str](), list[float](), list[float]()
    for index, pose in poses.items():
        images, posed = frames[index].images, Posed(body, pose)
        for seen in observe(images, rig, posed):
            clear = seen.contour.outer & (seen.weight > _CLEAR)
            px.append(np.abs(seen.distance[clear]))
            mm.append(1000.0 * px[-1] / max(seen.px_per_m, 1e-9))
            part += [body.segment_names[s] for s in seen.contour.part[clear]]
        pairs = _segmented(images, rig, posed)
        ious += [iou(ours, theirs) for _, ours, theirs in pairs]
        hulls.append(hull_overlap(posed, pairs))
    return Agreement(np.concatenate(px), np.concatenate(mm), part, float(np.mean(ious)), float(np.mean(hulls)))


def _segmented(images: Sequence[AnyArray | None], rig: Rig, posed: Posed) -> list[tuple[Camera, Bool, Bool]]:
    """Of each view the camera of its crop, the silhouette of the body and that of the level set."""
    out: list[tuple[Camera, Bool, Bool]] = []
    for view in cropped(images, rig, posed):
        seen = render(posed, view.camera)
        nothing = np.zeros((len(posed.body.segment_names), 1 + 2 * view.features.shape[2]))
        kept, cue = dict[str, Any](), LevelSetContour()
        cue.locate(view, seen, visible_contour(seen), 1.0, nothing, kept)
        out.append((view.camera, seen.mask, kept[cue.name].phi > 0))
    return out


def hull_overlap(posed: Posed, views: Sequence[tuple[Camera, Bool, Bool]]) -> float:
    """Intersection over union of the visual hulls of two sets of silhouettes, voxels of 2 cm about the body."""
    low, high = posed.vertices.min(axis=0) - MARGIN, posed.vertices.max(axis=0) + MARGIN
    axes = [np.arange(a, b, _VOXEL) for a, b in zip(low, high, strict=True)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    ours, theirs = np.ones(len(centres), bool), np.ones(len(centres), bool)
    for camera, a, b in views:
        ours &= inside_silhouette(camera.P, centres, a)
        theirs &= inside_silhouette(camera.P, centres, b)
    return iou(ours, theirs)


def inside_silhouette(P: Float, points: Float, mask: Bool) -> Bool:
    """(N,) whether points (N, 3) are seen inside a silhouette (H, W)."""
    h = points @ P[:, :3].T + P[:, 3]
    pixel = np.rint(h[:, :2] / np.maximum(h[:, 2:], 1e-9)).astype(np.int64)
    inside = (h[:, 2] > 0) & np.all((pixel >= 0) & (pixel < mask.shape[::-1]), axis=1)
    x, y = np.where(inside[:, None], pixel, 0).T
    return inside & mask[y, x]
