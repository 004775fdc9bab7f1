"""Settings of the fit."""

from __future__ import annotations

from dataclasses import dataclass, field

from twistcap.adjust.body_fit.observe import Contours


@dataclass(frozen=True)
class FitRule:
    """How a body is fitted. Factors are natural logarithms, lengths m.

    Attributes:
        mirrored: whether the fit begins with the mean of the body and its mirror image.
        rounds: how often the recording is tracked anew with the body so far.
        steps: Gauss-Newton steps in each round.
        frames: of each recording that the shape is fitted to, at most, evenly spread over those that are tracked.
        stature, length, girth: standard deviations of the log-factors of the whole body and of each kind of segment.
        section, knots: standard deviation of the factors of cross-sections, and how many there are along a segment.
        joint, joint_side: standard deviations of shifts of the joint centres, of both sides alike and of each alone.
        offset, reach: standard deviation of the offsets of the surface along its normals, and over what distance on
            the body they are alike.
        turn_deg: how far the surface of a segment may turn against its joint's axes, which no image tells.
        offset_bound: no vertex moves farther along its normal than this.
        pose_deg, pose_m: how far a pose may stray from the tracked one.
        robust: distance at which a contour point begins to lose its say.
        worth: all frames together count as so many frames of independent contour points: neighbours and frames of
            one person before one background err alike.
    """

    mirrored: bool = True
    rounds: int = 3
    steps: int = 4
    frames: int = 20
    stature: float = 0.02
    length: float = 0.01
    girth: float = 0.12
    section: float = 0.06
    knots: int = 5
    joint: float = 0.002
    joint_side: float = 0.001
    offset: float = 0.006
    reach: float = 0.10
    turn_deg: float = 0.1
    offset_bound: float = 0.03
    pose_deg: float = 3.0
    pose_m: float = 0.02
    robust: float = 0.012
    worth: float = 0.3
    contours: Contours = field(default_factory=Contours)
