"""A take tracked: what was true and what the tracker said, frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from reproduce.faults.kinds import kind_named, kind_of, take_of
from reproduce.faults.take import NONE, Take, landmarks_in_images
from twistcap.arrays import Bool, Float, Int
from twistcap.body import Body, Pose, Posed
from twistcap.build import build
from twistcap.camera import Rig
from twistcap.estimate import UNSEEN, Estimate
from twistcap.evaluate.metrics import JOINT_CENTRES, LOST_FRAME_MM
from twistcap.hindsight import Hindsight
from twistcap.track import Model, Tracker

PARTS: dict[str, tuple[str, ...]] = {
    "arm_r": ("elbow_r", "wrist_r"),
    "arm_l": ("elbow_l", "wrist_l"),
    "leg_r": ("knee_r", "ankle_r"),
    "leg_l": ("knee_l", "ankle_l"),
    "trunk": ("hip_r", "hip_l", "shoulder_r", "shoulder_l", "neck", "head_top"),
}
"""The landmarks by which each part is right or lost; the trunk has the head."""
_SEGMENTS = {"arm": ("humerus", "ulna", "radius", "hand"), "leg": ("femur", "tibia", "foot")}

_INFINITE = ("error_mm", "mean_mm", "parts_mm")  # where they are not finite, they are infinite
_REAL = (*_INFINITE, "support", "parts_support", "probability")

ModelOf = Callable[[Body, Rig], Model]


@dataclass(frozen=True)
class Run:
    """One take and its track; arrays are by frame (N).

    Attributes:
        seed, kind, motion, views, fps, span: of the take.
        error_mm, mean_mm: largest and mean error of the joint centres.
        parts_mm: (N, P) largest error in each of `PARTS`.
        absent: the person is in no image that arrives.
        in_images: (N, P) in how many pictures each part's landmarks lie; the least of them.
        images: number that arrive.
        lost, status, support: as the tracker says.
        parts_support: (N, P) least support of each part's segments; NaN where the tracker keeps none.
        probability: of being lost, as the tracker says; NaN where it says none.
        unjudged: (N, P) parts that the tracker does not judge, because a segment of theirs is in no image.
        exception: what the tracker raised; it ends the track, whose last answer stands for all frames after it.
    """

    seed: int
    kind: str
    motion: str
    views: int
    fps: float
    span: tuple[int, int | None]
    error_mm: Float
    mean_mm: Float
    parts_mm: Float
    absent: Bool
    in_images: Int
    images: Int
    lost: Bool
    status: tuple[str, ...]
    support: Float
    parts_support: Float
    probability: Float
    unjudged: Bool
    exception: str | None = None

    @property
    def truly_lost(self) -> Bool:
        """(N,) frames with a joint more than 150 mm off."""
        return self.error_mm > LOST_FRAME_MM

    @property
    def flagged(self) -> Bool:
        """(N,) frames in which the tracker says that it is lost, or, where nobody is in sight, sees nothing."""
        return self.lost | (self.absent & np.array([status in UNSEEN for status in self.status]))

    @property
    def truly_judged_lost(self) -> Bool:
        """(N,) frames in which a part is lost that the tracker judges."""
        lost = self.parts_mm > LOST_FRAME_MM
        return self.truly_lost & ~(lost.any(axis=1) & (self.unjudged | ~lost).all(axis=1))

    def document(self) -> dict[str, Any]:
        """It for a JSON file; what is not finite is None."""
        return {"parts": list(PARTS), **{f.name: _plain(getattr(self, f.name)) for f in fields(self)}}

    @staticmethod
    def of(document: Mapping[str, Any]) -> Run:
        """The run of such a document."""
        values: dict[str, Any] = {f.name: document[f.name] for f in fields(Run)}
        for name in _REAL:
            values[name] = np.array(values[name], float)
        for name in _INFINITE:
            values[name] = np.where(np.isnan(values[name]), np.inf, values[name])
        for name in ("absent", "in_images", "images", "lost", "unjudged"):
            values[name] = np.array(values[name], np.int32 if "images" in name else np.bool_)
        values["span"], values["status"] = tuple(values["span"]), tuple(values["status"])
        return Run(**values)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | tuple):
        return [_plain(item) for item in value]
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and not np.isfinite(value) else value


def run_seed(seed: int, model_of: ModelOf = build, kind: str | None = None) -> Run:
    """Film and track the take of a seed.

    Args:
        seed: of the take.
        model_of: makes the model from body and cameras.
        kind: of the fault, by name; the seed's own by default.
    """
    return tracked(take_of(seed, kind_of(seed) if kind is None else kind_named(kind)), model_of)


def tracked(take: Take, model_of: ModelOf = build) -> Run:
    """A take tracked by a model."""
    scene = take.scene
    estimates, supports, exception = _answers(take, model_of(scene.body, scene.rig))
    poses = [e.pose for e in estimates]
    joints = errors_mm(take, poses, JOINT_CENTRES)
    return Run(
        scene.config.seed, take.kind, take.motion, take.views, scene.config.fps, take.span,
        joints.max(axis=1), joints.mean(axis=1),
        np.stack([errors_mm(take, poses, names).max(axis=1) for names in PARTS.values()], axis=1),
        take.absent, _in_images(take), np.count_nonzero(take.source[..., 0] != NONE, axis=1),
        np.array([e.lost for e in estimates]), tuple(e.status for e in estimates),
        np.array([e.support for e in estimates]), np.stack(supports),
        np.array([e.probability for e in estimates]),
        np.stack([_unjudged(scene.body, e.part_probability) for e in estimates]), exception,
    )  # fmt: skip


def _answers(take: Take, model: Model) -> tuple[list[Estimate], list[Float], str | None]:
    """An estimate of every frame, the parts' support (P,) in each, and what the tracker raised."""
    tracker = Tracker(model)
    tracker.start(take.first_pose)
    hindsight, estimates, supports = Hindsight(tracker), list[Estimate](), list[Float]()
    for frame in take.frames():
        try:
            corrected, estimate = hindsight.step(frame)
            estimates[len(estimates) - len(corrected) :] = [*corrected, estimate]
        except Exception as error:  # the bench counts them
            missing = take.count - len(estimates)
            last = estimates[-1] if estimates else _nothing(take)
            return (
                estimates + [last] * missing,
                supports + [parts_support(take.scene.body, None)] * missing,
                repr(error),
            )
        supports.append(parts_support(take.scene.body, getattr(tracker.state, "support", None)))
    return estimates, supports, None


