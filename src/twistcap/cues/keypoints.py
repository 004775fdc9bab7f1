"""The keypoint cue: a detector's or a person's 2D landmarks beside the images' own evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from twistcap.body import Posed
from twistcap.camera import Rig
from twistcap.cues.observation import Alternation
from twistcap.estimate import Keypoints
from twistcap.ranges import Checked, Positive
from twistcap.render import SurfacePoints
from twistcap.terms import KeypointTerm


@dataclass(frozen=True)
class Keypoints2D(Checked):
    """Settings of the keypoint cue; lengths are on the body.

    Attributes:
        sigma: noise of a keypoint of confidence 1, m.
        robust: distance at which a keypoint is down-weighted, m.
        rig: the cameras as calibrated, in whose pixels keypoints come.
    """

    sigma: Positive = 0.03
    robust: Positive = 0.09
    rig: Rig | None = None
    name: str = field(default="keypoints", init=False)
    news: bool = field(default=True, init=False)

    def terms(self, alternation: Alternation) -> Sequence[KeypointTerm]:
        """Terms of the frame's keypoints; none where it has none."""
        keypoints = alternation.frame.keypoints
        if keypoints is None or self.rig is None:
            return ()
        return self.terms_of(keypoints, self.rig, Posed(alternation.posed.body, alternation.expected))

    def claimed(self, posed: Posed) -> None:
        """Nothing beside what the terms say."""

    def terms_of(self, keypoints: Keypoints, rig: Rig, posed: Posed) -> list[KeypointTerm]:
        """One term per camera that has keypoints; landmarks the body does not have are left out.

        Args:
            keypoints: of the frame, pixels of the cameras of `rig` (distorted as those are).
            posed: the expected body, which tells how many pixels a metre has.
        """
        marks = posed.body.landmarks
        known = [(i, marks.index(name)) for i, name in enumerate(keypoints.names) if name in marks.names]
        if not known:
            return []
        columns, landmarks = (np.array(pair) for pair in zip(*known, strict=True))
        points = SurfacePoints(marks.segments[landmarks, None], np.ones((len(known), 1)), marks.points[landmarks])
        out: list[KeypointTerm] = []
        for k, camera in enumerate(rig):
            xy = camera.normalised(keypoints.pixels[k, columns])
            target = xy @ camera.K[:2, :2].T + camera.K[:2, 2]
            seen = np.isfinite(target).all(axis=1) & (keypoints.confidence[k, columns] > 0)
            px_per_m = camera.K[0, 0] / np.maximum(camera.project(posed.landmarks[landmarks])[1], 0.1)
            weight = np.where(seen, keypoints.confidence[k, columns], 0.0) / (self.sigma * px_per_m) ** 2
            if np.any(seen):
                scale = float(self.robust * np.median(px_per_m))
                out.append(KeypointTerm(camera.P, points, np.where(seen[:, None], target, 0.0), weight, scale))
        return out
