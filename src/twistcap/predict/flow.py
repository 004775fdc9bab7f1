"""Prediction by optic flow: the pose is expected to follow the surface points that the last frame showed.

Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", section 11.4: pixels of the body carry known
3D points, their flow gives the pixels of the same points in the next frame, and the pose system does the rest. Errors
do not build up, since the contours correct every frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twistcap.arrays import AnyArray, Float
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Camera, Rig
from twistcap.cues.observation import Fit
from twistcap.cues.view import View, view_window
from twistcap.estimate import Frame
from twistcap.features import Channels
from twistcap.flow import Preset, flow_confidence, moved_mask, optical_flow
from twistcap.predict import Prediction
from twistcap.predict.history import Past
from twistcap.predict.inertia import Inertia
from twistcap.ranges import Checked, Count, Positive, Share
from twistcap.render import RenderedView, render
from twistcap.solve import PoseProblem, minimise
from twistcap.stages import stage
from twistcap.terms import GaussianTerm, KeypointTerm, LimitTerm


@dataclass(frozen=True)
class Glimpse:
    """One camera's image about the body in the last frame: a window of it, which begins at the `corner` (x, y) px."""

    camera_index: int
    corner: tuple[int, int]
    view: View


@dataclass(frozen=True)
class LastFrame:
    """The last frame that was tracked on images: its pose, its time (s) and what the cameras showed."""

    posed: Posed
    time: float
    glimpses: tuple[Glimpse, ...]


@dataclass(frozen=True)
class FlowPredictor(Checked):
    """Settings of the flow predictor; lengths in metres are on the body.

    Attributes:
        inertia: what is expected without flow.
        always: whether flow predicts every frame; else only while there is one pose and so no velocity.
        points, margin: how many pixels of the body are followed in each view, and how far (m).
        sigma: noise of a flow vector, px.
        share: fraction of the points' information that counts (neighbours err alike).
        robust: m by which a point may disagree before it is down-weighted; `loosened` are factors on it, of one solve
            after the other: a point that a limb has left far behind must count at first.
        least_confidence, least_share: how well the flow back must undo a vector that counts, and the fraction of all
            points that must count, or else the flow as a whole is not believed.
    """

    rig: Rig = field(default_factory=lambda: Rig(()))
    inertia: Inertia = field(default_factory=Inertia)
    always: bool = False
    preset: Preset = "fast"
    points: Count = 500
    margin: float = 0.3
    sigma: Positive = 1.0
    share: Share = 0.3
    robust: Positive = 0.02
    loosened: tuple[float, ...] = (30.0, 8.0, 2.0)
    channels: Channels = "lab"
    least_confidence: Share = 0.6
    least_share: Share = 0.3
    name: str = field(default="flow", init=False)

    def start(self, body: Body, rig: Rig) -> LastFrame | None:
        """No frame is known."""

    def predict(self, memory: LastFrame | None, past: Past, frame: Frame) -> tuple[Prediction | None, LastFrame | None]:
        """The pose to which flow leads from the last frame; None where it is not wanted or cannot be believed."""
        if memory is None or not (self.always or not past.moving):
            return None, memory
        guess = self.inertia.pose(past, frame.time)
        dof = 6 + len(guess.q)
        _, information = past.spread.noise.covariance(dof, frame.time - memory.time, "hold", guess.root[:3, 3])
        with stage("flow"):
            pose = self.followed(memory, frame, guess, information)
        return None if pose is None else self.inertia.prediction(pose, past, frame.time, "flow"), memory

    def learn(self, memory: LastFrame | None, fit: Fit, past: Past, frame: Frame) -> LastFrame | None:
        """Keep the images about the body, where the next frame will ask for them."""
        if self.always or (not past.moving and not self.inertia.hold):
            return self.last_frame(fit.posed, frame, [sight.camera_index for sight in fit.sights])
        return None

    def last_frame(self, posed: Posed, frame: Frame, cameras: Sequence[int]) -> LastFrame:
        """What some cameras' images show about a body."""
        glimpses: list[Glimpse] = []
        for i in cameras:
            image, camera = frame.images[i], self.rig[i]
            window = view_window(camera, posed, self.margin)
            if image is not None and window is not None:
                glimpses.append(Glimpse(i, window[0], _cut(image, camera, *window, self.channels)))
        return LastFrame(posed, frame.time, tuple(glimpses))

    def followed(self, last: LastFrame, frame: Frame, guess: Pose, information: Float) -> Pose | None:
        """The pose to which flow leads from the last frame; None where too little of it can be believed.

        `guess` is what is expected without flow, with that `information` (6 + J, 6 + J); all that hidden limbs follow.
        """
        found: list[tuple[KeypointTerm, float]] = []
        for glimpse in last.glimpses:
            image, before = frame.images[glimpse.camera_index], glimpse.view
            if image is not None and (seen := render(last.posed, before.camera)).mask.any():
                after = _cut(image, self.rig[glimpse.camera_index], glimpse.corner, before.camera.size, self.channels)
                found.append(self.term(before, after, seen))
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

        `before` and `after` are one window of the last image and of the present one, `seen` the body at its last pose,
        rendered there; some of it must be in sight.
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


def _cut(image: AnyArray, camera: Camera, corner: tuple[int, int], size: tuple[int, int], channels: Channels) -> View:
    (x, y), (w, h) = corner, size
    return View(camera.cropped(corner, size), np.ascontiguousarray(image[y : y + h, x : x + w]), channels, corner)
