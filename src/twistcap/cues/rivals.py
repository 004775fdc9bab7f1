"""Rival poses: where a limb is in doubt, the images are asked about the other places where it might be.

A limb that one camera sees moves freely along that camera's rays, and once it has gone astray its contour is no longer
where the image could pull it back. The covariance knows the direction in which it strays, and how far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from twistcap import se3
from twistcap._typing import Bool, Float, Float32, Int
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Camera
from twistcap.cues.view import View
from twistcap.region.compare import BLOCK, background_moments, label_evidence
from twistcap.render import render


@dataclass(frozen=True)
class RivalRule:
    """When and how rival poses are tried.

    A jump must be worth its risk. Neighbouring pixels err together, by texture, by shading and where the body is not
    quite the person's: between poses that both cover a limb the evidence wavers by some 13 nats, and dozens of rivals
    are tried in a second. A clear preference is three of those deviations, and the next frame must share it: where
    clutter feigns a limb it seldom does so from two poses. Rivals reach far in return: a limb goes farther astray than
    its covariance says.

    Attributes:
        least_sd: m of uncertainty of a segment's middle from which on it is in doubt.
        memory: share of its doubt that a segment keeps from frame to frame when it suddenly seems certain.
        steps: how far rivals lie off, in standard deviations along the least certain direction.
        every: rivals are tried in every so many frames, of one limb after the other.
        promising: nats from which on a rival is fitted to the images, which it may miss by little yet.
        margin: nats by which a rival, fitted or not, must explain the images better, in this frame and in the next.
        px_per_m: resolution at which images are compared.
        radius: m about a pixel from which its background is gathered.
        berth: m about either pose within which nothing counts as background.
        floor: least variance of a density, brightness².
        clip: most that one pixel can say, nats.
    """

    least_sd: float = 0.015
    memory: float = 0.9
    steps: tuple[float, ...] = (-4.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.0)
    every: int = 3
    promising: float = 0.0
    margin: float = 40.0
    px_per_m: float = 60.0
    radius: float = 0.1
    berth: float = 0.05
    floor: float = 4e-4
    clip: float = 3.0


class Rivals:
    """Remembers which limbs are in doubt, proposes where else they might be, one limb at a time, and judges."""

    def __init__(self, body: Body, rule: RivalRule) -> None:
        self._body, self._rule = body, rule
        self._doubt = np.zeros(len(body.segment_names))
        self._frame = 0
        self._preferred: Float | None = None  # step to the rival that the last frame preferred
        self._again = False  # whether this frame is asked about it

    def poses(self, posed: Posed, covariance: Float, shown: Float | float = 1.0) -> list[Pose]:
        """Rivals of a pose of this covariance (6 + J, 6 + J); most often there are none. To be asked in every frame.

        `shown` (S,) in [0, 1] says how far each segment is in sight: the images cannot judge what they do not show.
        """
        rule = self._rule
        self._frame += 1
        preferred, self._preferred = self._preferred, None
        self._again = preferred is not None
        if preferred is not None:
            return [posed.pose.retract(preferred)]
        if self._frame % rule.every:
            return []
        sd, directions = segment_doubts(posed, covariance)
        self._doubt = shown * np.maximum(sd, rule.memory**rule.every * self._doubt)
        limbs = doubted_limbs(self._body, self._doubt, rule.least_sd)
        if not limbs:
            return []
        s = limbs[self._frame // rule.every % len(limbs)]
        direction = directions[s] * self._doubt[s] / sd[s]
        return [posed.pose.retract(step * direction) for step in rule.steps]

    def takes_over(self, posed: Posed, rival: Pose, evidence: float) -> bool:
        """Whether a rival of this evidence takes over from a posed body: two frames must prefer it clearly."""
        if evidence <= self._rule.margin:
            return False
        if not self._again:
            self._preferred = rival.minus(posed.pose)
        return self._again

    def judge(self, views: Sequence[View], colours: Sequence[Float], posed: Posed) -> Judge:
        """The judge of rivals of a posed body in views in which its parts have the given colours."""
        scenes = [_scene(self._rule, view, known, posed) for view, known in zip(views, colours, strict=True)]
        return Judge(self._rule, self._body, scenes)


@dataclass(frozen=True)
class _Scene:
    """One view, made small: what the present pose explains there as what."""

    camera: Camera
    features: Float32
    colours: Float
    part: Int


def _scene(rule: RivalRule, view: View, colours: Float, posed: Posed) -> _Scene:
    seen_from = view.camera
    depth = seen_from.T_cam_world[2, :3] @ posed.pose.root[:3, 3] + seen_from.T_cam_world[2, 3]
    camera = seen_from.scaled(min(1.0, rule.px_per_m * max(depth, 0.1) / seen_from.K[0, 0]))
    planes = cv2.split(view.features)  # OpenCV averages four channels at most
    small = [cv2.resize(plane, camera.size, interpolation=cv2.INTER_AREA) for plane in planes]
    features = np.asarray(np.stack(small, axis=2), dtype=np.float32)
    return _Scene(camera, features, colours, render(posed, camera).part)


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
        reach = max(1, round(rule.radius * rule.px_per_m / BLOCK))
        body = ((scene.part >= 0) | (other >= 0)).astype(np.uint8)
        size = 2 * max(1, round(rule.berth * rule.px_per_m)) + 1  # a rival may miss the limb by a little
        near = cv2.dilate(body, np.ones((size, size), np.uint8))
        background = background_moments(scene.features, near == 0, reach)
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
