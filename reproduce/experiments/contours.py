"""The chapter's two claims about regions, shown again: C-1, coupled against two-step, and C-2, local against global.

Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", Figs. 11.2-11.4. Both arms of a comparison see
the same frames and differ in one thing only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from reproduce.arms import Findings
from reproduce.arrays import AnyArray, Bool, Float
from reproduce.running import Tell
from reproduce.scenes.elsewhere import elsewhere
from reproduce.segment import Evolution, segment
from reproduce.sequence import joint_errors_mm
from twistcap.body import Pose, Posed
from twistcap.camera import Camera, Rig
from twistcap.cues.evidence import Segmentation
from twistcap.cues.levelset import LevelSetContour
from twistcap.cues.view import View
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.evaluate import metrics
from twistcap.evaluate.metrics import Row, row
from twistcap.region.densities import heaviside
from twistcap.region.levelset import signed_distance, zero_crossings
from twistcap.region.models import region_model
from twistcap.render import RenderedView
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import TrackerConfig, track

ARM = ("elbow_r", "elbow_l", "wrist_r", "wrist_l")
COUPLED = TrackerConfig(method="levelset")
COUPLED_SCENE = StudioConfig(views=2, frames=40)
LOCAL = TrackerConfig(channels="grey", statistics="whole", photometric=False)
LOCAL_SCENE = StudioConfig(views=4, frames=30)


@dataclass(frozen=True)
class FreeContour(LevelSetContour):
    """The two-step method: the contour goes on from where it was in the last frame, and the body has no say in it.

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
        model = region_model(self.density or "local", self.rho * seen.px_per_m, self.floor, self.prior_mass, 0.02)
        inside = before if before.all() or not before.any() else segment(view.features, before, model, self.evolution)
        whole[y : y + height, x : x + across] = inside
        phi = signed_distance(inside)
        share = heaviside(phi, 0.7)
        ratio = model.log_ratio(view.features, share, np.float32(1.0) - share, 1.0)
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


@dataclass(frozen=True)
class Run:
    """One tracked sequence.

    Attributes:
        iou: (N,) overlap of the body's silhouette with the true one, mean over the views.
        joints_mm, arms_mm: mean error of all joint centres, and of elbows and wrists.
        lost: whether the sequence counts as lost.
        last: pose of the last frame.
        regions: (H, W) inner region in each camera, where the contour ran free.
    """

    iou: Float
    joints_mm: float
    arms_mm: float
    lost: bool
    last: Pose
    regions: dict[int, Bool]


def run(scene: Capture, frames: Sequence[Frame], config: TrackerConfig) -> Run:
    """Track a scene's frames from its first pose and hold them against the truth."""
    poses = [e.pose for e in track(frames, scene.body, scene.rig, scene.first_pose, config)]
    indices = [frame.index for frame in frames]
    joints = joint_errors_mm(scene, scene.body, poses, indices)
    names = [name for name in metrics.JOINT_CENTRES if name in scene.body.landmarks.names]
    arms = joints[:, [names.index(name) for name in ARM]]
    iou = [
        np.mean([_overlap(scene, p, k, c) for c in range(len(scene.rig))]) for p, k in zip(poses, indices, strict=True)
    ]
    cue = config.levelset
    regions = cue.regions if isinstance(cue, FreeContour) else {}
    joint, arm, lost = metrics.mean_known(joints), metrics.mean_known(arms), metrics.lost_sequence(joints)
    return Run(np.array(iou, dtype=np.float64), joint, arm, lost, poses[-1], regions)


def _overlap(scene: Capture, pose: Pose, index: int, camera: int) -> float:
    return metrics.iou(_silhouette(scene, pose, camera), scene.masks(index)[camera])


def _silhouette(scene: Capture, pose: Pose, camera: int) -> Bool:
    view = scene.rig.pinhole()[camera]
    return metrics.silhouette(view.P, Posed(scene.body, pose).vertices, scene.body.faces, view.size)


def both(
    case: str, seeds: Sequence[int], made: Callable[[int], Capture], arms: Callable[[Capture], Sequence[TrackerConfig]],
    progress: Tell, out: Path | None,
) -> tuple[Sequence[Run], ...]:  # fmt: skip
    """The runs of every arm, one per seed, on the same frames; a picture per seed of the last one, an arm in a row."""
    runs = list[list[Run]]()
    for done, seed in enumerate(seeds, 1):
        scene = made(seed)
        frames = list(scene.frames())
        runs.append([run(scene, frames, config) for config in arms(scene)])
        if out is not None:
            save_picture(out / f"{case}-seed-{seed}.png", scene, frames[-1], runs[-1])
        progress(f"{case}, seed {seed}", done, len(seeds))
    return tuple(zip(*runs, strict=True))


