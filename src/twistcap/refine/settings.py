"""Settings of the refinement, and the shape that it seeks."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twistcap._typing import Float
from twistcap.body import Body
from twistcap.body.shape import RestMotion, joints_moved, rescaled, rest_motion
from twistcap.errors import InputError
from twistcap.predict import MotionNoise


@dataclass(frozen=True)
class RefineConfig:
    """How a track is refined.

    Attributes:
        rounds: of looking at the images anew and solving.
        coarse_rounds: first of these, in which contours are sought farther off and brightness is compared under a wide
            blur.
        coarse: factor on the contour's reach in these.
        settled: m; the rounds end where no contour's body moves farther (mean over the joints).
        strides: frames between the two whose brightness is compared; each step takes all of them.
        points: surface points whose brightness is compared, in each view.
        length, girth: how far a log-length and a log-girth may be off (standard deviation); 0 holds them.
        joint: m by which each joint centre may be off in each direction; 0 holds them.
        damping: share by which the diagonal of the equations is raised in each step.
        noise: accelerations of the motion: the same as in tracking.
    """

    rounds: int = 8
    coarse_rounds: int = 2
    coarse: float = 2.0
    settled: float = 2e-4
    strides: tuple[int, ...] = (1, 3, 6)
    points: int = 400
    length: float = 0.05
    girth: float = 0.04
    joint: float = 0.012
    damping: float = 1e-3
    noise: MotionNoise = field(default_factory=MotionNoise)

    def __post_init__(self) -> None:
        if min(self.length, self.girth, self.joint) < 0 or self.rounds < 1 or min(self.strides, default=0) < 1:
            raise InputError("refine: length, girth and joint must be 0 or more, rounds and strides 1 or more.")


@dataclass(frozen=True)
class Shape:
    """What is sought of a body's shape, and how far it has moved from the body given.

    Attributes:
        body: as it is now.
        stretched, widened: groups of segments, left and right alike, by name.
        moved: segments whose proximal joint moves.
        sigma: (K,) prior standard deviation of each parameter.
        total: (K,) of the parameters since the body given: log-lengths, log-girths, then x, y, z (m) of joints.
    """

    body: Body
    stretched: dict[str, tuple[str, ...]]
    widened: dict[str, tuple[str, ...]]
    moved: tuple[str, ...]
    sigma: Float
    total: Float

    @staticmethod
    def of(body: Body, groups: dict[str, tuple[str, ...]], config: RefineConfig) -> Shape:
        """The unknowns that a configuration leaves free."""
        stretched = groups if config.length > 0 else {}
        widened = groups if config.girth > 0 else {}
        jointed = zip(body.segment_names, body.segment_joint, strict=True)
        moved = tuple(name for name, joint in jointed if joint >= 0) if config.joint > 0 else ()
        sizes = (len(stretched), len(widened), 3 * len(moved))
        sigma = np.repeat([config.length, config.girth, config.joint], sizes)
        return Shape(body, stretched, widened, moved, sigma, np.zeros(len(sigma)))

    def motion(self) -> RestMotion:
        """How the rest pose moves with the parameters."""
        ones = [[dict.fromkeys(group, 1.0) for group in kind.values()] for kind in (self.stretched, self.widened)]
        return rest_motion(self.body, *ones, [self.body.segment(name) for name in self.moved])

    def stepped(self, step: Float) -> Shape:
        """The shape after a step (K,)."""
        a, b = len(self.stretched), len(self.stretched) + len(self.widened)
        body = rescaled(self.body, _factors(self.stretched, step[:a]), _factors(self.widened, step[a:b]))
        body = joints_moved(body, dict(zip(self.moved, step[b:].reshape(-1, 3), strict=True)))
        return Shape(body, self.stretched, self.widened, self.moved, self.sigma, self.total + step)

    def parts(self, values: Float) -> tuple[dict[str, float], dict[str, float], dict[str, Float]]:
        """Values (K,) by group of lengths, group of girths, and segment of joints (3,)."""
        a, b = len(self.stretched), len(self.stretched) + len(self.widened)
        joints = dict(zip(self.moved, values[b:].reshape(-1, 3), strict=True))
        along, across = (dict(zip(g, map(float, v), strict=True)) for g, v in ((self.stretched, values[:a]), (self.widened, values[a:b])))
        return along, across, joints


def _factors(groups: dict[str, tuple[str, ...]], logs: Float) -> dict[str, float]:
    return {name: float(np.exp(value)) for group, value in zip(groups.values(), logs, strict=True) for name in group}
