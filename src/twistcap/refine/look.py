"""One round's look at all frames: the body is rendered into each, and what the images say is summed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twistcap._typing import Float
from twistcap.body import Pose, Posed
from twistcap.camera import Rig
from twistcap.cues.appearance import Appearance
from twistcap.cues.evidence import ContourCue
from twistcap.cues.support import part_tally
from twistcap.cues.view import crop_view, despeckled
from twistcap.estimate import Frame
from twistcap.refine.evidence import Instant, Sight, add_brightness, add_contour, followed_points
from twistcap.refine.settings import RefineConfig
from twistcap.refine.shape import Shape
from twistcap.render import render, visible_contour
from twistcap.settings import TrackerConfig
from twistcap.solve import Arrow
from twistcap.terms import LimitTerm, RestTerm


class Eyes:
    """What stays from round to round: cameras, settings, and the colours of S parts as the whole sequence shows them.

    Attributes:
        colours: of each part in each camera; None before the first round is over.
        contour: the cue; None for the method that has none.
    """

    def __init__(self, rig: Rig, config: RefineConfig, tracker: TrackerConfig, parts: int) -> None:
        self.rig, self.config, self.tracker, self.parts = rig, config, tracker, parts
        self.colours = self.fresh()
        self.contour: ContourCue | None = None if tracker.method == "differential" else tracker.contour

    def fresh(self) -> Appearance:
        """Nothing learnt yet; of what is learnt nothing fades, since a sequence has no present."""
        return Appearance(len(self.rig), self.parts, replace(self.tracker.appearance, memory=1.0))

    def look(self, shape: Shape, poses: Sequence[Pose], coarse: bool) -> Look:
        """A round that has seen nothing yet."""
        return Look(self, shape, poses, coarse)

    def learn(self, look: Look) -> None:
        """Take over the colours that a round has gathered."""
        self.colours = look.learnt


class Look:
    """The equations of one round; `add` once per frame, in order.

    Attributes:
        system: what has been summed.
        energies: of each frame, by term; that of brightness stands with the later frame of each two.
        learnt: colours of the parts.
    """

    def __init__(self, eyes: Eyes, shape: Shape, poses: Sequence[Pose], coarse: bool) -> None:
        self.eyes, self.body, self.poses, self.coarse = eyes, shape.body, poses, coarse
        self.motion = shape.motion()
        self.reach = max((2, *eyes.config.strides))
        self.system = Arrow(len(poses), shape.body.dof, len(shape.sigma), self.reach)
        self.system.longest = self.system.shared_longest = np.inf  # `refine` shortens them itself
        self.energies: list[dict[str, float]] = []
        self.learnt = eyes.fresh()
        self._recent: list[Instant] = []
        self._good: list[Float] = []
        self._points: list[Float] = []

    def add(self, frame: Frame, trusted: bool = True) -> None:
        """Add what a frame shows; nothing of its images where the pose is not `trusted` to be near them."""
        t = len(self.energies)
        self.energies.append({})
        posed = Posed(self.body, self.poses[t])
        instant = Instant(t, posed, self._sights(frame, posed) if trusted else {})
        self._add_contours(instant)
        self._add_brightness(instant)
        for term in (LimitTerm(), RestTerm(float(np.deg2rad(self.eyes.tracker.rest_sigma_deg)))):
            quadratic = term.linearize(posed)
            self.system.add_pose(t, quadratic.gradient, quadratic.hessian)
            self._count(term.name, quadratic.value)
        self._recent = [*self._recent, instant][-self.reach :]

    def support(self) -> Float:
        """(F,) how far the contours support each frame's pose, judged as in tracking: its worst part's share."""
        rule = self.eyes.tracker.support
        share, out = np.ones(self.eyes.parts), np.ones(len(self._good))
        for t, (good, points) in enumerate(zip(self._good, self._points, strict=True)):
            judged = points >= rule.least_points
            share[judged] *= rule.memory
            share[judged] += (1.0 - rule.memory) * good[judged] / points[judged]
            out[t] = share.min()
        return out

    def _sights(self, frame: Frame, posed: Posed) -> dict[int, Sight]:
        tracker, out = self.eyes.tracker, dict[int, Sight]()
        for i, image in enumerate(despeckled(frame, tracker.despeckle).images):
            view = (
                None if image is None else crop_view(image, self.eyes.rig[i], posed, tracker.margin, tracker.channels)
            )
            if view is not None:
                seen = render(posed, view.camera)
                out[i] = Sight(view, seen, followed_points(view, seen, self.eyes.config.points))
        return out

    def _add_contours(self, instant: Instant) -> None:
        cue, tracker, parts = self.eyes.contour, self.eyes.tracker, self.eyes.parts
        good, points = np.zeros(parts), np.zeros(parts)
        for i, sight in instant.sights.items():
            if cue is None:
                break
            contour = visible_contour(sight.seen, max(1.0, tracker.contour_spacing * sight.seen.px_per_m))
            colours = self.eyes.colours.of(i, sight.view.features.shape[2])
            wide = self.eyes.config.coarse if self.coarse else 1.0
            found = cue.measure(sight.view, sight.seen, contour, wide, colours)
            self._count("contour", add_contour(self.system, instant, self.motion, found, self.eyes.config.contour))
            agreeing, seen = part_tally(found, sight.view.camera.K[0, 0], parts, tracker.support)
            good, points = good + agreeing, points + seen
            self.learnt.learn(i, sight.view, sight.seen, agreeing / np.maximum(seen, 1), 1)
        self._good.append(good)
        self._points.append(points)

    def _add_brightness(self, instant: Instant) -> None:
        cue, config = self.eyes.tracker.brightness, self.eyes.config
        blur = cue.blurs[0] if self.coarse else cue.blurs[-1]
        for earlier in self._recent:
            if instant.number - earlier.number in config.strides:
                share = config.brightness / len(config.strides)
                energy = add_brightness(self.system, earlier, instant, self.motion, cue, blur, share, config.sigma)
                self._count("photometric", energy)

    def _count(self, term: str, energy: float) -> None:
        self.energies[-1][term] = self.energies[-1].get(term, 0.0) + energy