def _nothing(take: Take) -> Estimate:
    """The first pose as an answer."""
    return Estimate(0, 0.0, take.first_pose, np.zeros((take.scene.body.dof,) * 2), status="exception")


def errors_mm(take: Take, poses: list[Pose], names: tuple[str, ...]) -> Float:
    """(N, L) distances of landmarks from their true places; a pose that is not finite is infinitely off."""
    scene = take.scene
    ours, theirs = ([b.landmarks.index(name) for name in names] for b in (scene.body, scene.true_body))
    found = np.stack([Posed(scene.body, pose).landmarks[ours] for pose in poses])
    away = 1000.0 * np.linalg.norm(found - scene.landmarks[: len(found), theirs], axis=-1)
    return np.where(np.isfinite(away), away, np.inf)


def _in_images(take: Take) -> Int:
    scene, names = take.scene, take.scene.true_body.landmarks
    counts = np.stack([landmarks_in_images(points, scene.true_rig) for points in scene.landmarks[: take.count]])
    return np.stack([counts[:, [names.index(n) for n in part]].min(axis=1) for part in PARTS.values()], axis=1)


def parts_support(body: Body, support: Float | None) -> Float:
    """(P,) least support of the segments of each of `PARTS`, from that of all segments (S,)."""
    if support is None:
        return np.full(len(PARTS), np.nan)
    part_of = [_part_of(name) for name in body.segment_names]
    return np.array([min(s for s, p in zip(support, part_of, strict=True) if p == part) for part in PARTS])


def _unjudged(body: Body, probability: Float | None) -> Bool:
    """(P,) parts that are not judged, by the probabilities (S,); none where no body was seen."""
    known = np.zeros(len(body.segment_names)) if probability is None else probability
    hidden = {_part_of(name) for name, p in zip(body.segment_names, known, strict=True) if np.isnan(p)}
    return np.array([part in hidden for part in PARTS])


def _part_of(segment: str) -> str:
    for part, names in _SEGMENTS.items():
        if segment.startswith(names):
            return f"{part}_{segment[-1]}"
    return "trunk"
