"""A lost body is looked for where keypoints show one: they propose, the images decide."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from twistcap.adjust.first_pose import fit_keypoints
from twistcap.body import Pose
from twistcap.camera import Rig
from twistcap.camera.bump import bumped
from twistcap.errors import InputError
from twistcap.estimate import Keypoints
from twistcap.search import Problem
from twistcap.search.lost import LostBody
from twistcap.track.model import Model


@dataclass(frozen=True)
class KeypointPoses:
    """The pose that a frame's keypoints propose, see `search.Proposals`.

    Attributes:
        rig: the cameras as calibrated, in whose pixels keypoints come.
        keypoints: of a frame by its number, None where it has none; asked only while a body is looked for.
    """

    rig: Rig
    keypoints: Callable[[int], Keypoints | None]

    def __call__(self, problem: Problem) -> Sequence[Pose]:
        """The fitted pose; none where two views do not agree on enough joints."""
        keypoints = problem.frame.keypoints
        if keypoints is None and (given := self.keypoints(problem.frame.index)) is not None:
            keypoints = given.sorted_by(problem.frame.sources)
        if keypoints is None:
            return ()
        rig = Rig(tuple(bumped(camera, bump) for camera, bump in zip(self.rig, problem.bumps, strict=True)))
        try:
            found = fit_keypoints(problem.body, rig, keypoints, fit_lengths=False, start=problem.past.last)
        except InputError:  # too few joints are seen in this frame
            return ()
        return (found.pose,)


def with_keypoints(model: Model, rig: Rig, keypoints: Callable[[int], Keypoints | None]) -> Model:
    """The model, whose search for the whole body also tries the pose of a frame's keypoints.

    Arguments are those of `KeypointPoses`.
    """
    poses = KeypointPoses(rig, keypoints)
    searches = (replace(s, proposals=poses) if isinstance(s, LostBody) else s for s in model.searches)
    return replace(model, searches=tuple(searches))
