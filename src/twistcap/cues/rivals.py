"""Rival poses: where a limb is in doubt, the images are asked about the other places where it might be.

A limb that one camera sees moves freely along that camera's rays, and once it has gone astray its contour is no longer
where the image could pull it back. The covariance knows the direction in which it strays, and how far.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from twistcap import se3
from twistcap._typing import Bool, Float, Float32, Int
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Camera
from twistcap.cues.view import View
from twistcap.region.compare import background_moments, label_evidence
from twistcap.render import render


@dataclass(frozen=True)
class RivalRule:
    """When and how rival poses are tried.

    Attributes:
        least_sd: m of uncertainty of a segment's middle from which on it is in doubt.
        memory: share of its doubt that a segment keeps from frame to frame when it suddenly seems certain.
        steps: how far rivals lie off, in standard deviations along the least certain direction.
        margin: nats by which a rival must explain the images better.
        px_per_m: resolution at which images are compared.
        radius: m about a pixel from which its background is gathered.
        floor: least variance of a density, brightness².
        clip: most that one pixel can say, nats.
    """

    least_sd: float = 0.03
    memory: float = 0.9
    steps: tuple[float, ...] = (-2.4, -1.2, 1.2, 2.4)
    margin: float = 10.0
    px_per_m: float = 60.0
    radius: float = 0.1
    floor: float = 4e-4
    clip: float = 3.0

    def along(self, pose: Pose, direction: Float) -> Iterator[Pose]:
        """Poses along a direction (6 + J,), a standard deviation in length."""
        for step in self.steps:
            yield pose.retract(step * direction)

    def judge(self, views: Sequence[View], colours: Sequence[Float], posed: Posed) -> Judge:
        """The judge of rivals of a posed body in views in which its parts have the given colours."""
        scenes = [self._scene(view, known, posed) for view, known in zip(views, colours, strict=True)]
        return Judge(self, posed.body, scenes)

    def _scene(self, view: View, colours: Float, posed: Posed) -> _Scene:
        seen_from = view.camera
        depth = seen_from.T_cam_world[2, :3] @ posed.pose.root[:3, 3] + seen_from.T_cam_world[2, 3]
        factor = min(1.0, self.px_per_m * max(depth, 0.1) / seen_from.K[0, 0])
        camera = seen_from.scaled(factor)
        features = cv2.resize(view.features, camera.size, interpolation=cv2.INTER_AREA).reshape(*camera.size[::-1], -1)
        return _Scene(camera, features, colours, render(posed, camera).part)


@dataclass(frozen=True)
class _Scene:
    """One view, made small: what the present pose explains there as what."""

    camera: Camera
    features: Float32
    colours: Float
    part: Int


@dataclass(frozen=True)
class Judge:
    """Compares rival poses with the present one by what they make of the images."""

    rule: RivalRule
    body: Body
    scenes: Sequence[_Scene]

    def evidence(self, pose: Pose) -> float:
        """Nats by which the views favour a pose over the present one."""
        rival = Posed(self.body, pose)
        return sum(self._compared(scene, render(rival, scene.camera).part) for scene in self.scenes)

    def _compared(self, scene: _Scene, other: Int) -> float:
        rule = self.rule
        radius = max(2, round(rule.radius * rule.px_per_m))
        background = background_moments(scene.features, (scene.part < 0) & (other < 0), radius)
        return label_evidence(scene.features, background, scene.colours, scene.part, other, rule.floor, rule.clip)


def segment_doubts(posed: Posed, covariance: Float) -> tuple[Float, Float]:
    """How uncertain the middle of each segment is: standard deviation (S,) m along its least certain direction, and
    the pose step (S, 6 + J) that is most likely to have moved it so far.
    """
    body = posed.body
    middles = posed.segment_middles
    by_twist = np.concatenate([-se3.hat(middles), np.broadcast_to(np.eye(3), (len(middles), 3, 3))], axis=-1)
    J = by_twist @ posed.projector.reshape(-1, 6, body.dof)
    cross = J @ covariance
    values, vectors = np.linalg.eigh(cross @ J.transpose(0, 2, 1))
    sd = np.sqrt(np.maximum(values[:, -1], 1e-12))
    return sd, np.einsum("sid,si->sd", cross, vectors[:, :, -1]) / sd[:, None]


def doubted_limbs(body: Body, doubt: Float, least: float) -> list[int]:
    """Segments in doubt, the most doubted of each limb: none stands above or below another one of the list."""
    chosen: list[int] = []
    for s in np.argsort(-doubt):
        if doubt[s] < least:
            break
        if not any(_same_limb(body.chain[s], body.chain[t]) for t in chosen):
            chosen.append(int(s))
    return chosen


def _same_limb(one: Bool, other: Bool) -> bool:
    """Whether all coordinates that move one segment move the other one too, or the reverse."""
    return bool(np.all(one <= other) or np.all(other <= one))
