"""Prediction by Rosenhahn, Brox and Seidel: a new match in each frame, and the increment of its sample.

"Scaled Motion Dynamics for Markerless Motion Capture" (DOI 10.1109/CVPR.2007.383128), sections 2.3 and 3; method.md 8.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Body
from twistcap.errors import check
from twistcap.motion.library import PAPER_SCALES, MotionLibrary
from twistcap.motion.matching import Interval, Match, Matcher
from twistcap.motion.openloop import OpenLoop, PoseSequence

PaperKind = Literal["scaled", "unscaled", "standard"]
_STANDING = 0.03  # m/s: the speed of a slower sample is not used
_RATIOS = (0.0, 4.0)  # of the speeds of person and sample


class PaperMotion(OpenLoop):
    """The paper's predictions.

    "scaled": the best match over all time scales; joints by the sample's increment, the root by its twist, transformed
    by the adjoint and scaled by the ratio of the speeds. "unscaled": the same at the sample's own speed. "standard":
    the mean motion of the last frames, without the library. The last m = `poses` are matched, or averaged. Raises
    InputError as `OpenLoop`, and for fewer than two poses.
    """

    def __init__(
        self, library: MotionLibrary, body: Body, kind: PaperKind = "scaled", poses: int = 5,
        scales: Sequence[float] = PAPER_SCALES,
    ) -> None:  # fmt: skip
        super().__init__(library, body)
        check("motion prediction", poses >= 2, f"{poses} pose(s) are to be matched; take 2 or more")
        self.kind, self.poses, self.history = kind, poses, poses
        self._matcher = Matcher(library, self.compared, scales=scales if kind == "scaled" else (1.0,))

    def dissimilarity(self, match: Match | None) -> float:
        """Mean distance of the matched poses, rad."""
        if match is None:
            return 0.0 if self.kind == "standard" else np.nan
        return match.distance / self.poses

    def next_poses(self, past: PoseSequence, count: int, excluded: Sequence[Interval] = ()) -> PoseSequence:
        """The next pose; see `OpenLoop.next_poses`."""
        recent = past.since(max(0, len(past) - self.poses))
        if self.kind == "standard" or len(recent) < 2:
            return standard_step(recent)
        match = self._matcher.best(recent.q[:, self.compared], past.match, excluded)
        if match is None:
            return standard_step(recent)
        where = np.array([match.position, match.after(1.0).position])
        q, sample = self.library.angles(match.clip, where), self.library.root_motions(match.clip, where)
        speed = root_speed(recent.roots) if self.kind == "scaled" else None
        root = transferred(recent.roots[-1], sample[0], sample[1], speed, _STANDING / self.library.rate)
        return PoseSequence((recent.q[-1] + q[1] - q[0])[None], root[None], match)


def transferred(root: Float, before: Float, after: Float, speed: float | None, standing: float) -> Float:
    """A root (4, 4) after the motion of a sample: ``exp(ν/ν̃ · Ad_g log(M̃' M̃⁻¹)) M`` with ``g = M M̃⁻¹``.

    M is the root, M̃ and M̃' are the sample before and one frame after. Without a speed ν (m per frame) this is
    ``M M̃⁻¹ M̃'``, the sample's motion in its own frame; a sample's speed ν̃ below `standing` is kept too.
    """
    twist = se3.adjoint(root @ se3.inverse(before)) @ se3.log(after @ se3.inverse(before))
    if speed is not None:
        own = float(np.linalg.norm((se3.exp(twist) @ root)[:3, 3] - root[:3, 3]))
        if own > standing:
            twist = twist * np.clip(speed / own, *_RATIOS)
    return se3.exp(twist) @ root


def root_speed(roots: Float) -> float:
    """ν: mean distance of the root's origin from each of the roots (n, 4, 4) to the next, m."""
    return float(np.mean(np.linalg.norm(np.diff(roots[:, :3, 3], axis=0), axis=1)))


def standard_step(recent: PoseSequence) -> PoseSequence:
    """The last pose moved by the mean of the motions between the recent ones, in the body's frame."""
    if len(recent) < 2:
        return recent
    steps = se3.log(se3.inverse(recent.roots[:-1]) @ recent.roots[1:])
    root = recent.roots[-1] @ se3.exp(steps.mean(axis=0))
    q = recent.q[-1] + np.diff(recent.q, axis=0).mean(axis=0)
    return PoseSequence(q[None], root[None])
