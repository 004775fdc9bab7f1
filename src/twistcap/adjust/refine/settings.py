"""Settings of the refinement."""

from __future__ import annotations

from dataclasses import dataclass, field

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
        settled: m; the rounds end where one has moved the landmarks no farther than this, in the mean over all frames.
        strides: frames between the two whose brightness is compared; each step takes all of them.
        bridge: s; lost spans that are shorter are bridged by motion alone in the first round.
        points: surface points whose brightness is compared, in each view.
        length, girth: how far a log-length and a log-girth may be off (standard deviation); 0 holds them.
        joint: m by which each joint centre may be off in each direction; 0 holds them.
        hinge: m by which the centre of a hinge may be off the middle of its limb, along its axis, which no motion
            tells.
        contour: factor on the information of the contours.
        brightness: share of the information of the points whose brightness is compared that counts.
        sigma: noise of those differences of brightness.
        alike: design effect of the contours beyond which joint centres are held: where points of one part err together,
            the surface is not the person's, and joint centres would make up for it. In the studio it is 1.0 to two
            digits, on `balance_4view` with a fitted body 2.6 of 30 frames and 5 of 100.
        damping: share by which the diagonal of the equations is raised in each step.
        noise: accelerations of the motion: the same as in tracking.
    """

    rounds: int = 14
    coarse_rounds: int = 2
    coarse: float = 2.0
    settled: float = 2.5e-4
    strides: tuple[int, ...] = (1, 3, 6)
    bridge: float = 0.2
    points: int = 400
    length: float = 0.05
    girth: float = 0.04
    joint: float = 0.012
    hinge: float = 0.004
    damping: float = 1e-3
    alike: float = 1.5
    contour: float = 1.0
    brightness: float = 0.32
    sigma: float = 0.015
    noise: MotionNoise = field(default_factory=MotionNoise)

    def __post_init__(self) -> None:
        if min(self.length, self.girth, self.joint) < 0 or self.rounds < 1 or min(self.strides, default=1) < 1:
            raise InputError("refine: length, girth and joint must be 0 or more, rounds and strides 1 or more.")
        if not self.sigma > 0:
            raise InputError(f"refine: sigma is {self.sigma}; the noise of brightness must be positive.")
