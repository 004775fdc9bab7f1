"""The differential tracker behind calibrated cameras: frames in, estimates of the pose in the world out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twistcap._typing import AnyArray, Float
from twistcap.body import Body, Pose
from twistcap.camera import Rig
from twistcap.differential.settings import DifferentialConfig
from twistcap.differential.tracker import DifferentialEstimate, DifferentialTracker
from twistcap.differential.view import ROOT, State
from twistcap.differential.world import state_of, world_pose
from twistcap.errors import InputError
from twistcap.estimate import Estimate, Frame

_LOST = 0.25
"""Mean support of the body's pixels, in the view that has most, below which the images no longer support the pose."""


class DifferentialFollower:
    """Follows a body in the frames of a calibrated recording; it is used as `twistcap.track.Tracker` is.

    The views' own turns and scales start from the cameras; from then on each follows what its images show.

    Args:
        body: whose surface gives the depth.
        rig: rectified cameras.
        config: settings.
    """

    def __init__(self, body: Body, rig: Rig, config: DifferentialConfig | None = None) -> None:
        self.body, self.rig, self.config = body, rig, config or DifferentialConfig()
        self._first: Pose | None = None
        self._tracker: DifferentialTracker | None = None

    def start(self, pose: Pose, time: float = 0.0) -> None:
        """The pose in the first frame that `step` is given."""
        del time  # nothing is predicted into the first frame
        self._first, self._tracker = pose, None

    def restore(self, estimates: Sequence[Estimate]) -> None:
        """Begin anew from the last of earlier estimates: what is remembered of the surface is not kept in files."""
        self.start(estimates[-1].pose)

    def step(self, frame: Frame) -> Estimate:
        """The pose in a frame; in the first one it is the pose that `start` was given.

        Raises:
            InputError: before `start`, or where the first frame lacks an image.
        """
        if self._first is None:
            raise InputError("differential: no first pose was given; call start before step.")
        if self._tracker is None:
            return self._begin(frame, self._first)
        return self._estimate(frame, self._tracker.step(frame.images))

    def _begin(self, frame: Frame, pose: Pose) -> Estimate:
        images: list[AnyArray] = [image for image in frame.images if image is not None]
        if len(images) < len(self.rig):
            raise InputError("differential: the first frame lacks an image; begin at a frame that all cameras have.")
        state = state_of(pose, self.rig, self.config.perspective)
        self._tracker = DifferentialTracker(self.body, state, images, self.config)
        return Estimate(frame.index, frame.time, pose, 1e-6 * np.eye(self.body.dof))

    def _estimate(self, frame: Frame, found: DifferentialEstimate) -> Estimate:
        pose, support = world_pose(found.state, list(self.rig)), float(found.support.max())
        covariance = self._covariance(found.state, pose, found.covariance)
        seen = any(image is not None for image in frame.images)
        finite = bool(np.all(np.isfinite(pose.q)) and np.all(np.isfinite(covariance)))
        status = "failed" if not finite else "converged" if seen else "no_images"
        return Estimate(
            frame.index, frame.time, pose, covariance, {"brightness": found.energy}, status, self.config.iterations,
            lost=not finite or support < _LOST, support=support, predicted="constant_velocity",
        )  # fmt: skip

    def _covariance(self, state: State, pose: Pose, covariance: Float) -> Float:
        """(6 + J, 6 + J) of the pose step, from that of the state's (6 V + J), by finite differences of the views."""
        n, views, cameras = len(covariance), ROOT * len(state.views), list(self.rig)
        G = np.zeros((self.body.dof, n))
        G[ROOT:, views:] = np.eye(n - views)
        for k in range(views):
            step = np.zeros(n)
            step[k] = 1e-4
            there, back = (world_pose(state.retract(s), cameras) for s in (step, -step))
            G[:, k] = (there.minus(pose) - back.minus(pose)) / 2e-4
        return G @ covariance @ G.T
