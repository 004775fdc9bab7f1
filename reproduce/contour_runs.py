"""What C-1 and C-2 share: both arms of a comparison see the same frames; overlap, errors, and a picture per seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from reproduce.arms import Findings
from reproduce.running import Tell
from reproduce.sequence import joint_errors_mm
from twistcap.arrays import AnyArray, Bool, Float
from twistcap.body import Pose, Posed
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.evaluate import Row, metrics, row
from twistcap.hindsight import tracked
from twistcap.studio import Capture
from twistcap.track import Model

ARM = ("elbow_r", "elbow_l", "wrist_r", "wrist_l")


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


def run(scene: Capture, frames: Sequence[Frame], model: Model) -> Run:
    """Track a scene's frames from its first pose and hold them against the truth."""
    poses = [e.pose for e in tracked(frames, model, scene.first_pose)]
    indices = [frame.index for frame in frames]
    joints = joint_errors_mm(scene, scene.body, poses, indices)
    names = [name for name in metrics.JOINT_CENTRES if name in scene.body.landmarks.names]
    arms = joints[:, [names.index(name) for name in ARM]]
    iou = [
        np.mean([_overlap(scene, p, k, c) for c in range(len(scene.rig))]) for p, k in zip(poses, indices, strict=True)
    ]
    regions: dict[int, Bool] = getattr(model.cues[0], "regions", {})
    joint, arm, lost = metrics.mean_known(joints), metrics.mean_known(arms), metrics.lost_sequence(joints)
    return Run(np.array(iou, dtype=np.float64), joint, arm, lost, poses[-1], regions)


def _overlap(scene: Capture, pose: Pose, index: int, camera: int) -> float:
    return metrics.iou(_silhouette(scene, pose, camera), scene.masks(index)[camera])


def _silhouette(scene: Capture, pose: Pose, camera: int) -> Bool:
    view = scene.rig.pinhole()[camera]
    return metrics.silhouette(view.P, Posed(scene.body, pose).vertices, scene.body.faces, view.size)


def both(
    case: str, seeds: Sequence[int], made: Callable[[int], Capture], arms: Callable[[Capture], Sequence[Model]],
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


def arm_rows(case: str, runs: Sequence[Run], at_most_lost: float | None = None) -> list[Row]:
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
    """An `Experiment` that draws its own pictures."""

    id: str
    says: str
    measured: Callable[[Sequence[int], Tell, Path | None], list[Row]]

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """The claim's rows; its pictures, one per seed, go into the folder `out`."""
        return Findings(self.measured(seeds, progress, out), "", ())