def coupled_against_two_step(seeds: Sequence[int], progress: Tell, out: Path | None = None) -> list[Row]:
    """C-1: the contour held by the body's shape in every frame, and the contour that evolves freely.

    The pose of two-step is fitted to its contour and to nothing else: brightness constancy would tie it to the images
    without the contour. So it is held against coupling without brightness; the tracker as it is is run beside.

    Args:
        seeds: of the studio.
        progress: is told each time a seed is done.
        out: folder for a picture per seed: the last frame; the tracker as it is, by contours alone, two-step.
    """
    alone = replace(COUPLED, photometric=False)

    def arms(scene: Capture) -> Sequence[TrackerConfig]:
        return COUPLED, alone, replace(alone, levelset=FreeContour(rig=scene.rig))

    coupled, contours, free = both(
        "C-1", seeds, lambda seed: capture(replace(COUPLED_SCENE, seed=seed)), arms, progress, out
    )
    gaps = [float(a.iou.mean() - b.iou.mean()) for a, b in zip(contours, free, strict=True)]
    worse = [float(b.lost or gap >= 0.1) for b, gap in zip(free, gaps, strict=True)]
    return [
        *_rows("C-1 coupled", coupled, at_most_lost=0.0),
        *_rows("C-1 coupled, contours alone", contours),
        *_rows("C-1 two-step", free),
        row("C-1", "IoU, contours alone less two-step", float(np.mean(gaps)), "share", seeds=gaps),
        row(
            "C-1", "two-step lost, or worse by 0.1", sum(worse), "sequences", at_least=len(seeds) // 2 + 1, seeds=worse
        ),
    ]


def local_against_global(seeds: Sequence[int], progress: Tell, out: Path | None = None) -> list[Row]:
    """C-2: local Gaussians against one Parzen density of the body and one of the background, of the whole body in both.

    The contours of the direct method alone, before a room whose floor has the colour of the bare arms (`elsewhere`).

    Args:
        seeds, progress: as above.
        out: folder for a picture per seed: the last frame, local above, global below.
    """

    def arms(_: Capture) -> Sequence[TrackerConfig]:
        return replace(LOCAL, density="local"), replace(LOCAL, density="parzen")

    local, whole = both("C-2", seeds, lambda seed: elsewhere(replace(LOCAL_SCENE, seed=seed)), arms, progress, out)
    shares = [a.arms_mm / b.arms_mm for a, b in zip(local, whole, strict=True)]
    ratio = float(np.mean([a.arms_mm for a in local]) / np.mean([b.arms_mm for b in whole]))
    return [
        *_rows("C-2 local", local),
        *_rows("C-2 global Parzen", whole),
        row("C-2", "arm error, local to global", ratio, "ratio", at_most=0.5, seeds=shares),
    ]


def _rows(case: str, runs: Sequence[Run], at_most_lost: float | None = None) -> list[Row]:
    """Overlap, errors and losses of one arm."""
    iou, joints = [float(r.iou.mean()) for r in runs], [r.joints_mm for r in runs]
    arms, lost = [r.arms_mm for r in runs], [float(r.lost) for r in runs]
    return [
        row(case, "IoU", float(np.mean(iou)), "share", seeds=iou),
        row(case, "joints", float(np.mean(joints)), "mm", seeds=joints),
        row(case, "arms", float(np.mean(arms)), "mm", seeds=arms),
        row(case, "lost sequences", sum(lost), "sequences", at_most=at_most_lost, seeds=lost, lost=int(sum(lost))),
    ]


def save_picture(path: Path, scene: Capture, frame: Frame, runs: Sequence[Run]) -> None:
    """A row for each run, a column for each view: true outline white, body green, free contour red.

    Raises:
        InputError: if the picture cannot be written.
    """
    rows = [np.hstack([_drawn(scene, frame, camera, r) for camera in range(len(scene.rig))]) for r in runs]
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), np.vstack(rows)[..., ::-1]):
        raise InputError(f"{path} cannot be written; choose another folder.")


def _drawn(scene: Capture, frame: Frame, camera: int, result: Run, zoom: int = 2) -> AnyArray:
    """One view (H, W, 3) RGB."""
    image = frame.images[camera]
    width, height = scene.rig[camera].size
    if image is None:
        return np.zeros((zoom * height, zoom * width, 3), np.uint8)
    colour = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    canvas = cv2.resize(colour, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_LINEAR)
    layers = [
        (scene.masks(frame.index)[camera], (255, 255, 255)),
        (_silhouette(scene, result.last, camera), (0, 255, 0)),
    ]
    if camera in result.regions:
        layers.append((result.regions[camera], (255, 0, 0)))
    for mask, rgb in layers:
        large = cv2.resize(mask.astype(np.uint8), None, fx=zoom, fy=zoom, interpolation=cv2.INTER_NEAREST)
        outline, _ = cv2.findContours(large, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(canvas, outline, -1, rgb, 1)
    return canvas


@dataclass(frozen=True)
class Claim:
    """An `Experiment` that draws its own pictures: C-1 or C-2."""

    id: str
    says: str
    measured: Callable[[Sequence[int], Tell, Path | None], list[Row]]

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """The claim's rows; its pictures, one per seed, go into the folder `out`."""
        return Findings(self.measured(seeds, progress, out), "", ())


C1 = Claim(
    "C-1",
    "contour and pose coupled, against a contour that evolves freely and a pose fitted to it: two views, clutter",
    coupled_against_two_step,
)
C2 = Claim(
    "C-2",
    "local Gaussians against one Parzen density of the body and one of the background: arms with the floor's colour",
    local_against_global,
)
