"""C-1: contour and pose coupled, against the two steps of a contour that evolves freely and a pose fitted to it.

Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", Figs. 11.2 and 11.3.

    python -m reproduce C-1 --seeds 0-7 --out out/C-1
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from reproduce.contour_runs import Claim, arm_rows, both
from reproduce.running import Tell
from reproduce.segment import Evolution, segment
from twistcap.arrays import Bool
from twistcap.build import build
from twistcap.camera import Camera, Rig
from twistcap.cues.contour import Segmentation
from twistcap.cues.levelset import LevelSetContour
from twistcap.cues.view import View
from twistcap.errors import InputError
from twistcap.evaluate import Row, row
from twistcap.region.densities import heaviside
from twistcap.region.levelset import signed_distance, zero_crossings
from twistcap.region.models import RegionModel
from twistcap.render import RenderedView
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Model, Settings

SCENE = StudioConfig(views=2, frames=40)
COUPLED = Settings(method="levelset")
ALONE = Settings(method="levelset", brightness=False)


def two_step(scene: Capture) -> Model:
    """The tracker whose contour evolves without the body."""
    return build(scene.body, scene.rig, ALONE).with_cue(FreeContour(rig=scene.rig))


@dataclass(frozen=True)
class FreeContour(LevelSetContour):
    """The two-step method: the contour goes on from where it was in the last frame, without the body.

    Attributes:
        rig: the tracker's cameras, uncropped.
        evolution: of the contour, in each frame.
        regions: (H, W) the inner region in each camera, as it is carried on; filled in as frames come.
    """

    rig: Rig | None = None
    evolution: Evolution = field(default_factory=lambda: Evolution(rounds=4, steps=3, tau=2.4, nu=2.0))
    regions: dict[int, Bool] = field(default_factory=dict)
    _seen: dict[int, tuple[View, Segmentation]] = field(default_factory=dict, repr=False)

    def _segmented(self, view: View, seen: RenderedView, width: float) -> Segmentation:
        """Segment each view once; its alternations all match the same contour."""
        index, (x, y) = self._camera(view.camera)
        known = self._seen.get(index)
        if known is not None and known[0] is view:
            return replace(known[1], width=width)
        height, across = seen.mask.shape
        whole = self.regions.setdefault(index, _on_canvas(seen.mask, (x, y), self._size(index)))
        before = whole[y : y + height, x : x + across]
        model = RegionModel(self.density or "local", self.rho * seen.px_per_m, self.floor, self.prior_mass, 0.02)
        inside = before if before.all() or not before.any() else segment(view.features, before, model, self.evolution)
        whole[y : y + height, x : x + across] = inside
        phi = signed_distance(inside)
        inner = heaviside(phi, 0.7)
        ratio = model.log_ratio(view.features, inner, np.float32(1.0) - inner, 1.0)
        found = Segmentation(*zero_crossings(phi), np.clip(ratio, -self.clip, self.clip), width, phi)
        self._seen[index] = (view, found)
        return found

    def _camera(self, cropped: Camera) -> tuple[int, tuple[int, int]]:
        """Which camera a crop is of, and the crop's origin (x, y) in it."""
        cameras = [] if self.rig is None else list(self.rig.pinhole())
        for k, camera in enumerate(cameras):
            if np.array_equal(camera.T_cam_world, cropped.T_cam_world):
                x, y = np.round(camera.K[:2, 2] - cropped.K[:2, 2]).astype(int)
                return k, (int(x), int(y))
        raise InputError("two-step: a view is of no camera of the rig; give the tracker's own rig.")

    def _size(self, index: int) -> tuple[int, int]:
        assert self.rig is not None
        return self.rig[index].size


def _on_canvas(mask: Bool, origin: tuple[int, int], size: tuple[int, int]) -> Bool:
    """The mask of a crop (h, w) in its whole image of (width, height)."""
    out = np.zeros(size[::-1], dtype=np.bool_)
    out[origin[1] : origin[1] + mask.shape[0], origin[0] : origin[0] + mask.shape[1]] = mask
    return out


def coupled_against_two_step(seeds: Sequence[int], progress: Tell, out: Path | None = None) -> list[Row]:
    """C-1: the contour held by the body's shape in every frame, and the contour that evolves freely.

    The pose of two-step is fitted to its contour and to nothing else: brightness constancy would tie it to the images
    without the contour. So it is held against coupling without brightness; the tracker as it is is run beside.

    Args:
        seeds: of the studio.
        progress: is called each time a seed is done.
        out: folder for a picture per seed: the last frame; the tracker as it is, by contours alone, two-step.
    """

    def arms(scene: Capture) -> Sequence[Model]:
        coupled, alone = (build(scene.body, scene.rig, settings) for settings in (COUPLED, ALONE))
        return coupled, alone, two_step(scene)

    coupled, contours, free = both("C-1", seeds, lambda seed: capture(replace(SCENE, seed=seed)), arms, progress, out)
    gaps = [float(a.iou.mean() - b.iou.mean()) for a, b in zip(contours, free, strict=True)]
    worse = [float(b.lost or gap >= 0.1) for b, gap in zip(free, gaps, strict=True)]
    return [
        *arm_rows("C-1 coupled", coupled, at_most_lost=0.0),
        *arm_rows("C-1 coupled, contours alone", contours),
        *arm_rows("C-1 two-step", free),
        row("C-1", "IoU, contours alone less two-step", float(np.mean(gaps)), "share", seeds=gaps),
        row(
            "C-1", "two-step lost, or worse by 0.1", sum(worse), "sequences", at_least=len(seeds) // 2 + 1, seeds=worse
        ),
    ]


C1 = Claim(
    "C-1",
    "contour and pose coupled, against a contour that evolves freely and a pose fitted to it: two views, clutter",
    coupled_against_two_step,
)
