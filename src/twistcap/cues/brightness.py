"""The brightness cue: visible surface points remember how bright they were in the frame before."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from twistcap.arrays import Float, Float32
from twistcap.body import Body, Posed
from twistcap.camera import Rig
from twistcap.cues.memory import Look, Memory, Retention, remember
from twistcap.cues.observation import Evidence, Fit, Level, Sight
from twistcap.cues.support_maps import Neighbourhood, posterior, robust_scale
from twistcap.cues.view import Picture, View
from twistcap.errors import InputError
from twistcap.render import RenderedView
from twistcap.stages import stage
from twistcap.terms import PhotometricTerm
from twistcap.terms.photometric import EXPOSURE, Samples, sampled

Support = Literal["none", "robust", "em"]

_NEW = 0.9  # trust in a point that was not followed before
_PAST = 0.6  # its weight in the running excess of each part, per lesson
_NEITHER = 0.05  # density of differences that neither motion explains, per standard deviation of the noise
_LEAST = 0.02  # no point is known to move as the body does, nor not to, beyond this probability


Memories = tuple[Memory | None, ...]
"""Of each camera; None before its first image."""


@dataclass(frozen=True)
class Brightness:
    """Settings of the brightness cue.

    Attributes:
        points: how many surface points are followed in each view.
        blurs: Gaussians under which images are compared, coarse to fine, m on the body.
        sigma: noise of the brightness (sensor, sampling).
        slide: m by which the picture on the surface strays from its place (cloth, a wrong shape): more noise where
            brightness is steep.
        scale: difference, in standard deviations of the noise, at which a point begins to lose its say.
        jump: difference beyond which a point is given up for another.
        share: share of the points' information that counts (neighbouring points see the same pixels).
        update: share of the new brightness that a template point takes over in each frame.
        depth_tolerance: m that a point may lie behind the rendered surface and still count as seen.
        support: "robust": each part's noise grows by its differences in the frames before; "em": beside that each
            point counts as far as it was seen to move with the body, and not to stand still as what lies behind;
            "none": neither, which a body that does not fit needs: its contours and its brightness disagree steadily,
            and the brightness is not to lose its say.
        most: factor by which a part's noise grows at most.
    """

    points: int = 500
    blurs: tuple[float, ...] = (0.020, 0.005)
    sigma: float = 0.015
    slide: float = 0.0
    scale: float = 2.0
    jump: float = 0.06
    share: float = 0.8
    update: float = 0.2
    depth_tolerance: float = 0.012
    support: Support = "none"
    most: float = 10.0
    name: str = field(default="photometric", init=False)

    def __post_init__(self) -> None:
        positive = all(value > 0.0 for value in (self.sigma, self.scale, self.jump, self.share))
        if not (positive and self.slide >= 0.0 and self.most >= 1.0):
            raise InputError(
                "brightness: sigma, scale, jump and share must be positive, slide not negative and most 1 or more."
            )

    def start(self, body: Body, rig: Rig) -> Memories:
        """No view remembers anything."""
        return (None,) * len(rig)

    def measure(self, sight: Sight, memory: Memories, level: Level) -> Evidence | None:
        """Brightness constancy of one view; None before its first frame."""
        of_view = memory[sight.camera_index]
        if of_view is None:
            return None
        with stage("photometric"):
            which = len(self.blurs) - 1 if level.fine else 0
            return Evidence(self.term(sight.view, sight.seen, of_view, which))

    def learn(self, memory: Memories, fit: Fit, lesson: int) -> Memories:
        """The memories as the settled frame shows them."""
        out = list(memory)
        for sight in fit.sights:
            i = sight.camera_index
            out[i] = self.remember(sight.view, sight.seen, fit.posed, memory[i], lesson > 0)
        return tuple(out)

    def remember(self, view: View, seen: RenderedView, posed: Posed, old: Memory | None, lesson: bool) -> Memory:
        """Memory for the next frame; `seen` chooses the points now visible, `posed` (the settled pose) places them.

        In a `lesson` the old points are judged by how they agreed, and new points fill the empty cells.
        """
        rule, image = self._retention(seen), view.blurred(self.blurs[-1] * seen.px_per_m)
        if old is not None and lesson and self.support != "none":
            old = self._judged(old, view.picture, image, seen, posed, rule.cell)
        return remember(Look(view.picture, (image[None],), seen, posed), old, rule, fresh=lesson or old is None)

    def _retention(self, seen: RenderedView) -> Retention:
        return Retention(
            cell_of(seen, self.points), "strongest", self.update, self.depth_tolerance, self.jump,
            _NEW if self.support == "em" else 1.0,
        )  # fmt: skip

    def _judged(
        self, old: Memory, picture: Picture, image: Float32, seen: RenderedView, posed: Posed, cell: int
    ) -> Memory:
        """The memory with excess and trust as a settled frame makes them."""
        (samples,), part = old.samples(), old.points.part
        visible, _ = seen.visible(old.points, self.depth_tolerance, posed)
        noise = self._noise(samples, seen.px_per_m)
        r = samples.residuals(posed, seen.camera.P, image, np.zeros(EXPOSURE)) / noise
        now = robust_scale(r, part, len(old.excess), visible * old.trust, 1.0, self.most)
        known = visible & (old.trust > 0.0) & np.isfinite(r)
        shown = np.bincount(part, known, len(old.excess)) > 0  # of what is hidden nothing is learnt
        excess = np.where(shown, _PAST * old.excess + (1.0 - _PAST) * now, old.excess)
        if self.support == "robust":
            return replace(old, excess=excess)
        behind = unmoved(old, picture, self.blurs[-1] * seen.px_per_m)
        support = posterior(
            r[:, None], (behind / noise)[:, None], np.clip(old.trust, _LEAST, 1.0 - _LEAST), old.excess[part][:, None],
            np.ones(1), Neighbourhood.about(old.pixels / cell, 1.0), _NEITHER,
        )  # fmt: skip
        return replace(old, excess=excess, trust=np.where(visible, 0.5 * (old.trust + support), old.trust))

    def _noise(self, samples: Samples, px_per_m: float) -> Float:
        """(N,) expected standard deviation of the points' differences."""
        return np.sqrt(self.sigma**2 + (self.slide * px_per_m) ** 2 * np.sum(samples.gradient**2, axis=1))

    def term(self, view: View, seen: RenderedView, memory: Memory, level: int) -> PhotometricTerm:
        """Brightness constancy of the remembered points that the rendered view says are visible."""
        blur, fine = self.blurs[level] * seen.px_per_m, memory.samples()[0]
        visible, _ = seen.visible(memory.points, self.depth_tolerance)
        samples = fine if level in (-1, len(self.blurs) - 1) else memory.blurred(blur)
        noise = memory.excess[memory.points.part] * self._noise(fine, seen.px_per_m)
        weight = visible * memory.trust * (self.share / noise**2)
        return PhotometricTerm(view.camera.P, samples, view.blurred(blur), weight, self.scale * noise)


LOOSE_CLOTHES = Brightness(sigma=0.006, slide=0.001, share=0.5, update=0.1, support="em")
"""For a body that fits under clothes that do not."""


def cell_of(seen: RenderedView, count: int) -> int:
    """Side of the cells of a grid, px, of which about `count` lie on the body."""
    return max(1, round(math.sqrt(max(np.count_nonzero(seen.mask), 1) / max(count, 1))))


def unmoved(memory: Memory, picture: Picture, sigma: float) -> Float:
    """(N,) how much brightness has changed where points were in the frame before; NaN off the images."""
    shift = np.subtract(memory.picture.origin, picture.origin)
    before, _ = sampled(memory.picture.blurred(sigma), memory.pixels)
    return sampled(picture.blurred(sigma), memory.pixels + shift)[0] - before
