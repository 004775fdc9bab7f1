"""The tracker: one frame after the other, predict, then alternate correspond and update.

ARCHITECTURE.md walks through one frame; the settings of each cue stand with the cue.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from twistcap._typing import Float
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Rig
from twistcap.cues.brightness import Brightness, Template
from twistcap.cues.direct import DirectContour
from twistcap.cues.evidence import ContourCue, ContourEvidence
from twistcap.cues.levelset import LevelSetContour
from twistcap.cues.support import SupportRule, part_support
from twistcap.cues.view import View, crop_view
from twistcap.estimate import Estimate, Frame
from twistcap.features import Channels
from twistcap.predict import Moment, MotionNoise, PredictorName, predict
from twistcap.render import ContourPoints, RenderedView, render, reprojected, visible_contour
from twistcap.solve import SolveResult, covariance, least_squares
from twistcap.terms import GaussianTerm, LimitTerm, Term


@dataclass(frozen=True)
class TrackerConfig:
    """All settings of the tracker.

    Attributes:
        method: "direct" (no level set; the default) or "levelset" (the chapter's coupled method).
        channels: what region statistics look at, "grey" or "lab".
        photometric: whether brightness constancy joins the contours.
        predictor: "constant_velocity" or "hold".
        iterations: alternations of correspond and update in a frame.
        first_iterations: the same in the first frame, which starts from a given pose.
        render_every: the body is rendered anew in every so many alternations.
        contour_spacing: m on the body between contour samples.
        coarse: factor on the contour cue's capture range in the first alternation.
        solver_steps: Gauss-Newton steps in each alternation.
        margin: m about the expected body within which images are looked at.
        first_sigma_deg, first_sigma_m: how far the given first pose may be off (joints and root turn; root place).
    """

    method: Literal["direct", "levelset"] = "direct"
    channels: Channels = "lab"
    photometric: bool = True
    predictor: PredictorName = "constant_velocity"
    iterations: int = 4
    first_iterations: int = 10
    render_every: int = 2
    contour_spacing: float = 0.025
    coarse: float = 2.0
    solver_steps: int = 1
    margin: float = 0.15
    first_sigma_deg: float = 1.0
    first_sigma_m: float = 0.005
    direct: DirectContour = field(default_factory=DirectContour)
    levelset: LevelSetContour = field(default_factory=LevelSetContour)
    brightness: Brightness = field(default_factory=Brightness)
    noise: MotionNoise = field(default_factory=MotionNoise)
    support: SupportRule = field(default_factory=SupportRule)


@dataclass(frozen=True)
class _Sight:
    """What one camera contributes to one alternation."""

    camera_index: int
    view: View
    seen: RenderedView
    contour: ContourPoints


class Tracker:
    """Follows one body through a recording; `step` once per frame, in order."""

    def __init__(self, body: Body, rig: Rig, config: TrackerConfig | None = None) -> None:
        self.body, self.rig, self.config = body, rig.pinhole(), config or TrackerConfig()
        self._contour: ContourCue = self.config.direct if self.config.method == "direct" else self.config.levelset
        self._history: list[Moment] = []
        self._templates: list[Template | None] = [None] * len(rig)
        self._support = np.ones(len(body.segment_names))
        self._started = False

    def start(self, pose: Pose, time: float = 0.0) -> None:
        """Take the pose from which the first frame is tracked."""
        self._history = [Moment(time, pose)]
        self._templates = [None] * len(self.rig)
        self._support[:] = 1.0
        self._started = False

    def restore(self, estimates: Sequence[Estimate]) -> None:
        """Go on after a track's last estimate, as `--resume` does; brightness is learnt anew from the next frame."""
        last = estimates[-1]
        self.start(last.pose, last.time)
        self._history = [Moment(e.time, e.pose) for e in estimates[-50:]]
        self._started = True

    def step(self, frame: Frame) -> Estimate:
        """Track one frame."""
        guess = predict(self._history, frame.time, self.config.predictor) if self._started else self._history[-1].pose
        expected = self._expected(guess, frame.time)
        fixed: list[Term] = [LimitTerm(), GaussianTerm(guess, np.linalg.inv(expected))]
        views = self._views(frame, guess)
        if not views:
            self._advance(frame.time, guess)
            return Estimate(frame.index, frame.time, guess, expected, {}, "no_images", 0, support=0.0)
        result, sights, found = self._fit(guess, views, fixed)
        self._remember(sights, result.pose)
        self._advance(frame.time, result.pose)
        self._judge(sights, found)
        return self._estimate(frame, result)

    def _fit(
        self, guess: Pose, views: dict[int, View], fixed: Sequence[Term]
    ) -> tuple[SolveResult, list[_Sight], list[ContourEvidence]]:
        """Alternate correspond and update."""
        config = self.config
        pose, steps = guess, 0
        sights: list[_Sight] = []
        evidence: list[tuple[list[Term], ContourEvidence]] = []
        result: SolveResult | None = None
        for iteration in range(config.iterations if self._started else config.first_iterations):
            posed = Posed(self.body, pose)
            if iteration % config.render_every == 0:
                sights = [self._look(posed, camera, view) for camera, view in views.items()]
            else:
                sights = [replace(s, contour=reprojected(s.contour, posed, s.view.camera.P)) for s in sights]
            evidence = [self._evidence(sight, coarse=iteration == 0) for sight in sights]
            terms = [term for by_view, _ in evidence for term in by_view]
            result = least_squares(self.body, pose, [*fixed, *terms], steps=config.solver_steps)
            pose, steps = result.pose, steps + result.steps
        assert result is not None
        return replace(result, steps=steps), sights, [found for _, found in evidence]

    def _look(self, posed: Posed, camera_index: int, view: View) -> _Sight:
        seen = render(posed, view.camera)
        spacing = max(1.0, self.config.contour_spacing * seen.px_per_m)
        return _Sight(camera_index, view, seen, visible_contour(seen, spacing))

    def _evidence(self, sight: _Sight, coarse: bool) -> tuple[list[Term], ContourEvidence]:
        """Terms of one camera: its contour, and the brightness of what it saw in the frame before."""
        config = self.config
        found = self._contour.measure(sight.view, sight.seen, sight.contour, config.coarse if coarse else 1.0)
        terms: list[Term] = [found.term]
        template = self._templates[sight.camera_index]
        if config.photometric and template is not None:
            level = 0 if coarse else len(config.brightness.blurs) - 1
            terms.append(config.brightness.term(sight.view, sight.seen, template, level))
        return terms, found

    def _expected(self, guess: Pose, time: float) -> Float:
        """Covariance of the prediction, or of the given first pose."""
        config, centre = self.config, guess.root[:3, 3]
        if not self._started:
            turn = float(np.deg2rad(config.first_sigma_deg))
            given = MotionNoise(joint_speed=turn, turn_speed=turn, shift_speed=config.first_sigma_m)
            return given.covariance(self.body.dof, 1.0, "hold", centre)
        dt = time - self._history[-1].time
        return config.noise.covariance(self.body.dof, dt, config.predictor, centre)

    def _views(self, frame: Frame, guess: Pose) -> dict[int, View]:
        posed, margin = Posed(self.body, guess), self.config.margin
        views: dict[int, View] = {}
        for i, image in enumerate(frame.images):
            view = None if image is None else crop_view(image, self.rig[i], posed, margin, self.config.channels)
            if view is not None:
                views[i] = view
        return views

    def _remember(self, sights: Sequence[_Sight], pose: Pose) -> None:
        if self.config.photometric:
            posed = Posed(self.body, pose)
            for sight in sights:
                old = self._templates[sight.camera_index]
                self._templates[sight.camera_index] = self.config.brightness.remember(sight.view, sight.seen, posed, old)

    def _advance(self, time: float, pose: Pose) -> None:
        if not self._started:
            self._history = []
        self._history = [*self._history, Moment(time, pose)][-50:]
        self._started = True

    def _judge(self, sights: Sequence[_Sight], found: Sequence[ContourEvidence]) -> None:
        """Update each part's support by what this frame shows of it; a part hardly seen keeps what it had."""
        rule = self.config.support
        focal = [sight.view.camera.K[0, 0] for sight in sights]
        share, seen = part_support(found, focal, len(self.body.segment_names), rule)
        judged = seen >= rule.least_points
        self.part_share, self.part_seen = share, seen
        self._support[judged] = rule.memory * self._support[judged] + (1.0 - rule.memory) * share[judged]

    def _estimate(self, frame: Frame, result: SolveResult) -> Estimate:
        support = float(self._support.min())
        return Estimate(
            frame.index, frame.time, result.pose, covariance(result.quadratic), {"total": result.energy}, result.status,
            result.steps, support < self.config.support.least_share, support,
        )  # fmt: skip


def track(
    frames: Iterable[Frame], body: Body, rig: Rig, first_pose: Pose, config: TrackerConfig | None = None
) -> Iterator[Estimate]:
    """Track a body through frames, one estimate each."""
    tracker = Tracker(body, rig, config)
    for k, frame in enumerate(frames):
        if k == 0:
            tracker.start(first_pose, frame.time)
        yield tracker.step(frame)
