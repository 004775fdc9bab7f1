"""The brightness cue: visible surface points remember how bright they were, as if the light were even."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from twistcap.body import Body, Posed
from twistcap.camera import Rig
from twistcap.cues.light import Light
from twistcap.cues.memory import Look, Memory, Retention, remember
from twistcap.cues.observation import Evidence, Fit, Level, Sight
from twistcap.cues.view import View
from twistcap.ranges import Checked, Count, Positive, Share
from twistcap.render import RenderedView
from twistcap.stages import stage
from twistcap.terms import PhotometricTerm


@dataclass(frozen=True)
class Memories:
    """What each camera remembers under even light, None before its first image; and the light."""

    views: tuple[Memory | None, ...]
    light: Light


@dataclass(frozen=True)
class Brightness(Checked):
    """Settings of the brightness cue.

    Attributes:
        points: how many surface points are followed in each view.
        blurs: Gaussians under which images are compared, coarse to fine, m on the body.
        sigma: noise of the brightness (sensor, sampling).
        scale: difference, in standard deviations of the noise, at which a point begins to lose its say.
        jump: difference beyond which a point is given up for another.
        share: share of the points' information that counts (neighbouring points see the same pixels).
        update: share of the new brightness that a template point takes over in each frame.
        depth_tolerance: m that a point may lie behind the rendered surface and still count as seen.
    """

    points: Count = 500
    blurs: tuple[float, ...] = (0.020, 0.005)
    sigma: Positive = 0.015
    scale: Positive = 2.0
    jump: Positive = 0.06
    share: Share = 0.8
    update: Share = 0.1
    depth_tolerance: float = 0.012
    name: str = field(default="photometric", init=False)

    def start(self, body: Body, rig: Rig) -> Memories:
        """No view remembers anything."""
        return Memories((None,) * len(rig), Light.even())

    def measure(self, sight: Sight, memory: Memories, level: Level) -> Evidence | None:
        """Brightness constancy of one view, under the light of the rendered pose; None before its first frame."""
        of_view = memory.views[sight.camera_index]
        if of_view is None:
            return None
        with stage("photometric"):
            which = len(self.blurs) - 1 if level.fine else 0
            lit = _lit(of_view, memory.light, sight.seen.posed) if level.fine else of_view
            return Evidence(self.term(sight.view, sight.seen, lit, which))

    def learn(self, memory: Memories, fit: Fit, lesson: int) -> Memories:
        """The memories as the settled frame shows them, and in a lesson the light."""
        posed, shown, light = fit.posed, dict[int, Memory](), memory.light
        for sight in fit.sights:
            i = sight.camera_index
            old = memory.views[i]
            before = None if old is None else _lit(old, light, posed)
            shown[i] = self.remember(sight.view, sight.seen, posed, before, lesson > 0)
        if lesson:
            views = [(m.normal, m.points.part, m.value[:, 0, 0]) for m in shown.values()]
            light = light.learnt(views, posed.segment_transforms, lesson)
        even = {i: m.lit(1.0 / light.on(m.normal, m.points.part, posed.segment_transforms)) for i, m in shown.items()}
        return Memories(tuple(even.get(i, old) for i, old in enumerate(memory.views)), light)

    def remember(self, view: View, seen: RenderedView, posed: Posed, old: Memory | None, lesson: bool) -> Memory:
        """Memory under this frame's light; `seen` chooses the points now visible, `posed` (the settled pose) places
        them. In a `lesson` new points fill the empty cells.
        """
        rule, image = self._retention(seen), view.blurred(self.blurs[-1] * seen.px_per_m)
        return remember(Look(view.picture, (image[None],), seen, posed), old, rule, fresh=lesson or old is None)

    def _retention(self, seen: RenderedView) -> Retention:
        return Retention(cell_of(seen, self.points), "strongest", self.update, self.depth_tolerance, self.jump)

    def term(self, view: View, seen: RenderedView, memory: Memory, level: int) -> PhotometricTerm:
        """Brightness constancy of the remembered points, under this frame's light, that the rendered view shows."""
        blur, fine = self.blurs[level] * seen.px_per_m, memory.samples()[0]
        visible, _ = seen.visible(memory.points, self.depth_tolerance)
        samples = fine if level in (-1, len(self.blurs) - 1) else memory.blurred(blur)
        weight = np.where(visible, self.share / self.sigma**2, 0.0)
        scale = np.full(len(visible), self.scale * self.sigma)
        return PhotometricTerm(view.camera.P, samples, view.blurred(blur), weight, scale)


def _lit(memory: Memory, light: Light, posed: Posed) -> Memory:
    """What is remembered under even light, as the light shows it at a pose."""
    return memory.lit(light.on(memory.normal, memory.points.part, posed.segment_transforms))


def cell_of(seen: RenderedView, count: int) -> int:
    """Side of the cells of a grid, px, of which about `count` lie on the body."""
    return max(1, round(math.sqrt(max(np.count_nonzero(seen.mask), 1) / max(count, 1))))
