"""The tracker: one frame after the other, predict, then alternate correspond and update.

ARCHITECTURE.md walks through one frame; the settings of each cue stand with the cue.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from twistcap._typing import Float, Int
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Rig
from twistcap.cues.brightness import Brightness, Template
from twistcap.cues.direct import DirectContour
from twistcap.cues.evidence import ContourCue, ContourEvidence
from twistcap.cues.keypoints import KeypointCue
from twistcap.cues.levelset import LevelSetContour
from twistcap.cues.support import SupportRule, part_support
from twistcap.cues.view import View, crop_view
from twistcap.estimate import Estimate, Frame
from twistcap.features import Channels
from twistcap.predict import Moment, MotionNoise, PredictorName, predict, turned_limbs
from twistcap.render import ContourPoints, RenderedView, render, reprojected, visible_contour
from twistcap.solve import SolveResult, Status, covariance, least_squares
from twistcap.stages import next_frame, stage
from twistcap.terms import GaussianTerm, LimitTerm, Quadratic, RestTerm, Term


@dataclass(frozen=True)
class TrackerConfig:
    """All settings of the tracker.

    Attributes:
        method: "direct" (no level set; the default) or "levelset" (the chapter's coupled method).
        channels: what region statistics look at, "grey" or "lab".
        photometric: whether brightness constancy joins the contours.
        predictor: "constant_velocity" or "hold".
        decay: time constant (s) with which predicted joint velocities die away.
        rest_sigma_deg: how far joints are expected from the rest pose; matters only to a limb that nothing shows.
        iterations: fine alternations of correspond and update in a frame.
        first_iterations: the same in the first frame, which starts from a given pose.
        coarse: factor on the contour cue's capture range in the coarse alternations that come first.
        coarse_rounds: coarse alternations at most; one is enough where the prediction was good.
        settled: m that the body may still move in a coarse alternation that is the last one.
        render_every: the body is rendered anew in every so many alternations (always for the level set).
        contour_spacing: m on the body between contour samples.
        solver_steps: Gauss-Newton steps in each alternation.
        recovery_deg: how far joints are turned, either way, to find a limb again whose contour was suddenly lost.
        margin: m about the expected body within which images are looked at.
        inflation: factor on every claimed standard deviation: contour and brightness samples are not independent, and
            no body is exact; set on studio captures with truth (docs/covariance.md).
        first_sigma_deg, first_sigma_m: how far the given first pose may be off (joints and root turn; root place).
    """

    method: Literal["direct", "levelset"] = "direct"
    channels: Channels = "lab"
    photometric: bool = True
    predictor: PredictorName = "constant_velocity"
    decay: float = 0.2
    rest_sigma_deg: float = 30.0
    iterations: int = 2
    first_iterations: int = 10
    coarse: float = 3.0
    coarse_rounds: int = 5
    settled: float = 0.015
    render_every: int = 4
    contour_spacing: float = 0.032
    solver_steps: int = 1
    recovery_deg: float = 30.0
    margin: float = 0.2
    inflation: float = 5.0
    first_sigma_deg: float = 1.0
    first_sigma_m: float = 0.005
    direct: DirectContour = field(default_factory=DirectContour)
    levelset: LevelSetContour = field(default_factory=LevelSetContour)
    brightness: Brightness = field(default_factory=Brightness)
    keypoints: KeypointCue = field(default_factory=KeypointCue)
    noise: MotionNoise = field(default_factory=MotionNoise)
    support: SupportRule = field(default_factory=SupportRule)


@dataclass(frozen=True)
class _Sight:
    """What one camera contributes to one alternation."""

    camera_index: int
    view: View
    seen: RenderedView
    contour: ContourPoints


@dataclass(frozen=True)
class _Fit:
    """State of a frame between alternations: the answer so far, and what it was made from."""

    result: SolveResult
    sights: Sequence[_Sight] = ()
    terms: Sequence[Term] = ()
    found: Sequence[ContourEvidence] = ()
    energies: Mapping[str, float] = field(default_factory=dict[str, float])


class Tracker:
    """Follows one body through a recording; `step` once per frame, in order."""

    def __init__(self, body: Body, rig: Rig, config: TrackerConfig | None = None) -> None:
        self.body, self.rig, self.config = body, rig.pinhole(), config or TrackerConfig()
        self._given_rig = rig  # keypoints come in its pixels, images rectified
        self._contour: ContourCue = self.config.direct if self.config.method == "direct" else self.config.levelset
        self._history: list[Moment] = []
        self._templates: list[Template | None] = [None] * len(rig)
        self._rest = RestTerm(float(np.deg2rad(self.config.rest_sigma_deg)))
        self._support = np.ones(len(body.segment_names))
        self._covariance = np.zeros((body.dof, body.dof))
        self._seen_time = 0.0
        self._started = False

    def start(self, pose: Pose, time: float = 0.0) -> None:
        """Take the pose from which the first frame is tracked."""
        self._history = [Moment(time, pose)]
        self._templates = [None] * len(self.rig)
        self._support[:] = 1.0
        self._seen_time = time
        self._started = False

    def restore(self, estimates: Sequence[Estimate]) -> None:
        """Go on after a track's last estimate, as `--resume` does; brightness is learnt anew from the next frame."""
        last = estimates[-1]
        self.start(last.pose, last.time)
        self._history = [Moment(e.time, e.pose) for e in estimates[-50:]]
        self._covariance = last.covariance
        self._started = True

    def step(self, frame: Frame) -> Estimate:
        """Track one frame."""
        next_frame()
        config = self.config
        guess = predict(self._history, frame.time, config.predictor, config.decay)
        expected = self._expected(guess, frame.time)
        information = np.asarray(np.linalg.inv(expected), dtype=np.float64)
        found = self._keypoints(frame, guess)
        fixed: Sequence[Term] = (LimitTerm(), self._rest, GaussianTerm(guess, information), *found)
        views = self._views(frame, guess)
        if not views and not found:
            self._advance(frame.time, guess)
            claimed = self._covariance + config.inflation**2 * expected
            return Estimate(frame.index, frame.time, guess, claimed, {}, "no_images", support=0.0)
        fit = self._recovered(self._fit(guess, views, fixed), views, fixed)
        self._covariance = self._claimed(fit.result, expected)
        with stage("remember"):
            self._remember(fit.sights, fit.result.pose)
        self._advance(frame.time, fit.result.pose)
        self._seen_time = frame.time
        support = self._judge(fit)
        return Estimate(
            frame.index, frame.time, fit.result.pose, self._covariance, fit.energies, fit.result.status,
            fit.result.steps, support < config.support.least_share, support,
        )  # fmt: skip

    def _fit(self, guess: Pose, views: dict[int, View], fixed: Sequence[Term]) -> _Fit:
        """Alternate correspond and update: coarse until the body has settled, then fine."""
        config = self.config
        fine = config.iterations if self._started else config.first_iterations
        fit = _Fit(SolveResult(guess, "max_iterations", 0, np.inf, Quadratic.zero(self.body.dof)))
        every = 1 if config.method == "levelset" else config.render_every  # its shape prior is the rendered mask
        coarse, rounds = True, 0
        while fine > 0:
            fit, moved = self._alternate(fit, views, fixed, coarse, again=coarse or rounds % every == 0)
            rounds += 1
            fine -= not coarse
            coarse = coarse and moved > config.settled and rounds < config.coarse_rounds
            fit = replace(fit, result=replace(fit.result, status=_status(fit.result, moved, config.settled)))
        return replace(fit, energies=_energies([*fixed, *fit.terms], Posed(self.body, fit.result.pose)))

    def _recovered(self, fit: _Fit, views: dict[int, View], fixed: Sequence[Term]) -> _Fit:
        """Where a part has suddenly lost its contour, try its joints turned either way.

        The fit with the most agreeing contour points wins, if brightness, which remembers the limb from the frame
        before, does not object: contours alone would lay one arm upon the other.
        """
        rule = self.config.support
        share, seen = self._part_support(fit)
        dropped = (seen >= rule.least_points) & (share < rule.drop * self._support)
        if not self._started or not np.any(dropped):
            return fit
        worst = int(np.argmin(np.where(dropped, share, np.inf)))
        best, agreeing = fit, float(share @ seen)
        for start in turned_limbs(self.body, fit.result.pose, worst, np.deg2rad(self.config.recovery_deg)):
            other = self._fit(start, views, fixed)
            share, seen = self._part_support(other)
            objection = other.energies.get("photometric", 0.0) - fit.energies.get("photometric", 0.0)
            heeded = objection <= rule.objection * fit.energies.get("photometric", 0.0)
            if heeded and share @ seen > agreeing + rule.least_points / 2:
                best, agreeing = other, float(share @ seen)
        return best

    def _part_support(self, fit: _Fit) -> tuple[Float, Int]:
        focal = [sight.view.camera.K[0, 0] for sight in fit.sights]
        return part_support(fit.found, focal, len(self.body.segment_names), self.config.support)

    def _alternate(
        self, fit: _Fit, views: dict[int, View], fixed: Sequence[Term], coarse: bool, again: bool
    ) -> tuple[_Fit, float]:
        """One alternation, with the body rendered `again` or its contour carried along; and how far it moved, m."""
        config, posed = self.config, Posed(self.body, fit.result.pose)
        if again:
            sights = [self._look(posed, camera, view) for camera, view in views.items()]
        else:
            sights = [replace(s, contour=reprojected(s.contour, posed, s.view.camera.P)) for s in fit.sights]
        evidence = [self._evidence(sight, coarse) for sight in sights]
        terms = [term for by_view, _ in evidence for term in by_view]
        with stage("solve"):
            result = least_squares(self.body, posed.pose, [*fixed, *terms], steps=config.solver_steps)
        moved = _reach(result.pose.minus(posed.pose), posed.pose.root[:3, 3])
        result = replace(result, steps=fit.result.steps + result.steps)
        return _Fit(result, sights, terms, [found for _, found in evidence]), moved

    def _look(self, posed: Posed, camera_index: int, view: View) -> _Sight:
        with stage("render"):
            seen = render(posed, view.camera)
        with stage("contour"):
            spacing = max(1.0, self.config.contour_spacing * seen.px_per_m)
            return _Sight(camera_index, view, seen, visible_contour(seen, spacing))

    def _evidence(self, sight: _Sight, coarse: bool) -> tuple[list[Term], ContourEvidence]:
        """Terms of one camera: its contour, and the brightness of what it saw in the frame before."""
        config = self.config
        with stage("statistics"):
            found = self._contour.measure(sight.view, sight.seen, sight.contour, config.coarse if coarse else 1.0)
        terms: list[Term] = [found.term]
        template = self._templates[sight.camera_index]
        if config.photometric and template is not None:
            level = 0 if coarse else len(config.brightness.blurs) - 1
            with stage("photometric"):
                terms.append(config.brightness.term(sight.view, sight.seen, template, level))
        return terms, found

    def _expected(self, guess: Pose, time: float) -> Float:
        """Covariance of the prediction, or of the given first pose."""
        config, centre = self.config, guess.root[:3, 3]
        if not self._started:
            turn = float(np.deg2rad(config.first_sigma_deg))
            given = MotionNoise(joint_speed=turn, turn_speed=turn, shift_speed=config.first_sigma_m)
            return given.covariance(self.body.dof, 1.0, "hold", centre)
        dt = time - self._seen_time  # through dropped frames the prediction runs open-loop
        predictor = config.predictor if len(self._history) > 1 else "hold"  # one moment has no velocity
        return config.noise.covariance(self.body.dof, dt, predictor, centre)

    def _views(self, frame: Frame, guess: Pose) -> dict[int, View]:
        posed, margin = Posed(self.body, guess), self.config.margin
        views: dict[int, View] = {}
        for i, image in enumerate(frame.images):
            view = None if image is None else crop_view(image, self.rig[i], posed, margin, self.config.channels)
            if view is not None:
                views[i] = view
        return views

    def _keypoints(self, frame: Frame, guess: Pose) -> Sequence[Term]:
        if frame.keypoints is None:
            return ()
        return self.config.keypoints.terms(frame.keypoints, self._given_rig, Posed(self.body, guess))

    def _remember(self, sights: Sequence[_Sight], pose: Pose) -> None:
        if self.config.photometric:
            posed = Posed(self.body, pose)
            for sight in sights:
                old, cue = self._templates[sight.camera_index], self.config.brightness
                self._templates[sight.camera_index] = cue.remember(sight.view, sight.seen, posed, old)

    def _advance(self, time: float, pose: Pose) -> None:
        if not self._started:
            self._history = []
        self._history = [*self._history, Moment(time, pose)][-50:]
        self._started = True

    def _claimed(self, result: SolveResult, expected: Float) -> Float:
        """Covariance of the answer: what this frame's images add to what was known, as a Kalman filter would have it.

        A limb that nothing shows grows less certain from frame to frame. Where the solve failed, only that happens.
        """
        scale = self.config.inflation**2
        before = self._covariance + scale * expected
        if result.status == "failed":
            return before
        # The solve held the prediction against its own spread alone; put the uncertainty of the past in its place.
        information = result.quadratic.hessian - np.linalg.inv(expected)
        zero = np.zeros(self.body.dof)
        return covariance(Quadratic(0.0, zero, information / scale + np.linalg.inv(before)))

    def _judge(self, fit: _Fit) -> float:
        """The least support of any part, after this frame; a part that is hardly seen keeps what it had."""
        rule = self.config.support
        share, seen = self._part_support(fit)
        judged = seen >= rule.least_points
        self._support[judged] = rule.memory * self._support[judged] + (1.0 - rule.memory) * share[judged]
        return float(self._support.min())


def _status(result: SolveResult, moved: float, settled: float) -> Status:
    """Of a whole frame: a step that hardly moved the body has converged."""
    if result.status == "failed":
        return "failed"
    return "converged" if moved < settled else "max_iterations"


def _reach(step: Float, centre: Float) -> float:
    """How far a pose step moves the body, m: its root, and a joint's turn at the end of a 0.4 m limb."""
    shift = step[3:6] + np.cross(step[:3], centre)
    return float(max(np.linalg.norm(shift), 0.4 * np.abs(step[[0, 1, 2, *range(6, len(step))]]).max(initial=0.0)))


def _energies(terms: Sequence[Term], posed: Posed) -> dict[str, float]:
    """Energy by name of term."""
    out: dict[str, float] = {}
    for term in terms:
        out[term.name] = out.get(term.name, 0.0) + term.energy(posed)
    return out


def track(
    frames: Iterable[Frame], body: Body, rig: Rig, first_pose: Pose, config: TrackerConfig | None = None
) -> Iterator[Estimate]:
    """Track a body through frames, one estimate each."""
    tracker = Tracker(body, rig, config)
    for k, frame in enumerate(frames):
        if k == 0:
            tracker.start(first_pose, frame.time)
        yield tracker.step(frame)
