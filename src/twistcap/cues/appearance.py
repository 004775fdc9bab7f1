"""What each part of the body, and each half of it, has looked like to each camera: the colours that a frame's
statistics start from, and by which a body is searched for. A sleeve or a short ends in the middle of a part.

Statistics taken from the present frame alone forget: once a limb's contour has slipped onto the background, the
background's colours pass for the limb's, and nothing pulls it back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float, Float32, Int
from twistcap.body.model import partners
from twistcap.cues.view import View
from twistcap.ranges import Checked, Share
from twistcap.render import RenderedView


@dataclass(frozen=True)
class AppearanceRule(Checked):
    """How colours are remembered.

    Attributes:
        memory: share of what is known that is kept from frame to frame.
        least_share: share of a part's contour that must agree with the image before it is learnt from.
        other_cameras: weight of what other cameras have seen of a part.
        shading: standard deviation of the factor by which a part's colours differ from camera to camera: one sees its
            sunny side, one the other.
        trusted: pixels, over all frames remembered, at which colours are trusted by half.
        other_side: weight of what is known of the other side's part, while little is known of a part itself.
        whole_part: weight of what is known of a part, while little is known of its half.
    """

    memory: Share = 0.9
    least_share: Share = 0.7
    other_cameras: Share = 0.3
    shading: float = 0.3
    trusted: float = 100.0
    other_side: Share = 0.3
    whole_part: Share = 0.3


@dataclass(frozen=True)
class Appearance:
    """Colours of S parts in each of a rig's cameras, as past frames showed them.

    Attributes:
        rule: how they are remembered.
        sums: (cameras, S, 1 + 2C) weighted number, sum and sum of squares of pixels; C is 0 before the first image.
        halves: (cameras, 2 S, 1 + 2C) the same of each half of a part, see `Body.vertex_half`.
        other: (S,) the same part of the other side, or itself.
    """

    rule: AppearanceRule
    sums: Float
    halves: Float
    other: Int

    @staticmethod
    def blank(cameras: int, names: Sequence[str], rule: AppearanceRule) -> Appearance:
        """Nothing learnt yet of the parts of these names."""
        S = len(names)
        sums, halves = np.zeros((cameras, S, 1)), np.zeros((cameras, 2 * S, 1))
        return Appearance(rule, sums, halves, np.array(partners(names), np.int32))

    def of(self, camera_index: int, channels: int) -> Float:
        """(S, 1 + 2C) confidence 0 … 1, mean and mean square of each part's colours in a camera."""
        return self._wide(channels)._of_parts[camera_index]

    def of_halves(self, camera_index: int, channels: int) -> Float:
        """(2 S, 1 + 2C) the same of each half of a part."""
        return self._wide(channels)._of_halves[camera_index]

    def learnt(self, camera_index: int, view: View, seen: RenderedView, agreeing: Float, frames: int) -> Appearance:
        """With a view's colours, of those parts whose contour agrees well enough.

        Args:
            agreeing: (S,) fraction of each part's contour that agrees with the image.
            frames: that have passed since the last time, for all of which this one stands.
        """
        wide, wanted = self._wide(view.features.shape[2]), agreeing >= self.rule.least_share
        sums, halves = wide.sums.copy(), wide.halves.copy()
        labels = (sums, seen.part, wanted), (halves, seen.half, np.repeat(wanted, 2))
        for own, label, some in labels:
            now = part_colours(view.features, label, some)
            new = now[:, 0] > 0.0
            own[camera_index, new] = self.rule.memory**frames * own[camera_index, new] + frames * now[new]
        return replace(self, sums=sums, halves=halves)

    def __add__(self, other: Appearance) -> Appearance:
        """All that both have learnt."""
        channels = max(self.sums.shape[2], other.sums.shape[2]) // 2
        mine, theirs = self._wide(channels), other._wide(channels)
        return replace(self, sums=mine.sums + theirs.sums, halves=mine.halves + theirs.halves)

    @cached_property
    def _of_parts(self) -> Float:
        return self._pooled(self.sums, self.other)

    @cached_property
    def _of_halves(self) -> Float:
        """As `of_halves` gives them; while little is known of a half, its whole part lends it."""
        unknown = self.rule.trusted / (self.rule.trusted + self.halves[..., :1])
        lent = self.rule.whole_part * unknown * np.repeat(self.sums, 2, axis=1)
        return self._pooled(self.halves + lent, np.column_stack([2 * self.other, 2 * self.other + 1]).ravel())

    def _pooled(self, sums: Float, other: Int) -> Float:
        """(cameras, P, 1 + 2C) as `of` gives it, of sums alike: own colours, with less weight those of other cameras,
        and while little is known, those of the other side (P,), where that is not itself.
        """
        channels = sums.shape[2] // 2
        borrowed = self.rule.other_cameras * (sums.sum(axis=0) - sums)
        means = borrowed[..., 1 : 1 + channels]
        borrowed[..., 1 + channels :] += self.rule.shading**2 * means**2 / np.maximum(borrowed[..., :1], 1e-9)
        pooled = sums + borrowed
        unknown = self.rule.trusted / (self.rule.trusted + pooled[..., :1])
        sided = (other != np.arange(len(other)))[:, None]
        pooled = pooled + np.where(sided, self.rule.other_side * unknown, 0.0) * pooled[:, other]
        mass = pooled[..., :1]
        return np.concatenate([mass / (mass + self.rule.trusted), pooled[..., 1:] / np.maximum(mass, 1e-9)], axis=-1)

    def _wide(self, channels: int) -> Appearance:
        """The same, ready for images of so many channels."""
        if self.sums.shape[2] > 1:
            return self
        sums, halves = (np.zeros((*blank.shape[:2], 1 + 2 * channels)) for blank in (self.sums, self.halves))
        return replace(self, sums=sums, halves=halves)


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def part_colours(features: Float32, part: Int, wanted: Bool) -> Float:
    """(S, 1 + 2C) number, sum and sum of squares of the pixels inside each wanted part, none at its rim."""
    height, width, channels = features.shape
    out = np.zeros((len(wanted), 1 + 2 * channels))
    for r in range(1, height - 1):
        for c in range(1, width - 1):
            s = part[r, c]
            if s < 0 or not wanted[s]:
                continue
            if part[r - 1, c] != s or part[r + 1, c] != s or part[r, c - 1] != s or part[r, c + 1] != s:
                continue
            out[s, 0] += 1.0
            for j in range(channels):
                value = features[r, c, j]
                out[s, 1 + j] += value
                out[s, 1 + channels + j] += value * value
    return out


def part_colours_reference(features: Float32, part: Int, wanted: Bool) -> Float:
    """Readable twin of `part_colours`."""
    inner, pixels = part[1:-1, 1:-1], features[1:-1, 1:-1].astype(float)
    around = (part[:-2, 1:-1], part[2:, 1:-1], part[1:-1, :-2], part[1:-1, 2:])
    inside = np.all([neighbour == inner for neighbour in around], axis=0)
    out = np.zeros((len(wanted), 1 + 2 * features.shape[2]))
    for s in np.flatnonzero(wanted):
        values = pixels[inside & (inner == s)]
        out[s] = np.concatenate([[len(values)], values.sum(axis=0), (values**2).sum(axis=0)])
    return out
