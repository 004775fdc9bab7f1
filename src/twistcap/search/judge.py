"""Which of two poses explains the images better: only the pixels that change hands are asked.

They are asked under the parts' remembered colours and the background around them, in small images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from twistcap.arrays import Bool, Float, Float32, Int
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Camera
from twistcap.cues.view import View
from twistcap.ranges import Checked, Positive
from twistcap.region.compare import BLOCK, background_moments, label_evidence
from twistcap.render import render


@dataclass(frozen=True)
class JudgeRule(Checked):
    """How poses are compared.

    Attributes:
        px_per_m: resolution at which images are compared.
        radius: m about a pixel from which its background is gathered.
        berth: m about either pose within which nothing counts as background.
        floor: least variance of a density, brightness².
        clip: most that one pixel can say, nats.
    """

    px_per_m: Positive = 60.0
    radius: Positive = 0.1
    berth: Positive = 0.05
    floor: Positive = 4e-4
    clip: Positive = 3.0


def judge_of(rule: JudgeRule, views: Sequence[View], colours: Sequence[Float], posed: Posed) -> Judge:
    """The judge against a posed body, in views in which its parts have the given colours (S, 1 + 2C)."""
    return Judge(rule, posed.body, [_scene(rule, v, known, posed) for v, known in zip(views, colours, strict=True)])


@dataclass(frozen=True)
class _Scene:
    """One view, made small: which part of the present pose covers what."""

    camera: Camera
    features: Float32
    colours: Float
    part: Int


def _scene(rule: JudgeRule, view: View, colours: Float, posed: Posed) -> _Scene:
    seen_from = view.camera
    depth = seen_from.T_cam_world[2, :3] @ posed.pose.root[:3, 3] + seen_from.T_cam_world[2, 3]
    camera = seen_from.scaled(min(1.0, rule.px_per_m * max(depth, 0.1) / seen_from.K[0, 0]))
    planes = cv2.split(view.features)  # OpenCV averages four channels at most
    small = [cv2.resize(plane, camera.size, interpolation=cv2.INTER_AREA) for plane in planes]
    features = np.asarray(np.stack(small, axis=2), dtype=np.float32)
    return _Scene(camera, features, colours, render(posed, camera).part)


@dataclass(frozen=True)
class Judge:
    """Compares hypotheses with one pose by what they make of the images: the one judge of all searches."""

    rule: JudgeRule
    body: Body
    scenes: Sequence[_Scene]

    def evidence(self, pose: Pose, arriving: Bool | None = None) -> float:
        """Nats by which the views favour a pose over the present one.

        With `arriving` (S,) only the pixels count that those parts newly cover: what moves out of the way of something
        that hides it is favoured as well, but it arrives nowhere.
        """
        other, total = Posed(self.body, pose), 0.0
        for scene in self.scenes:
            part = render(other, scene.camera).part
            total += self._compared(scene, part if arriving is None else _arrived(scene.part, part, arriving))
        return total

    def _compared(self, scene: _Scene, other: Int) -> float:
        rule = self.rule
        reach = max(1, round(rule.radius * rule.px_per_m / BLOCK))
        body = ((scene.part >= 0) | (other >= 0)).astype(np.uint8)
        size = 2 * max(1, round(rule.berth * rule.px_per_m)) + 1  # a hypothesis may miss the limb by a little
        near = cv2.dilate(body, np.ones((size, size), np.uint8))
        background = background_moments(scene.features, near == 0, scene.part != other, reach)
        return label_evidence(scene.features, background, scene.colours, scene.part, other, rule.floor, rule.clip)


def _arrived(part: Int, other: Int, arriving: Bool) -> Int:
    """The labels `other` (H, W) where those parts newly cover a pixel, else `part`."""
    of = np.append(arriving, False)  # the last is the background, -1
    return np.where(of[other] & ~of[part], other, part).astype(np.int32)


def best_of(judge: Judge, best: Pose, most: float, steps: Sequence[Float]) -> tuple[Pose, float]:
    """The best of a pose of evidence `most` and of those that steps (6 + J,) lead to from it, and its evidence."""
    poses = [best.retract(step).within(judge.body.limits) for step in steps]
    evidence = [judge.evidence(pose) for pose in poses]
    k = int(np.argmax(evidence))
    return (poses[k], evidence[k]) if evidence[k] > most else (best, most)
