"""What each part of the body has looked like to each camera: the colours that a frame's statistics start from.

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
    """

    memory: Share = 0.9
    least_share: Share = 0.7
    other_cameras: Share = 0.3
    shading: float = 0.3
    trusted: float = 100.0
    other_side: Share = 0.3


@dataclass(frozen=True)
class Appearance:
    """Colours of S parts in each of a rig's cameras, as past frames showed them.

    Attributes:
        rule: how they are remembered.
        sums: (cameras, S, 1 + 2C) weighted number, sum and sum of squares of pixels; C is 0 before the first image.
        other: (S,) the same part of the other side, or itself.
    """

    rule: AppearanceRule
    sums: Float
    other: Int

    @staticmethod
    def blank(cameras: int, names: Sequence[str], rule: AppearanceRule) -> Appearance:
        """Nothing learnt yet of the parts of these names."""
        return Appearance(rule, np.zeros((cameras, len(names), 1)), np.array(partners(names), np.int32))

    def of(self, camera_index: int, channels: int) -> Float:
        """(S, 1 + 2C) confidence 0 … 1, mean and mean square of each part's colours in a camera."""
        return self._wide(channels)._pooled[camera_index]

    def learnt(self, camera_index: int, view: View, seen: RenderedView, agreeing: Float, frames: int) -> Appearance:
        """With a view's colours, of those parts whose contour agrees well enough.

        Args:
            agreeing: (S,) fraction of each part's contour that agrees with the image.
            frames: that have passed since the last time, for all of which this one stands.
        """
        sums = self._wide(view.features.shape[2]).sums.copy()
        now = part_colours(view.features, seen.part, agreeing >= self.rule.least_share)
        new, own = now[:, 0] > 0.0, sums[camera_index]
        own[new] = self.rule.memory**frames * own[new] + frames * now[new]
        return replace(self, sums=sums)

    def __add__(self, other: Appearance) -> Appearance:
        """All that both have learnt."""
        channels = max(self.sums.shape[2], other.sums.shape[2]) // 2
        return replace(self, sums=self._wide(channels).sums + other._wide(channels).sums)

    @cached_property
    def _pooled(self) -> Float:
        """(cameras, S, 1 + 2C) as `of` gives it: own colours, with less weight those of other cameras, and while a part
        is hardly known, those of the other side.
        """
        channels = self.sums.shape[2] // 2
        borrowed = self.rule.other_cameras * (self.sums.sum(axis=0) - self.sums)
        means = borrowed[..., 1 : 1 + channels]
        borrowed[..., 1 + channels :] += self.rule.shading**2 * means**2 / np.maximum(borrowed[..., :1], 1e-9)
        pooled = self.sums + borrowed
        unknown = self.rule.trusted / (self.rule.trusted + pooled[..., :1])
        pooled = pooled + np.where(self._sided, self.rule.other_side * unknown, 0.0) * pooled[:, self.other]
        mass = pooled[..., :1]
        return np.concatenate([mass / (mass + self.rule.trusted), pooled[..., 1:] / np.maximum(mass, 1e-9)], axis=-1)

    @property
    def _sided(self) -> Bool:
        """(S, 1) parts that have another side."""
        return (self.other != np.arange(len(self.other)))[:, None]

    def _wide(self, channels: int) -> Appearance:
        """The same, ready for images of so many channels."""
        if self.sums.shape[2] > 1:
            return self
        return replace(self, sums=np.zeros((*self.sums.shape[:2], 1 + 2 * channels)))


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
