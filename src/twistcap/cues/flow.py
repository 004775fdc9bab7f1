"""The flow cue: where optic flow takes the surface points that the last frame showed, the pose is expected to follow.

Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", section 11.4: pixels of the body carry known
3D points, their flow gives the pixels of the same points in the next frame, and the pose system does the rest. Errors
do not build up, since the contours correct every frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap._typing import AnyArray, Float
from twistcap.body import Pose, Posed
from twistcap.camera import Rig
from twistcap.cues.view import View, crop_views
from twistcap.features import Channels
from twistcap.flow import Preset, flow_confidence, moved_mask, optical_flow
from twistcap.render import RenderedView, render
from twistcap.solve import PoseProblem, minimise
from twistcap.terms import GaussianTerm, KeypointTerm, LimitTerm


@dataclass(frozen=True)
class Followed:
    """The last frame that was tracked on images: its pose, its time (s) and its images, one per camera or None."""

    posed: Posed
    time: float
    images: Sequence[AnyArray | None]


@dataclass(frozen=True)
class FlowCue:
    """Settings of the flow cue; lengths in metres are on the body.

    Attributes:
        preset: of `optical_flow`.
        points: how many pixels of the body are followed in each view.
        margin: m about the body in which it is looked for in the next frame.
        sigma: noise of a flow vector, px.
        share: share of the points' information that counts (neighbours move alike, and err alike).
        robust: m by which a point may disagree before it begins to lose its say.
        loosened: factors on `robust` of one solve after the other: a point that a limb has left far behind must count
            at first.
        channels: what flow looks at.
        least_confidence: how well the flow back must undo a vector that has a say.
        least_share: share of all points with a say below which the flow as a whole is not believed.
    """

    preset: Preset = "fast"
    points: int = 500
    margin: float = 0.3
    sigma: float = 1.0
    share: float = 0.3
    robust: float = 0.02
    loosened: tuple[float, ...] = (30.0, 8.0, 2.0)
    channels: Channels = "lab"
    least_confidence: float = 0.6
    least_share: float = 0.3

    def predict(
        self, last: Followed, images: Sequence[AnyArray | None], rig: Rig, guess: Pose, information: Float
    ) -> Pose | None:
        """The pose to which flow leads from the last frame; None where too little of it can be believed.

        Args:
            last: that frame.
            images: the present ones, one per camera of the (pinhole) `rig`, None where it has none.
            guess: what is expected without flow, with that `information` (6 + J, 6 + J); all that hidden limbs follow.
        """
        found: list[tuple[KeypointTerm, float]] = []
        for camera, before, after in zip(rig, last.images, images, strict=True):
            if before is None or after is None:
                continue
            views = crop_views((before, after), camera, last.posed, self.margin, self.channels)
            seen = render(last.posed, views[0].camera) if views else None
            if seen is not None and seen.mask.any():
                found.append(self.term(views[0], views[1], seen))
        if not found or np.mean([share for _, share in found]) < self.least_share:
            return None
        posed = Posed(last.posed.body, guess)
        for loosened in self.loosened:
            terms = [replace(term, scale_px=loosened * term.scale_px) for term, _ in found]
            solved = minimise(PoseProblem([LimitTerm(), GaussianTerm(guess, information), *terms]), posed, steps=8)
            if solved.status == "failed":
                return None
            posed = solved.x
        return posed.pose

    def term(self, before: View, after: View, seen: RenderedView) -> tuple[KeypointTerm, float]:
        """The surface points of one view where flow takes them, and the share of them that have a say.

        Args:
            before, after: one window of the last image and of the present one.
            seen: the body at its last pose, rendered in that window; some of it must be in sight.
        """
        mask = seen.mask
        forward = optical_flow(before.features, after.features, mask=mask, preset=self.preset)
        arrived = moved_mask(mask, forward)
        if not arrived.any():
            arrived = mask
        backward = optical_flow(after.features, before.features, mask=arrived, preset=self.preset)
        stride = max(1, round(math.sqrt(np.count_nonzero(mask) / self.points)))
        rows, columns = (stride * i.astype(np.int32) for i in np.nonzero(mask[::stride, ::stride]))
        confidence = flow_confidence(forward, backward)[rows, columns].astype(np.float64)
        believed = confidence >= self.least_confidence
        target = np.stack([columns, rows], axis=1) + forward[rows, columns].astype(np.float64)
        weight = np.where(believed, confidence, 0.0) * (self.share / self.sigma**2)
        points = seen.surface_points(rows, columns)
        term = KeypointTerm(before.camera.P, points, target, weight, self.robust * seen.px_per_m, name="flow")
        return term, float(believed.mean())
