"""What both contour cues share: the colours of the parts as memory, and agreement by part as judgement."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float, Float32, Int
from twistcap.body import Body
from twistcap.camera import Rig
from twistcap.cues.appearance import Appearance, AppearanceRule
from twistcap.cues.observation import Agreement, Evidence, Fit, Level, Sight
from twistcap.cues.view import View
from twistcap.region.matching import Displacement
from twistcap.render import ContourPoints, RenderedView

CONTRAST = 3.0
"""Nats from which on a contour point tells inside from outside."""
TOLERANCE = 0.015
"""m on the body that the contour may be off its place and still agree."""


@dataclass(frozen=True)
class Segmentation:
    """An evolved outline in one view.

    Attributes:
        points, normals: (M, 2) px on it, and its outward unit normals.
        log_ratio: (H, W) log density ratio inside to outside that drove it.
        width: px, standard deviation of the band in which it was driven.
        phi: (H, W) the level set itself, positive inside.
        flow: displacements from the rendered body's outline to it, where they were asked for.
    """

    points: Float
    normals: Float
    log_ratio: Float32
    width: float
    phi: Float32
    flow: Displacement | None = None


@dataclass(frozen=True)
class ContourEvidence(Evidence):
    """A contour term, and what it was made from.

    Attributes:
        contour: N points that were looked at.
        displacement: (N,) px outward to where the contour was found.
        contrast: (N,) nats by which the image tells inside from outside there; 0 where it says nothing.
    """

    contour: ContourPoints = field(kw_only=True)
    displacement: Float = field(kw_only=True)
    contrast: Float = field(kw_only=True)


class ContourCue(ABC):
    """Finds the body's contour in an image near where the body was rendered."""

    name: str
    alternations: int
    slip: float
    appearance: AppearanceRule

    def start(self, body: Body, rig: Rig) -> Appearance:
        """No colours are known yet."""
        return Appearance.blank(len(rig), body.segment_names, self.appearance)

    def measure(self, sight: Sight, memory: Appearance, level: Level) -> ContourEvidence | None:
        """The contour in one view, and how well each part agrees with it; None where the body is out of the picture."""
        if not len(sight.contour):
            return None
        view = sight.view
        colours = memory.of(sight.camera_index, view.features.shape[2])
        return self.locate(view, sight.seen, sight.contour, level.reach, colours, sight.scratch)

    def learn(self, memory: Appearance, fit: Fit, lesson: int) -> Appearance:
        """Take in the colours of the parts whose contour agrees."""
        if not lesson:
            return memory
        for sight, evidence in fit.of(self.name):
            agreement = evidence.agreement
            assert agreement is not None
            share = agreement.agreeing / np.maximum(agreement.points, 1)
            memory = memory.learnt(sight.camera_index, sight.view, sight.seen, share, lesson)
        return memory

    @abstractmethod
    def locate(
        self, view: View, seen: RenderedView, contour: ContourPoints, reach: float, colours: Float,
        scratch: dict[str, Any] | None = None,
    ) -> ContourEvidence:  # fmt: skip
        """Evidence of one view.

        Args:
            view: the image.
            seen, contour: the rendered body and its contour, which may have moved since.
            reach: factor ≥ 1 on the capture range.
            colours: (S, 1 + 2C) what `Appearance.of` remembers of each part.
            scratch: what is kept until the body is rendered anew.
        """


def part_agreement(contour: ContourPoints, displacement: Float, contrast: Float, focal: float, parts: int) -> Agreement:
    """How many silhouette points of each of S parts tell inside from outside, and how many agree with the body.

    Args:
        contour: N points.
        displacement, contrast: (N,) as in `ContourEvidence`.
        focal: focal length of the view, px.
        parts: S.
    """
    tolerance = contour.inverse_depth * (TOLERANCE * focal)
    return Agreement(*tallied(contour.part, contour.outer, tolerance, displacement, contrast, parts))


@njit(cache=True, nogil=True)
def tallied(
    part: Int, outer: Bool, tolerance: Float, displacement: Float, contrast: Float, parts: int
) -> tuple[Int, Float, Float]:
    """`part_agreement` of N points, each with its tolerance (N,) px: (S,) points, telling ones, agreeing ones."""
    points, telling, agreeing = np.zeros(parts, dtype=np.int32), np.zeros(parts), np.zeros(parts)
    for n in range(len(part)):
        if outer[n]:
            s = part[n]
            points[s] += 1
            if contrast[n] > CONTRAST:
                telling[s] += 1.0
                if abs(displacement[n]) < tolerance[n]:
                    agreeing[s] += 1.0
    return points, telling, agreeing


def tallied_reference(
    part: Int, outer: Bool, tolerance: Float, displacement: Float, contrast: Float, parts: int
) -> tuple[Int, Int, Int]:
    """Readable twin of `tallied`."""
    telling = outer & (contrast > CONTRAST)
    agreeing = telling & (np.abs(displacement) < tolerance)
    counts = [np.bincount(part[which], minlength=parts).astype(np.int32) for which in (outer, telling, agreeing)]
    return counts[0], counts[1], counts[2]
