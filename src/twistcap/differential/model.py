"""The differential method as a model: what stays the same from frame to frame; behind calibrated cameras, its poses."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twistcap._typing import Float
from twistcap.body import Body, Pose
from twistcap.camera import Rig
from twistcap.differential.settings import DifferentialConfig, Rule
from twistcap.differential.state import ROOT, Track
from twistcap.differential.step import Found, step
from twistcap.differential.world import state_of, world_pose
from twistcap.estimate import Estimate, Frame

_LOST = 0.25
"""Mean support of the body's pixels, in the view that has most, below which the images no longer support the pose."""


@dataclass(frozen=True)
class DifferentialModel:
    """A body before calibrated cameras, followed by brightness alone.

    The views' own turns and scales start from the cameras; from then on each follows what its images show.

    Attributes:
        body: whose surface gives the depth.
        rig: rectified cameras.
        config: settings.
        rule: of one frame.
    """

    body: Body
    rig: Rig
    config: DifferentialConfig = field(default_factory=DifferentialConfig)
    rule: Rule = field(default_factory=Rule)

    def start(self, pose: Pose, time: float = 0.0) -> Track:
        """The track before the first frame, which shows the body at a pose."""
        del time  # nothing is predicted into the first frame
        return Track.of(state_of(pose, self.rig, self.config.perspective))

    def step(self, track: Track, frame: Frame) -> tuple[Track, Estimate]:
        """Follow the body into a frame; its pose in the first one is given.

        Raises:
            InputError: for images that do not fit, or a value that is not finite.
        """
        after, found = step(track, frame.images, self.body, self.config, self.rule)
        pose = world_pose(found.state, list(self.rig))
        if not track.started:
            return after, Estimate(frame.index, frame.time, pose, 1e-6 * np.eye(self.body.dof))
        covariance, support = self._covariance(found, pose), float(found.support.max())
        finite = bool(np.all(np.isfinite(pose.q)) and np.all(np.isfinite(covariance)))
        seen = any(image is not None for image in frame.images)
        return after, Estimate(
            frame.index, frame.time, pose, covariance, {"brightness": found.energy},
            "failed" if not finite else "converged" if seen else "no_images", found.steps,
            lost=not finite or support < _LOST, support=support, predicted="constant_velocity",
        )  # fmt: skip

    def _covariance(self, found: Found, pose: Pose) -> Float:
        """(6 + J, 6 + J) of the pose step, from that of the state's (6 V + J), by finite differences of the views."""
        n, views, cameras = len(found.covariance), ROOT * len(found.state.views), list(self.rig)
        G = np.zeros((self.body.dof, n))
        G[ROOT:, views:] = np.eye(n - views)
        for k in range(views):
            by = np.zeros(n)
            by[k] = 1e-4
            there, back = (world_pose(found.state.retract(s), cameras) for s in (by, -by))
            G[:, k] = (there.minus(pose) - back.minus(pose)) / 2e-4
        return G @ found.covariance @ G.T
